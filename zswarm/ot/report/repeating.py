"""Whether, and on which machines, a run can be repeated bit by bit."""

from collections.abc import Sequence
from typing import NamedTuple

from zswarm.errors import UnknownPlugin
from zswarm.experiment import Experiment
from zswarm.ot.analysis import caveats
from zswarm.ot.record.epochs import DIGESTS, Epoch, epochs
from zswarm.ot.record.reader import Run
from zswarm.plugins import registry as plugins
from zswarm.system.text import clean

LIKE_IT = "any servers, with the optimizer on a machine like that of this run"
LAST_BITS = (
    "on another processor, or with another version of numpy or of its package, its candidates "
    "may differ in the last bits."
)


class Repeats(NamedTuple):
    """Which machines give the history hash of a run again."""

    caveats: list[str]  # why it may be another one on every machine
    where: str  # machines that give the same, unless there are caveats
    why: str = ""  # they are not all machines
    packages: str | None = None  # that computed the run last; None: not recorded


def repeats(run: Run) -> Repeats:
    """Return which machines give the history hash of a run again."""
    complete, known, found = run.experiment, epochs(run), caveats.caveats(run)
    packages = _packages(known[-1]) if known else None
    kind = complete.optimizer.kind
    try:
        portable = plugins.load("optimizer", kind).portable
        why = f"{kind} is not portable: {LAST_BITS}"
    except UnknownPlugin:
        portable = False
        why = f"{kind} is not installed here, and may not be portable: {LAST_BITS}"
    if portable:
        return Repeats(found, f"any machines{_own(complete)}", packages=packages)
    return Repeats([*found, *_several(kind, known)], LIKE_IT, why, packages)


def _several(kind: str, known: Sequence[Epoch]) -> list[str]:
    """Return a caveat if the optimizer, which is not portable, ran in several places."""
    places = dict.fromkeys(
        f"{clean(epoch.machine)}, with {_packages(epoch)}" for epoch in known
    )
    if len(places) < 2:
        return []
    return [
        f"{kind} is not portable, and ran on several machines or with several packages "
        f"({'; '.join(places)}): a run on one of them alone may have another history hash."
    ]


def _own(complete: Experiment) -> str:
    """Return the condition that parts which are not of zswarm put on equal bits, or ""."""
    used: dict[plugins.Kind, str] = {
        "simulator": complete.problem.simulator,
        "representation": complete.representation.kind,
        "ranking": complete.ranking.kind,
        "optimizer": complete.optimizer.kind,
    }
    own = [
        f"{part} {name}"
        for part, name in used.items()
        if name not in plugins.BUNDLED[part]
    ]
    return f", if {' and '.join(own)} keeps the rules for own parts" if own else ""


def _packages(epoch: Epoch) -> str:
    versions = epoch.versions.items()
    return ", ".join(
        clean(f"{name} {version}")
        for name, version in versions
        if name != "zswarm" and not name.startswith(DIGESTS)
    )
