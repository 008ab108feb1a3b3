"""Cellular evolution on a torus: ``CEA2D`` of FREVO 1.5 (github.com/smartgrids-aau/Frevo).

Individuals sit in the cells of a grid without edges. Each is compared with its eight neighbours.
The best of these nine stay, with their fitness; the others are replaced by a mutant of one of the
best, by a child with one of the best, or by a new random individual. What differs from FREVO:
docs/optimizers.md. As there, the first of equals is the better, so that cells keep changing where
all are equal, and the elite is rounded to whole individuals, to even at a half.
"""

from typing import Annotated

import numpy as np
from msgspec import Meta

from zswarm.config.meta import about
from zswarm.kernels.random import Stream
from zswarm.kernels.sums import mean
from zswarm.nets.representation import Representation
from zswarm.ot.optimizers.base import BaseOptimizer, setting_error
from zswarm.ot.optimizers.breeding import (
    MutationSettings,
    Share,
    distances_of_pairs,
    mutants,
)

OPERATORS = ("elite", "mutation", "crossover", "renew")
HOOD = 9  # a cell and its neighbours

Cells = Annotated[int, Meta(ge=3, le=1_000)]


class Cea2dSettings(MutationSettings, frozen=True):
    """Settings of ``[optimizer]`` with ``kind = "cea2d"``; the rest of the shares is new."""

    width: Annotated[Cells, about("cells in a row")] = 10
    height: Annotated[Cells, about("rows")] = 10
    elite: Annotated[Share, about("share of a cell and its neighbours that stays")] = 0.11
    mutation: Annotated[Share, about("share of mutants of one of the best")] = 0.59
    crossover: Annotated[Share, about("share of children of a cell and an elite")] = 0.30


class CEA2D(BaseOptimizer):
    """Cellular evolution on a torus: individuals compete and mate with their neighbours only.

    That keeps them different. With fresh seeds all cells are evaluated again.

    Statistics: best, mean of all cells, evaluations; ``diversity_mean``,
    the mean distance of two individuals, over all pairs of at most 250; per operator (elite,
    mutation, crossover, renew) ``count_`` of its individuals and ``effectivity_``, the share of
    these that stays.
    """

    settings_type = Cea2dSettings
    competes = True
    stored = ("genomes", "fitness")
    settings: Cea2dSettings

    def __init__(
        self, settings: Cea2dSettings, representation: Representation, seed: int
    ) -> None:
        super().__init__(settings, representation, seed)
        self.candidates = settings.width * settings.height
        self.elite = round(HOOD * settings.elite)
        if not 1 <= self.elite < HOOD:
            text = f"expected 1 to 8 of {HOOD} cells, 0.06 to 0.94, not {settings.elite}"
            raise setting_error("elite", text)
        if settings.elite + settings.mutation + settings.crossover > 1.0 + 1e-9:
            text = "expected shares of at most 1 in all"
            raise setting_error("elite, mutation and crossover", text)
        self._hoods = _hoods(settings.width, settings.height)
        self._genomes: list[bytes] = []  # of the last generation told
        self._population: list[bytes] = []  # of the generation asked for
        self._fitness = np.full(self.candidates, np.nan)
        self._operators = np.full(self.candidates, "renew", "U9")  # which made each
        self._cells = np.arange(self.candidates)  # cells that were asked for

    def _ask(self) -> list[bytes]:
        stream = self._stream("cea2d")
        if self.generation == 0:
            self._population = self.representation.random(len(self._fitness), stream)
        else:
            stays, best = self._ranked()
            self._cells = np.flatnonzero(~stays)
            self._evolve(best, stream)
        if self.relative or self.fresh:
            self._cells = np.arange(len(self._population))
        return [self._population[cell] for cell in self._cells]

    def _ranked(self) -> tuple[np.ndarray, np.ndarray]:
        """Return which cells stay, (cells,) bool, and the best around each, (cells, elite)."""
        rank = np.empty(len(self._fitness), np.int64)
        order = np.argsort(-self._fitness, kind="stable")  # NaN last, ties by index
        rank[order] = np.arange(len(rank))
        by_rank = np.argsort(rank[self._hoods], axis=1, kind="stable")
        best = np.take_along_axis(self._hoods, by_rank, axis=1)[:, : self.elite]
        return rank <= rank[best[:, -1]], best

    def _evolve(self, best: np.ndarray, stream: Stream) -> None:
        """Replace the cells that do not stay, all at once."""
        settings, count, old = self.settings, len(self._genomes), self._genomes
        draws = stream.uniform(0.0, 1.0 - settings.elite, count)
        partners = best[np.arange(count), stream.integers(self.elite, count)]
        limits = np.add.accumulate([settings.mutation, settings.crossover])
        kinds = np.array(OPERATORS[1:])[np.searchsorted(limits, draws, "right")]
        self._operators = np.full(count, "elite", kinds.dtype)
        self._operators[self._cells] = kinds[self._cells]
        mutated, crossed, renewed = (
            np.flatnonzero(self._operators == name).tolist() for name in OPERATORS[1:]
        )
        parents = [old[partners[cell]] for cell in mutated]
        made = mutants(self.representation, parents, stream, settings)
        cross = self.representation.crossover
        made += [cross(old[cell], old[partners[cell]], stream) for cell in crossed]
        made += self.representation.random(len(renewed), stream)
        self._population = old.copy()
        for cell, genome in zip([*mutated, *crossed, *renewed], made, strict=True):
            self._population[cell] = genome

    def _tell(self, fitness: np.ndarray, measures: np.ndarray) -> None:  # noqa: ARG002  unused
        self._genomes = self._population
        self._fitness[self._cells] = fitness
        stays, _ = self._ranked()
        numbers = {"mean": mean(self._fitness)}
        for name in OPERATORS:
            made = self._operators == name
            count = int(made.sum())
            numbers[f"count_{name}"] = float(count)
            numbers[f"effectivity_{name}"] = int((made & stays).sum()) / max(1, count)
        self._count(fitness, **numbers)

    def statistics(self) -> dict[str, float]:
        """Return the statistics that the class's docstring names."""
        diversity = mean(distances_of_pairs(self.representation, self._genomes))
        return {**self._statistics, "diversity_mean": diversity}


def _hoods(width: int, height: int) -> np.ndarray:
    """Return (cells, 9): numbers of each cell and its neighbours, numbered row after row."""
    cells = np.arange(width * height).reshape(height, width)
    shifts = [(dy, dx) for dy in (1, 0, -1) for dx in (1, 0, -1)]
    return np.stack([np.roll(cells, shift, (0, 1)).ravel() for shift in shifts], axis=1)
