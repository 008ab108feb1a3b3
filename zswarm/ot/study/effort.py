"""Tell the effort of a study before it starts, and what makes its settings unequal.

Each setting is built once, and asked for a first and a second generation. Nothing is simulated.
"""

import json
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from msgspec.structs import asdict, replace

from zswarm.config.sections import BudgetConfig, PartConfig, shown
from zswarm.experiment import PARTS, Experiment
from zswarm.ot.analysis.grouping import flat
from zswarm.ot.build import Parts
from zswarm.ot.estimate.sample import Effort, effort, fitting
from zswarm.ot.study.plan import Planned, labels
from zswarm.system.format import plural
from zswarm.system.text import clean

UNEQUAL = 1.1  # ratio of simulations from which on a warning is due
# Generations of a budget in which the last one, for which there may be no room, matters less.
MANY = 12
MOST_ADVISED = 1_000_000_000  # evaluations or simulations
NAMED = 4  # settings that a line names


class Cell(NamedTuple):
    """A setting of a study."""

    label: str
    changes: dict[str, Any]  # by path
    experiment: Experiment
    genes: int | None  # numbers of a genome; None: its length varies
    effort: Effort


def bounded(planned: Sequence[Planned], found: Sequence[Cell]) -> list[Planned]:
    """Return runs with a budget with as many generations as they can need.

    How many candidates a generation has may change on the way, so there is room for more.
    """
    most = {
        repr(one.settings): 2 * cell.effort.generations + 10
        for (_, one), cell in zip(labels(planned), found, strict=True)
    }
    return [
        one._replace(
            experiment=replace(
                one.experiment,
                generations=min(one.experiment.generations, most[repr(one.settings)]),
            )
        )
        for one in planned
    ]


def cells(planned: Sequence[Planned], parts: Sequence[Parts]) -> list[Cell]:
    """Return the settings of a study; ``parts`` are those of the first run of each."""
    return [
        Cell(
            name or "unchanged",
            one.settings,
            one.experiment,
            built.problem.representation.genes,
            effort(built),
        )
        for (name, one), built in zip(labels(planned), parts, strict=True)
    ]


def differing(found: Sequence[Cell]) -> dict[str, list[str]]:
    """Return what differs between settings, by key; "" where a setting has no such key."""
    each_flat = [flat(cell.experiment) for cell in found]
    keys = dict.fromkeys(key for values in each_flat for key in values)
    rows = {
        key: [shown(each[key]) if key in each else "" for each in each_flat]
        for key in keys
    }
    return {key: row for key, row in rows.items() if len(set(row)) > 1}


def contrasts(found: Sequence[Cell]) -> dict[str, list[str]]:
    """Return what the study changes, and what differs between settings that have it.

    The rest are defaults that only one kind has.
    """
    changed = {key for cell in found for key in cell.changes}
    return {
        key: row
        for key, row in differing(found).items()
        if key in changed or len(set(row) - {""}) > 1
    }


def warnings(loaded: Experiment, found: Sequence[Cell]) -> Iterator[str]:
    """Yield what makes a comparison of the settings unfair.

    Args:
        loaded: the study's file as it is written, without defaults.
    """
    unused: dict[tuple[str, str], list[str]] = {}
    for cell in found:
        for setting in _unused(loaded, cell):
            unused.setdefault(setting, []).append(cell.label)
    for (text, why), names in unused.items():
        yield f"{text} does not apply to {'; '.join(names)}: {why}"
    yield from _exceeded(loaded, found)
    counts = [cell.effort.simulations for cell in found]
    if max(counts) > UNEQUAL * min(counts):
        words = f"the settings use from {min(counts):,} to {plural(max(counts), 'simulation')}"
        advised = _equal_budget(found)
        has_one = loaded.study.budget != BudgetConfig()
        how = "nearly equal work change it" if has_one else "a nearly equal budget set"
        how = f"; for {how} in [study], for example, {advised}" if advised else ""
        yield f"{words} a run{how}"


def _exceeded(loaded: Experiment, found: Sequence[Cell]) -> Iterator[str]:
    """Name the settings whose first generation is more than the budget."""
    for unit, limit in asdict(loaded.study.budget).items():
        used = {cell.label: getattr(cell.effort, unit) for cell in found}
        over = [
            f"{name} uses {count:,} ({count - limit:,} too many)"
            for name, count in used.items()
            if count > limit
        ]
        if limit and over:
            yield (
                f"the budget of {plural(limit, unit.removesuffix('s'))} is less than a first "
                f"generation, which is played whole: {listed(over)}"
            )


def _equal_budget(found: Sequence[Cell]) -> str:
    """Return a budget with which the settings do nearly the same work; "" if there is none."""
    efforts = [cell.effort for cell in found]
    for unit, generations in (
        ("evaluations", [(one.first, one.later) for one in efforts]),
        (
            "simulations",
            [(one.first_simulations, one.later_simulations) for one in efforts],
        ),
    ):
        used = [getattr(one, unit) for one in efforts]
        for limit in (min(used), max(used), _rounded(MANY * max(map(max, generations)))):
            lengths = [fitting(limit, *sizes) for sizes in generations]
            work = [
                one.first_simulations + (length - 1) * one.later_simulations
                for one, length in zip(efforts, lengths, strict=True)
            ]
            if max(work) <= UNEQUAL * min(work) and limit <= MOST_ADVISED:
                return f"budget = {{ {unit} = {limit} }}"
    return ""


def _rounded(count: int) -> int:
    """Return the next larger number of two digits and zeros."""
    unit: int = 10 ** max(0, len(str(count)) - 2)
    return -(-count // unit) * unit


def listed(words: Sequence[str]) -> str:
    """Return a list of settings, of which the first are named."""
    more = [f"and {len(words) - NAMED:,} more"] if len(words) > NAMED else []
    return "; ".join([*words[:NAMED], *more])


def _unused(loaded: Experiment, cell: Cell) -> Iterator[tuple[str, str]]:
    """Yield settings of the file that do not reach a setting of the study, and why."""
    for part in PARTS:
        written: PartConfig = getattr(loaded, part)
        used: PartConfig = getattr(cell.experiment, part)
        for key, value in written.settings.items():
            if used.settings.get(key) != value and not _changed(cell, part, key):
                yield f"{part}.{key} = {_toml(value)}", _instead(used, key)
    written_problem, problem = loaded.problem, cell.experiment.problem
    for key, value in written_problem.settings.items():
        if problem.simulator != written_problem.simulator and not _changed(
            cell, "problem.settings", key
        ):
            name = f"problem.settings.{key} = {_toml(value)}"
            yield name, f"the simulator is {problem.simulator} there"


def _changed(cell: Cell, table: str, key: str) -> bool:
    """Return whether a setting of the study gives a key a value of its own."""
    whole = cell.changes.get(table)
    return f"{table}.{key}" in cell.changes or (isinstance(whole, dict) and key in whole)


def _instead(used: PartConfig, key: str) -> str:
    if key not in used.settings:
        return f"{used.kind} has no such setting"
    return f"{used.kind} has {key} = {_toml(used.settings[key])} there"


def _toml(value: Any) -> str:
    return clean(json.dumps(value, default=str))
