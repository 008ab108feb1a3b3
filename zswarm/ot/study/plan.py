"""Plan a study: its runs, the names of their folders, and how many run at a time. No I/O."""

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import msgspec

from zswarm import experiment
from zswarm.config.sections import shown
from zswarm.experiment import PARTS, Experiment
from zswarm.protocol.keys import MAX_ID, fold
from zswarm.system.text import clean

MOST_AT_ONCE = 16  # by default: each has a thread, a record and a session
DIGEST = 6  # characters of a hash that distinguishes names


class Planned(NamedTuple):
    """A run of a study."""

    name: str  # of its folder
    settings: dict[str, Any]  # changes to the study's experiment, by path
    seed: int
    experiment: Experiment  # complete


def plan(
    complete: Experiment, where: str, found: Mapping[str, str] | None = None
) -> list[Planned]:
    """Return the runs of a study: all settings with the first seed, then with the next.

    A run's name follows from its setting and seed. Where two settings have the same name, or
    another run has it already, a hash of the setting is added.

    ``found`` has the ``identity`` of existing runs, by folder name.

    Raises:
        ConfigError: a setting is impossible.
    """
    variants = experiment.variants(complete, where)
    taken = set[str]()
    planned = list[Planned]()
    found = found or {}
    for seed in range(complete.seed, complete.seed + complete.study.repeat):
        for settings, variant in variants:
            one = msgspec.structs.replace(variant, seed=seed)
            what = identity(one)
            names = _names(settings, seed, variant.label)
            free = (name for name in names if name not in taken)
            name = next(name for name in free if found.get(name, what) == what)
            taken.add(name)
            planned.append(Planned(name, settings, seed, one))
    return planned


def first_of_each(planned: Sequence[Planned]) -> list[Planned]:
    """Return the run of each setting with the first seed."""
    return [one for one in planned if one.seed == planned[0].seed]


def identity(complete: Experiment) -> str:
    """Return everything that determines the history of a run, except its length."""
    values = msgspec.to_builtins(complete)
    known = {key: values[key] for key in ("seed", "problem", *PARTS)}
    return json.dumps(known, sort_keys=True, default=str)


def label(settings: Mapping[str, Any], others: Sequence[Mapping[str, Any]]) -> str:
    """Describe a setting by its changes, such as ``hidden 2, population 50``, in distinct words."""
    paths = {path for setting in others for path in setting}
    return ", ".join(
        f"{_short(path, paths)} {shown(value)}" for path, value in settings.items()
    )


def labels(planned: Sequence[Planned]) -> list[tuple[str, Planned]]:
    """Return each setting's label, the chosen one or its changes, and its first run."""
    firsts = first_of_each(planned)
    others = [one.settings for one in firsts]
    return [
        (clean(one.experiment.label) or label(one.settings, others), one)
        for one in firsts
    ]


def another(trials: Sequence[int | None], slots: int, *, at_once: int) -> bool:
    """Return whether one more run should begin.

    Args:
        trials: of the current generation of each run in progress; None: before its first one.
        slots: those that are ready.
        at_once: how many runs to have in progress; 0: as many as keep the slots busy.
    """
    if at_once:
        return len(trials) < at_once
    if not trials:
        return True
    known = [count for count in trials if count is not None]
    return len(known) == len(trials) < MOST_AT_ONCE and sum(known) < 2 * slots


def _names(settings: Mapping[str, Any], seed: int, chosen: str = "") -> Iterator[str]:
    """Yield names for a run's folder, the best first."""
    changes = (
        (path.rpartition(".")[2], shown(value)) for path, value in settings.items()
    )
    words = (
        fold(chosen)
        if chosen
        else "-".join(fold(f"{key} {value}") for key, value in changes)
    )
    words = words[: MAX_ID - len(f"-{'x' * DIGEST}-seed-{seed}")].strip("-")
    yield f"{words}-seed-{seed}".lstrip("-")
    what = json.dumps(settings, default=str)  # as they were written: 1 is not 1.0
    for number in range(1000):
        digest = hashlib.blake2b(
            f"{number} {what}".encode(), digest_size=DIGEST // 2
        ).hexdigest()
        yield f"{words}-{digest}-seed-{seed}".lstrip("-")


def _short(path: str, others: set[str]) -> str:
    """Return the path's last word, if no other path ends in it."""
    last = path.rpartition(".")[2]
    return clean(
        last if sum(other.rpartition(".")[2] == last for other in others) == 1 else path
    )
