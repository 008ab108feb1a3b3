"""Epochs of a run: what computed from its start, and from each resume, on.

The event ``began`` holds one as JSON. A run that different code computed is marked wherever its
result is shown.
"""

from collections.abc import Iterable, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING

import msgspec

from zswarm.ot.notes import RunEvent
from zswarm.system.text import clean

if TYPE_CHECKING:
    from zswarm.ot.record.reader import Run

TEXTS = f"SELECT text FROM events WHERE event = '{RunEvent.BEGAN}' ORDER BY rowid"  # noqa: S608

DIGESTS = ("code of ", "build of ")  # which tell a reader nothing


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


def epochs(run: "Run") -> list[Epoch]:
    """Return the epochs of a run."""
    return decoded(text for (text,) in run.rows(TEXTS, tuple[str | None]))


def decoded(texts: Iterable[str | None]) -> list[Epoch]:
    """Return the epochs that texts of events hold; other texts are skipped."""
    found = []
    for text in texts:
        with suppress(msgspec.DecodeError, msgspec.ValidationError, UnicodeDecodeError):
            found.append(msgspec.json.decode(text or "", type=Epoch))
    return found


def shown(event: str, text: str) -> str:
    """Return an event's text for people: of an epoch, what computes and where."""
    found = decoded([text]) if event == RunEvent.BEGAN else []
    if not found:
        return text
    packages = [
        f"{name} {version}"
        for name, version in found[0].versions.items()
        if not name.startswith(DIGESTS)
    ]
    return clean(f"{', '.join(packages)}; on {found[0].machine}")


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
        if not name.startswith(DIGESTS)
        and len({span.epoch.versions.get(name) for span in spans}) > 1
    ]
    texts = []
    for span in spans:
        known = span.epoch.versions
        also = ", ".join(f"{name} {known.get(name, 'none')}" for name in shown)
        by = span.epoch.version_hash[:8] + (f" ({also})" if also else "")
        texts.append(f"{span.first + 1}-{span.last + 1} by {by}")
    return clean(f"computed by {len(hashes)} versions: generations {', '.join(texts)}")


def _spans(found: Sequence[Epoch], generations: int) -> list[Span]:
    """Return the spans of finished generations, in order; neighbours of one version are joined."""
    spans: list[Span] = []
    for at, epoch in enumerate(found):
        # A run may go back to an earlier generation, and be computed anew from there.
        end = min([generations, *(later.generation for later in found[at + 1 :])])
        if end <= epoch.generation:  # it finished none
            continue
        if spans and spans[-1].epoch.version_hash == epoch.version_hash:
            spans[-1].last = end - 1
        else:
            spans.append(Span(epoch.generation, end - 1, epoch))
    return spans
