"""Epochs of a run: what computed from its start, and from each resume, on.

The event ``began`` holds one as JSON. A run that different code computed is marked wherever its
result is shown.
"""

import platform
from collections.abc import Iterable, Sequence
from contextlib import suppress
from importlib.metadata import version

import msgspec

from zswarm.experiment import Experiment
from zswarm.ot.notes import RunEvent
from zswarm.ot.record import opening
from zswarm.ot.record.reader import Run
from zswarm.plugins import registry as plugins
from zswarm.plugins.version_hash import CODE, differing, version_hash, versions
from zswarm.system.text import clean
from zswarm.system.version import VERSION

TEXTS = f"SELECT text FROM events WHERE event = '{RunEvent.BEGAN}' ORDER BY rowid"  # noqa: S608
# Packages that propose candidates, by optimizer.
PROPOSING = {"cmaes": "cmaes", "cma-me": "ribs", "map-elites": "ribs"}


class Epoch(msgspec.Struct, frozen=True, kw_only=True):
    """What computes a run from one start or resume to the next."""

    generation: int  # the first that it computes, or finishes
    version_hash: str
    versions: dict[str, str]  # of zswarm, Python and packages; digests of code
    machine: str

    @property
    def text(self) -> str:
        """Return the epoch as JSON."""
        return msgspec.json.encode(self).decode()


class Span(msgspec.Struct):
    """Generations that one version of the code computed."""

    first: int
    last: int
    epoch: Epoch


def here(complete: Experiment, generation: int) -> Epoch:
    """Return the epoch of a run that this process computes from a generation on."""
    parts = complete.problem.simulator, complete.representation.kind
    optimizer = complete.optimizer.kind
    packages = {
        name: version(name) for kind, name in PROPOSING.items() if kind == optimizer
    }
    return Epoch(
        generation=generation,
        version_hash=version_hash(*parts),
        versions={
            "zswarm": VERSION,
            **versions(*parts),
            "Python": platform.python_version(),
            **packages,
            **plugins.distribution_versions("optimizer", optimizer),
        },
        machine=opening.machine(),
    )


def epochs(run: Run) -> list[Epoch]:
    """Return the epochs of a run."""
    return decoded(text for (text,) in run.rows(TEXTS, tuple[str | None]))


def decoded(texts: Iterable[str | None]) -> list[Epoch]:
    """Return the epochs that texts of events hold; other texts are skipped."""
    found = []
    for text in texts:
        with suppress(msgspec.DecodeError, msgspec.ValidationError, UnicodeDecodeError):
            found.append(msgspec.json.decode(text or "", type=Epoch))
    return found


def mark(found: Sequence[Epoch], generations: int) -> str:
    """Return which versions computed which generations, or "" if one computed all.

    Args:
        found: the epochs of the run.
        generations: how many it has finished.
    """
    spans = _spans(found, generations)
    hashes = {span.epoch.version_hash for span in spans}
    if len(hashes) < 2:
        return ""
    names = dict.fromkeys(name for span in spans for name in span.epoch.versions)
    shown = [
        name
        for name in names
        if not name.startswith(CODE)
        and len({span.epoch.versions.get(name) for span in spans}) > 1
    ]
    texts = []
    for span in spans:
        known = span.epoch.versions
        also = ", ".join(f"{name} {known.get(name, 'none')}" for name in shown)
        by = span.epoch.version_hash[:8] + (f" ({also})" if also else "")
        texts.append(f"{span.first}-{span.last} by {by}")
    return clean(f"computed by {len(hashes)} versions: generations {', '.join(texts)}")


def change(before: Epoch, now: Epoch, *, portable: bool) -> str:
    """Return how what computes now differs from what did before, or "".

    Args:
        portable: the optimizer computes the same on every machine.
    """
    different = "; ".join(differing(now.versions, before.versions))
    if now.version_hash != before.version_hash:
        return clean(different or "other code")
    if portable:
        return ""
    packages = {"Python", *PROPOSING.values()}
    own, theirs = (
        {name: found for name, found in epoch.versions.items() if name in packages}
        for epoch in (now, before)
    )
    return clean("; ".join(differing(own, theirs)))


def _spans(found: Sequence[Epoch], generations: int) -> list[Span]:
    """Return the spans of finished generations, in order; neighbours of one version are joined."""
    spans: list[Span] = []
    for at, epoch in enumerate(found):
        end = found[at + 1].generation if at + 1 < len(found) else generations
        if end <= epoch.generation:  # it finished none
            continue
        if spans and spans[-1].epoch.version_hash == epoch.version_hash:
            spans[-1].last = end - 1
        else:
            spans.append(Span(epoch.generation, end - 1, epoch))
    return spans
