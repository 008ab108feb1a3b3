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
KIND_OF = {"problem.settings": "problem.simulator", **{part: part for part in PARTS}}


def groups(runs: Sequence[Run]) -> dict[str, list[Run]]:
    """Group runs that differ at most in name, seed, generations, ``[cluster]`` and ``[study]``.

    Returns:
        Groups by labels such as ``hidden 2, population 50``, or by the experiments' names if there
        is one group, or too much differs for a label.
    """
    together: dict[str, list[Run]] = {}
    settings: dict[str, dict[str, Any]] = {}
    for run in runs:
        values = flat(run.experiment)
        key = json.dumps(values, sort_keys=True)
        together.setdefault(key, []).append(run)
        settings[key] = values
    differing = _differing(list(settings.values()))
    short = len(together) > 1 and len(differing) <= IN_LABEL
    named: dict[str, list[Run]] = {}
    for key, members in together.items():
        chosen = {run.experiment.label for run in members} - {""}
        labels = sorted(chosen)[:1] or [
            _label(name, settings[key][name], differing)
            for name in differing
            if short and name in settings[key]
        ]
        label = ", ".join(labels) or members[0].experiment.name
        if label in named:
            label = f"{label} ({members[0].name})"
        while label in named:
            label += "'"
        named[label] = members
    return named


def renamed(found: dict[str, list[Run]], labels: Sequence[str]) -> dict[str, list[Run]]:
    """Return groups with other names.

    Args:
        labels: such as ``nnga=NNGA``; the order of the names is that of the groups.

    Raises:
        ConfigError: no such group, or two of one name.
    """
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
