"""What is done about a server that computes nothing, or whose answer could not be handled."""

from collections.abc import Iterable

import numpy as np

from zswarm.ot.cluster.queue import TrialQueue
from zswarm.ot.cluster.remote_server import RemoteServer, SentBatch
from zswarm.ot.workload import Workload

# Without an outcome, besides the longest time that trials may take: to prepare a slot again (60 s
# and two long trials), and for the query that a server holds.
PATIENCE_S, PATIENCE_TRIALS = 120.0, 2


def patience_s(batch: SentBatch, trial_timeout_s: float) -> float:
    """Return the time in which a server that computes sends an outcome of a batch.

    What it was sent before comes first, and each trial may take its whole time.
    """
    batches = {**batch.server.batches, batch.id: batch}.values()
    trials = sum([one.missing for one in batches]) + PATIENCE_TRIALS
    return trials * trial_timeout_s + PATIENCE_S


def misplaced(
    workload: Workload, queue: TrialQueue, servers: Iterable[RemoteServer]
) -> np.ndarray:
    """Return the trials that are not counted, do not wait, and are with no server."""
    placed = workload.counted.copy()
    for entry in queue.entries:
        placed[entry.trials] = True
    for server in servers:
        for batch in server.batches.values():
            if not batch.check:
                placed[batch.rest()] = True
    return np.flatnonzero(~placed)
