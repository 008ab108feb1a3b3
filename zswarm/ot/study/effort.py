"""Tell the effort of a study before it starts, and what makes its settings unequal.

Each setting is built once, and asked for a first and a second generation. Nothing is simulated.
"""

import json
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from msgspec.structs import replace

from zswarm.config.sections import PartConfig, shown
from zswarm.experiment import PARTS, Experiment
from zswarm.ot.analysis.grouping import flat
from zswarm.ot.build import Parts
from zswarm.ot.estimate.sample import Effort, effort
from zswarm.ot.study.plan import Planned, labels
from zswarm.system.format import plural
from zswarm.system.text import clean

UNEQUAL = 1.1  # ratio of simulations from which on a warning is due


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
    """Return what differs between settings that have it; the rest only one kind has."""
    rows = differing(found)
    return {key: row for key, row in rows.items() if len(set(row) - {""}) > 1}


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
    counts = [cell.effort.simulations for cell in found]
    if max(counts) > UNEQUAL * min(counts):
        trials = {cell.experiment.problem.trials for cell in found}
        unit = "evaluations" if len(trials) == 1 else "simulations"
        least = min(getattr(cell.effort, unit) for cell in found)
        yield (
            f"the settings use from {min(counts):,} to {plural(max(counts), 'simulation')} a run; "
            f"for an equal budget set in [study], for example, budget = {{ {unit} = {least} }}"
        )


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
