"""Group runs that are repeats of each other, and label the groups by what differs."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

import msgspec

from zswarm.errors import ConfigError
from zswarm.experiment import PARTS, Experiment
from zswarm.ot.record.reader import Run
from zswarm.system.text import clean

IN_LABEL = 3  # settings; if more differ, groups have the experiments' names
SIMULATOR, SETTINGS = "problem.simulator", "problem.settings"
KIND_OF = {SETTINGS: SIMULATOR, **{part: part for part in PARTS}}


def groups(runs: Sequence[Run]) -> dict[str, list[Run]]:
    """Group runs that differ at most in name, seed, generations, ``[cluster]`` and ``[study]``.

    Returns:
        Groups by labels such as ``hidden 2, population 50``, or by the experiments' names if there
        is one group, or too much differs for a label. Of several problems, the name of the problem
        follows: ``population 50 (foraging)``.
    """
    together: dict[str, list[Run]] = {}
    for run in runs:
        key = json.dumps(flat(run.experiment), sort_keys=True)
        together.setdefault(key, []).append(run)
    members = list(together.values())
    of_problems = problems([each[0] for each in members])
    labels = _labels(members, of_problems)
    return dict(zip(_told_apart(labels, members), members, strict=True))


def _labels(members: list[list[Run]], of_problems: list[str]) -> list[str]:
    """Return a label for each group, of which several may be the same."""
    settings = [flat(each[0].experiment) for each in members]
    differing = [
        key
        for key in _differing(settings)
        if not (any(of_problems) and _is_of_problem(key))
    ]
    short = len(members) > 1 and len(differing) <= IN_LABEL
    labels = []
    for each, values, problem in zip(members, settings, of_problems, strict=True):
        parts = sorted({run.experiment.label for run in each} - {""})[:1] or [
            _label(name, values[name], differing)
            for name in differing
            if short and name in values
        ]
        name = each[0].experiment.name
        label = ", ".join(parts) or ("" if short else name)
        labels.append(label + in_problem(problem) if label else problem or name)
    return labels


def problems(runs: Sequence[Run]) -> list[str]:
    """Return the name of the problem of each run: its simulator with the simulator's settings.

    All are "" if there is one problem, or if nothing but settings of one simulator differs: then
    these are what is compared.
    """
    flats = [flat(run.experiment) for run in runs]
    found = [
        {key: value for key, value in values.items() if _is_of_problem(key)}
        for values in flats
    ]
    methods = [method(run) for run in runs]
    distinct = {
        json.dumps(one, sort_keys=True): run for one, run in zip(found, runs, strict=True)
    }
    simulators = {run.experiment.problem.simulator for run in runs}
    if len(distinct) == 1 or (
        len(simulators) == 1 and all(one == methods[0] for one in methods)
    ):
        return [""] * len(runs)
    names = dict(zip(distinct, _problem_names(list(distinct.values())), strict=True))
    return [names[json.dumps(one, sort_keys=True)] for one in found]


def method(run: Run) -> dict[str, Any]:
    """Return the settings of a run that do not belong to its problem."""
    values = flat(run.experiment)
    return {key: value for key, value in values.items() if not _is_of_problem(key)}


def in_problem(problem: str) -> str:
    """Return what follows a method in the name of a group; "" if there is one problem."""
    return f" ({problem})" if problem else ""


def renamed(found: dict[str, list[Run]], labels: Sequence[str]) -> dict[str, list[Run]]:
    """Return groups with other names.

    Args:
        labels: such as ``nnga=NNGA``; the order of the names is that of the groups.

    Raises:
        ConfigError: a label without =, no such group, or two of one name.
    """
    for label in labels:
        if not all(label.rpartition("=")[::2]):
            raise ConfigError(f"--label {clean(label)}: expected GROUP=NAME")
    chosen = dict(label.rpartition("=")[::2] for label in labels)
    if unknown := sorted(set(chosen) - set(found)):
        known = "; ".join(clean(group) for group in found)
        raise ConfigError(
            f"--label {clean(unknown[0])}: no such group; there are: {known}"
        )
    names = [clean(chosen.get(group, group)) for group in found]
    if len(set(names)) < len(names):
        raise ConfigError("--label: two groups would have the same name")
    return dict(zip(names, found.values(), strict=True))


def flat(complete: Experiment) -> dict[str, Any]:
    """Return the settings that repeats have in common, by their keys in an experiment file."""
    values = msgspec.to_builtins(complete)
    flat = {part: values[part]["kind"] for part in PARTS}
    for part in PARTS:
        flat |= {
            f"{part}.{key}": value for key, value in values[part]["settings"].items()
        }
    problem = values["problem"]
    flat |= {
        f"problem.settings.{key}": value for key, value in problem.pop("settings").items()
    }
    return flat | {f"problem.{key}": value for key, value in problem.items()}


def _is_of_problem(key: str) -> bool:
    """Return whether a setting makes a problem; trials and their seeds are part of the search."""
    return key == SIMULATOR or key.startswith(f"{SETTINGS}.")


def _problem_names(runs: Sequence[Run]) -> list[str]:
    """Return names of different problems, one run of each: the simplest by which they differ."""
    settings = [flat(run.experiment) for run in runs]
    differing = [key for key in _differing(settings) if _is_of_problem(key)]
    words = [
        [str(values.get(key, "")) for values in settings]
        for key in [SIMULATOR, *differing]
        if all(isinstance(values.get(key, ""), str) for values in settings)
    ]
    ways = [
        *words,
        [run.experiment.name for run in runs],
        [run.folder.resolve().parent.name for run in runs],
        [f"problem {number}" for number in range(1, len(runs) + 1)],
    ]
    if len(differing) <= IN_LABEL:
        labels = [
            ", ".join(
                _label(key, values[key], differing) for key in differing if key in values
            )
            for values in settings
        ]
        ways.insert(len(words), labels)
    return next(names for names in ways if len(set(names)) == len(runs) and all(names))


def _told_apart(labels: Sequence[str], members: Sequence[Sequence[Run]]) -> list[str]:
    """Add to labels that several groups have the name of the study or of the first run."""
    apart = list(labels)
    for label in {label for label in labels if labels.count(label) > 1}:
        same = [index for index, other in enumerate(labels) if other == label]
        folders = [members[index][0].folder.resolve() for index in same]
        names = [folder.parent.name for folder in folders]
        if len(set(names)) < len(names):
            names = [folder.name for folder in folders]
        for index, name in zip(same, names, strict=True):
            apart[index] = label if name == label else f"{label} ({name})"
            while apart[index] in apart[:index]:
                apart[index] += "'"
    return apart


def _differing(settings: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return keys whose values differ; settings of a part only between parts of the same kind."""
    differing = []
    for key in dict.fromkeys(key for flat in settings for key in flat):
        kind = KIND_OF.get(key.rpartition(".")[0], "")
        values: dict[Any, set[str]] = {}
        for flat in settings:
            values.setdefault(flat.get(kind), set()).add(
                json.dumps(flat.get(key), sort_keys=True)
            )
        if any(len(found) > 1 for found in values.values()):
            differing.append(key)
    return differing


def _label(key: str, value: Any, differing: Sequence[str]) -> str:
    """Return ``population 50``, with the full key if the last word is ambiguous."""
    if key in KIND_OF.values():
        return str(value)
    last = key.rpartition(".")[2]
    name = (
        last if sum(other.rpartition(".")[2] == last for other in differing) == 1 else key
    )
    match value:
        case bool() | list() | dict():
            return f"{name} {json.dumps(value)}"
        case float():
            return f"{name} {value:.6g}"
    return f"{name} {value}"
