"""The trials of a workload that wait for a server, in the order in which they are sent."""

from collections import deque
from collections.abc import Mapping

import msgspec
import numpy as np

from zswarm.ot.cluster.remote_server import RemoteServer, SentBatch


class QueuedTrials(msgspec.Struct, eq=False):
    """Trials that wait, as indices into the workload."""

    trials: np.ndarray
    # Machines on which one of them ended in a fault, or that had them too long.
    avoid: frozenset[str] = frozenset()
    # Their batch, which a server may still have. It resumes the batch as a whole, unless another
    # server took some of these trials: a batch can only be cancelled as a whole.
    stranded: SentBatch | None = None


class TrialQueue(msgspec.Struct, eq=False):
    """A queue of trials; those that come back go to its front."""

    count: int = 0  # of its trials
    entries: deque[QueuedTrials] = msgspec.field(default_factory=deque)

    def put(self, entry: QueuedTrials) -> None:
        """Add trials, at least one."""
        self.count += len(entry.trials)
        self.entries.appendleft(entry)

    def take(
        self, machine: str, size: int, ready: Mapping[str, RemoteServer]
    ) -> QueuedTrials | None:
        """Take at most ``size`` trials for a server of a machine.

        They come with the batch that they were stranded in, if any: it is to be cancelled, and
        what is left of it waits like any trials. A machine gets trials that should avoid it only if
        they should avoid all that are ready, and with a size of 0 one trial that others should
        avoid. Return None if there is nothing for this server.
        """
        for entry in self.entries:
            allowed = machine not in entry.avoid or all(
                server.machine in entry.avoid for server in ready.values()
            )
            if allowed and (size or entry.avoid):
                break
        else:
            return None
        size = max(1, size)
        if size >= len(entry.trials):
            self.remove(entry)
            return entry
        taken = QueuedTrials(entry.trials[:size], entry.avoid, entry.stranded)
        entry.trials, entry.stranded = entry.trials[size:], None
        self.count -= size
        return taken

    def stranded(self, server: RemoteServer) -> list[QueuedTrials]:
        """Return all trials that are still stranded on a server."""
        return [
            entry
            for entry in self.entries
            if entry.stranded and entry.stranded.server is server
        ]

    def remove(self, entry: QueuedTrials) -> None:
        """Remove an entry."""
        self.entries.remove(entry)
        self.count -= len(entry.trials)

    def clear(self) -> list[SentBatch]:
        """Remove all trials; return the batches that some were stranded in."""
        stranded = [entry.stranded for entry in self.entries if entry.stranded]
        self.entries.clear()
        self.count = 0
        return stranded
