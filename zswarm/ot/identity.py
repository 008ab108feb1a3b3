"""What computes a run on this machine, and how it differs from what did before."""

import platform

from zswarm.experiment import Experiment
from zswarm.ot.record import opening
from zswarm.ot.record.epochs import Epoch
from zswarm.plugins.version_hash import (
    PROPOSING,
    differing,
    proposing,
    version_hash,
    versions,
)
from zswarm.system.text import clean
from zswarm.system.version import VERSION


def here(complete: Experiment, generation: int) -> Epoch:
    """Return the epoch of a run that this process computes from a generation on."""
    parts = complete.problem.simulator, complete.representation.kind
    return Epoch(
        generation=generation,
        version_hash=version_hash(*parts),
        versions={
            "zswarm": VERSION,
            **versions(*parts),
            "Python": platform.python_version(),
            **proposing(complete.optimizer.kind),
        },
        machine=opening.machine(),
    )


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
