"""How much each setting of a study explains of the differences in fitness.

The analysis of variance of a full grid: a setting's share is its sum of squares divided by the
total one, eta squared (Fisher 1925), and likewise for each interaction of two settings. With one
value for each cell these are the main and pairwise effects of functional ANOVA, as in fANOVA
(Hutter, Hoos and Leyton-Brown 2014, ICML), computed on the grid itself and not on a model of it.
Chance alone has a share, too: epsilon squared (Kelley 1935) takes it off.
"""

import itertools
import json
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

KINDS = (".kind", ".simulator")


class Effect(NamedTuple):
    """A setting, or an interaction of two."""

    settings: tuple[str, ...]  # keys in an experiment file
    eta2: float  # share of the total sum of squares
    # The same without what chance alone explains, at least 0; None without repeats.
    epsilon2: float | None

    @property
    def name(self) -> str:
        """Return what people read: ``optimizer``, or ``optimizer x representation``."""
        return " x ".join(self.settings)


class Importance(NamedTuple):
    """The decomposition of a study's fitness."""

    effects: list[Effect]  # the most important first
    rest: float  # share of higher interactions
    # Share of the differences between runs of the same setting; None without repeats.
    noise: float | None
    runs: int
    why: str = ""  # why there are no effects

    def as_object(self) -> dict[str, Any]:
        """Return what is reported to programs."""
        return {**self._asdict(), "effects": [one._asdict() for one in self.effects]}


def of_groups(
    settings: Mapping[str, Mapping[str, Any]], values: Mapping[str, np.ndarray]
) -> Importance:
    """Decompose the variance of groups of runs: their settings, and one number of each run."""
    each = [settings[group] for group, numbers in values.items() for _ in numbers]
    return importance(each, np.concatenate([*values.values()]).tolist())


def importance(
    settings: Sequence[Mapping[str, Any]], values: Sequence[float]
) -> Importance:
    """Decompose the variance of some runs' fitness.

    Args:
        settings: of each run, by keys; seeds are to be left out.
        values: of each run; higher is better.
    """
    y = np.asarray(values, np.float64)
    names, levels = _factors(settings)
    if not names:
        return without(len(y), "the runs have the same settings")
    if not np.isfinite(y).all():
        return without(len(y), "in some runs every candidate failed")
    cells = {tuple(row) for row in levels.tolist()}
    sizes = [len(set(column)) for column in levels.T.tolist()]
    if len(cells) < np.prod(sizes):
        return without(
            len(y), "the settings of the runs are no full grid: not all combinations ran"
        )
    y, levels = _balanced(y, levels)
    total = float(((y - y.mean()) ** 2).sum())
    if total <= np.finfo(np.float64).eps * len(y) * float((y**2).max()):
        return without(len(y), "all runs have the same fitness")
    within = y - _means(y, levels, range(len(names)))
    noise, free = float((within**2).sum()), len(y) - len(cells)
    if not free and len(names) == 1:
        return without(
            len(y), "no setting was repeated, so chance cannot be told from an effect"
        )
    chance = noise / free if free else None
    effects, explained = [], 0.0
    main = {}
    for index, name in enumerate(names):
        main[index] = _means(y, levels, [index]) - y.mean()
        squares = float((main[index] ** 2).sum())
        explained += squares
        effects.append(_effect((name,), squares, sizes[index] - 1, chance, total))
    if len(names) > 1:
        for a, b in itertools.combinations(range(len(names)), 2):
            both = _means(y, levels, [a, b]) - y.mean() - main[a] - main[b]
            squares = float((both**2).sum())
            explained += squares
            degrees = (sizes[a] - 1) * (sizes[b] - 1)
            effects.append(_effect((names[a], names[b]), squares, degrees, chance, total))
    rest = max(0.0, total - noise - explained) / total
    effects.sort(key=lambda effect: -effect.eta2)
    return Importance(effects, rest, noise / total if free else None, len(y))


def _effect(
    settings: tuple[str, ...],
    squares: float,
    degrees: int,
    chance: float | None,
    total: float,
) -> Effect:
    if chance is None:
        return Effect(settings, squares / total, None)
    return Effect(settings, squares / total, max(0.0, squares - degrees * chance) / total)


def without(runs: int, why: str) -> Importance:
    """Return that there is no decomposition of some runs' fitness, and why."""
    return Importance([], 0.0, None, runs, why)


def _factors(settings: Sequence[Mapping[str, Any]]) -> tuple[list[str], np.ndarray]:
    """Return the settings that differ, and the number of each run's value: (runs, settings).

    Settings that change together are one, named by the first. What a kind, such as that of the
    optimizer, determines is not counted next to it: a setting that only some kinds have.
    """
    known: dict[tuple[int, ...], str] = {}
    for name in dict.fromkeys(key for one in settings for key in one):
        texts = [
            json.dumps(one.get(name), sort_keys=True, default=str) for one in settings
        ]
        numbers = {text: number for number, text in enumerate(dict.fromkeys(texts))}
        column = tuple(numbers[text] for text in texts)
        if len(numbers) > 1:
            known.setdefault(column, name)
    kinds = [column for column, name in known.items() if name.endswith(KINDS)]
    known = {
        column: name
        for column, name in known.items()
        if not any(column != kind and _determines(kind, column) for kind in kinds)
    }
    levels = np.array(list(known), np.int64).reshape(-1, len(settings)).T
    return list(known.values()), levels


def _determines(one: Sequence[int], other: Sequence[int]) -> bool:
    """Return whether the other has one value only for each value of the one."""
    return len(set(zip(one, other, strict=True))) == len(set(one))


def _balanced(y: np.ndarray, levels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return as many runs of each cell as the smallest has, the first ones: effects add up."""
    _, cell = np.unique(levels, axis=0, return_inverse=True)
    smallest = np.bincount(cell.ravel()).min()
    seen: dict[int, int] = {}
    kept = []
    for index, number in enumerate(cell.ravel().tolist()):
        seen[number] = seen.get(number, 0) + 1
        if seen[number] <= smallest:
            kept.append(index)
    return y[kept], levels[kept]


def _means(y: np.ndarray, levels: np.ndarray, by: Sequence[int]) -> np.ndarray:
    """Return for each run the mean of the runs with the same levels of some settings."""
    _, cell = np.unique(levels[:, list(by)], axis=0, return_inverse=True)
    cell = cell.ravel()
    found: np.ndarray = (np.bincount(cell, y) / np.bincount(cell))[cell]
    return found
