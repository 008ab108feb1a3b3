"""The runs of a study: which there are, what their folders are called, how many go on at the same time. No input or output."""

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import msgspec

from zswarm import experiment
from zswarm.experiment import PARTS, Experiment
from zswarm.protocol.codec import clean
from zswarm.protocol.keys import MAX_ID, fold

MOST_AT_ONCE = 16  # without being told so: each has a thread, a record and a session of its own
DIGEST = 6  # characters of a hash that tells names apart


class Planned(NamedTuple):
    """A run of a study."""

    name: str  # of its folder
    settings: dict[str, Any]  # what it changes of the study's experiment, by path
    seed: int
    experiment: Experiment  # complete


def plan(complete: Experiment, where: str, found: Mapping[str, str] | None = None) -> list[Planned]:
    """The runs of a complete experiment's study: all settings with the first seed, then with the next.

    A run's name follows from its setting and seed. Where two settings have the same name, or a run of something else has it
    already, a hash of the setting is added.

    Args:
        where: what errors call the experiment.
        found: what the runs that are there already are of (``identity``), by folder name.

    Raises:
        ConfigError: a setting is impossible.
    """
    variants, taken, planned = experiment.variants(complete, where), set[str](), list[Planned]()
    found = found or {}
    for seed in range(complete.seed, complete.seed + complete.study.repeat):
        for settings, variant in variants:
            one = msgspec.structs.replace(variant, seed=seed)
            what = identity(one)
            name = next(name for name in _names(settings, seed) if name not in taken and found.get(name, what) == what)
            taken.add(name)
            planned.append(Planned(name, settings, seed, one))
    return planned


def identity(complete: Experiment) -> str:
    """What the history of a run follows from, but for its length."""
    values = msgspec.to_builtins(complete)
    return json.dumps({key: values[key] for key in ("seed", "problem", *PARTS)}, sort_keys=True, default=str)


def label(settings: Mapping[str, Any], others: Sequence[Mapping[str, Any]]) -> str:
    """A setting for people, such as ``hidden 2, population 50``, told apart from others; "" where nothing is changed."""
    paths = {path for setting in others for path in setting}
    return ", ".join(f"{_short(path, paths)} {_value(value)}" for path, value in settings.items())


def another(trials: Sequence[int | None], slots: int, *, at_once: int) -> bool:
    """Whether one more run is to begin.

    Args:
        trials: of the present generation of each run that goes on; None: it did not begin one yet.
        slots: that are ready.
        at_once: how many are to go on; 0: as many as keep the slots busy.
    """
    if at_once:
        return len(trials) < at_once
    if not trials:
        return True
    known = [count for count in trials if count is not None]
    return len(known) == len(trials) < MOST_AT_ONCE and sum(known) < 2 * slots


def _names(settings: Mapping[str, Any], seed: int) -> Iterator[str]:
    """Of a run's folder, the best first."""
    words = "-".join(fold(f"{path.rpartition('.')[2]} {_value(value)}") for path, value in settings.items())
    words = words[: MAX_ID - len(f"-{'x' * DIGEST}-seed-{seed}")].strip("-")
    yield f"{words}-seed-{seed}".lstrip("-")
    what = json.dumps(settings, default=str)  # as they were written: 1 is not 1.0
    for number in range(1000):
        digest = hashlib.blake2b(f"{number} {what}".encode(), digest_size=DIGEST // 2).hexdigest()
        yield f"{words}-{digest}-seed-{seed}".lstrip("-")


def _short(path: str, others: set[str]) -> str:
    """The path's last word, if that tells it from others."""
    last = path.rpartition(".")[2]
    return clean(last if sum(other.rpartition(".")[2] == last for other in others) == 1 else path)


def _value(value: Any) -> str:
    return clean(value if isinstance(value, str) else json.dumps(value, default=str))
