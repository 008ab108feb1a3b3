"""Trials that are with two servers: the first outcome is counted, and the other copy cancelled.

When nothing waits any more, idle slots take trials that other servers are expected to end later: of
a slow machine, behind a slow link, or waiting behind others. A trial takes as long on another slot
that is as fast, so one that is merely long is not started again; but a batch that is later than any
of late was is taken to be stalled.
"""

from collections.abc import Iterable, Iterator

import msgspec
import numpy as np

from zswarm.ot.cluster.idle import IdleServers
from zswarm.ot.cluster.remote_server import RemoteServer, SentBatch
from zswarm.ot.cluster.schedule import Schedule

# A copy is to take at most this share of the time that the first one is expected to take still.
GAIN = 0.8
# A batch is stalled that takes this many times as long as the latest one did, by what was expected.
STALLED = 1.5
JITTER_S = 0.02  # of an answer, beyond what is expected
LATEST = 8.0  # times the expected time: the most that is learned of late batches
FORGET = 0.998  # of the latest one, with each answer
# A server that was given nothing for so long, because it is slow, is measured again by a copy.
MEASURE_S = 30.0
# The same where no trial is started twice: it delays the workload.
MEASURE_ALONE_S = 600.0

# A server, a batch of another one, and the trials of the batch that the server gets.
Again = tuple[RemoteServer, SentBatch, np.ndarray]


class SecondStarts(msgspec.Struct, eq=False):
    """The trials of a workload that are with two servers, or were because the first one failed."""

    schedule: Schedule
    pairs: dict[int, tuple[SentBatch, SentBatch]] = {}  # by trial
    failed_on: dict[int, list[str]] = {}  # by trial: the machines of its failed attempts
    _latest: float = 1.0  # times the expected time: the latest batch of late

    def begin(self, batch: SentBatch, trials: np.ndarray, copy: SentBatch) -> None:
        """Take note that trials of a batch are in another one, too."""
        self.pairs.update(dict.fromkeys(trials.tolist(), (batch, copy)))

    def counted(self, batch: SentBatch, trials: Iterable[int]) -> list[SentBatch]:
        """Drop trials that a batch brought from their other copies.

        Return the batches of which nothing is awaited any more: they are to be cancelled.
        """
        ended = []
        for trial in trials:
            pair = self.pairs.pop(trial, None)
            if pair is not None:
                other = pair[0] if pair[1] is batch else pair[1]
                other.drop(trial)
                if not other.missing:
                    ended.append(other)
        return ended

    def lost(self, batch: SentBatch) -> None:
        """Leave trials that a server does not evaluate to the servers that have them, too."""
        if self.pairs and not batch.check:
            for trial in batch.rest().tolist():
                if self.pairs.pop(trial, None) is not None:
                    batch.drop(trial)

    def answered(self, batch: SentBatch) -> None:
        """Learn from a batch that was answered how late one may be."""
        expected = batch.due - batch.sent_at + JITTER_S
        late = (self.schedule.out.now - batch.sent_at) / expected
        self._latest = min(LATEST, max(1.0, late, FORGET * self._latest))

    def elsewhere(self, batch: SentBatch, trial: int) -> bool:
        """Leave a trial that failed to the other server that has it; return whether one does."""
        paired = not batch.check and self.pairs.pop(trial, None) is not None
        if paired:
            batch.drop(trial)
        return paired

    def failed(self, trial: int, machine: str, ready: set[str]) -> list[str]:
        """Count a failed attempt, and return the machines of all of this trial.

        What a machine says again counts only if no other one is ready for the trial.
        """
        machines = self.failed_on.setdefault(trial, [])
        if machine not in machines or ready <= {*machines}:
            machines.append(machine)
        return machines

    def find(
        self, servers: Iterable[RemoteServer], idle: IdleServers, *, waits: bool
    ) -> Iterator[Again]:
        """Find what idle servers are to start a second time; it must be sent before the next.

        Args:
            servers: all of the run.
            waits: trials wait: only servers that were given nothing for long get one.
        """
        batches = [batch for server in servers for batch in server.batches.values()]
        batches = [batch for batch in batches if not batch.check]
        if not waits:
            yield from self._sooner(idle.all(), batches)
        yield from self._to_measure(idle.spare.values(), batches)

    def _sooner(
        self, servers: list[RemoteServer], batches: list[SentBatch]
    ) -> Iterator[Again]:
        """Find the trials that idle servers are expected to end sooner.

        The last ones of a batch: its server starts them last.
        """
        now = self.schedule.out.now
        rests = [(self._rest_s(batch), batch) for batch in batches]
        rests.sort(key=lambda rest: -rest[0])
        for server in sorted(servers, key=lambda server: server.pace.trial_s):
            for rest_s, batch in rests:
                idle = server.ready - sum(b.missing for b in server.batches.values())
                end = now + GAIN * rest_s
                if idle <= 0 or not self.schedule.fitting(server, 1, end):
                    break
                if batch.server is server or server.machine in batch.avoid:
                    continue
                trials = self._single(batch)
                most = min(len(trials), self.schedule.fits)
                if count := self.schedule.fitting(server, most, end):
                    yield server, batch, trials[-count:]

    def _to_measure(
        self, servers: Iterable[RemoteServer], batches: list[SentBatch]
    ) -> Iterator[Again]:
        """Find a trial for each of the servers that were given nothing for long."""
        for server in servers:
            if self.schedule.out.now - server.pace.batch_at < MEASURE_S:
                continue
            batches.sort(
                key=lambda batch: -batch.due
            )  # of the first ones to end less is seen
            server.pace.outdated = True
            for batch in batches:
                others = batch.server is not server and server.machine not in batch.avoid
                if others and len(trials := self._single(batch)):
                    yield server, batch, trials[-1:]
                    break

    def _single(self, batch: SentBatch) -> np.ndarray:
        """Return the trials of a batch that no other server has or failed at."""
        rest = batch.rest()
        known = self.pairs.keys() | self.failed_on.keys()
        return rest[[trial not in known for trial in rest.tolist()]]

    def _rest_s(self, batch: SentBatch) -> float:
        """Return how long a batch is expected to take still; 0.0 for a late one of long trials."""
        now = self.schedule.out.now
        if batch.due > now:
            return self.schedule.ends(batch) - now
        late = (now - batch.sent_at) / (batch.due - batch.sent_at + JITTER_S)
        return now - batch.sent_at if late > STALLED * self._latest else 0.0
