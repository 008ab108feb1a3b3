"""Trials that a second machine evaluates, too, and which server is wrong if outcomes differ."""

import itertools
from collections import Counter
from collections.abc import Callable, Iterable

import msgspec
import numpy as np

from zswarm.ot.cluster.remote_server import RemoteServer, SentBatch
from zswarm.ot.workload import Workload, one_nan

# Its multiples are evenly distributed in 0..1: no pattern of trials escapes.
GOLDEN = 0.6180339887498949


class Checks(msgspec.Struct, eq=False):
    """The trials of a workload that are to be verified, each on another machine than its first."""

    share: float  # of the trials to come that is verified
    machine_of: Callable[[str], str]  # returns the machine of a server
    verified: int = 0  # trials for which two machines had the same outcome
    open: set[int] = set()  # trials that are to be verified, or disputed
    # Those of them that no server has, in order, by the server that was counted.
    waiting: dict[str, dict[int, None]] = {}
    count: int = 0  # of these
    # Trials that were chosen, or not, by machine: the first one of each is.
    _drawn: Counter[str] = msgspec.field(default_factory=Counter)
    _disputes: dict[int, dict[str, bytes]] = {}  # outcomes by trial and server

    def clear(self) -> None:
        """Forget all trials: the workload ended."""
        self.open.clear()
        self.waiting.clear()
        self.count = 0
        self._disputes.clear()

    def choose(self, trials: np.ndarray, source: str) -> None:
        """Choose from trials that were counted for a server."""
        if not self.share:
            return
        machine = self.machine_of(source)
        drawn = self._drawn[machine]
        numbers = np.arange(drawn, drawn + len(trials))
        self._drawn[machine] += len(trials)
        chosen = trials[numbers * GOLDEN % 1.0 < self.share].tolist()
        self.open.update(chosen)
        for trial in chosen:
            self._wait(trial, source)

    def take(self, machine: str, limit: int) -> np.ndarray:
        """Take trials for a machine that were counted for another one."""
        taken: list[int] = []
        while len(taken) < limit:
            others = (one for one in self.waiting if self.machine_of(one) != machine)
            source = next(others, None)
            if source is None:
                break
            trials = self.waiting[source]
            for trial in list(itertools.islice(trials, limit - len(taken))):
                del trials[trial]
                taken.append(trial)
            if not trials:
                del self.waiting[source]
        self.count -= len(taken)
        return np.array(sorted(taken), int)

    def give_back(self, trials: np.ndarray, workload: Workload) -> None:
        """Queue trials again that a server did not evaluate."""
        for trial in trials.tolist():
            if trial in self.open:
                self._wait(trial, workload.source[trial])

    def restored(self, workload: Workload) -> None:
        """Choose from the trials of a workload that an earlier program counted."""
        for source in sorted({*workload.source.tolist()} - {""}):
            self.choose(np.flatnonzero(workload.source == source), source)

    def drop(self, trials: Iterable[int], source: str = "") -> None:
        """Leave trials unverified; the next one of the machine of a source is chosen."""
        self._drawn.pop(self.machine_of(source), None)
        self.open.difference_update(trials)
        waiting, self.waiting, self.count = self.waiting, {}, 0
        for server, of_server in waiting.items():
            for trial in of_server:
                if trial in self.open:
                    self._wait(trial, server)

    def retracted(self, trials: list[int], sent: Iterable[SentBatch]) -> list[SentBatch]:
        """Drop trials that are to be evaluated again, also from batches that verify them.

        Return the batches of which nothing is awaited any more: they are to be cancelled.
        """
        self.drop(trials)
        ended = []
        for batch in sent:
            dropped = {*trials} & {*batch.rest().tolist()} if batch.check else ()
            for trial in dropped:
                batch.drop(trial)
            if dropped and not batch.missing:
                ended.append(batch)
        return ended

    def drop_alone(self, servers: Iterable[RemoteServer]) -> bool:
        """Drop the waiting trials for which none of these servers is of a second machine."""
        machines: set[str] = set()
        for server in servers:
            machines.add(server.machine)
            if len(machines) > 1:
                return False
        alone = [one for one in self.waiting if not machines - {self.machine_of(one)}]
        for source in alone:
            self.drop(list(self.waiting[source]), source)
        return bool(alone)

    def compare(
        self,
        server: str,
        trials: np.ndarray,
        fitness: np.ndarray,
        metrics: np.ndarray,
        workload: Workload,
    ) -> list[int]:
        """Compare a second server's outcomes bit by bit.

        Return the trials where they differ; these stay open until arbitrated.
        """
        disputed = []
        for row, trial in enumerate(trials.tolist()):
            if trial not in self.open or not workload.counted[trial]:
                continue  # the first outcome was retracted
            second = _bits(fitness[row], metrics[row])
            first = _bits(workload.fitness[trial], workload.metrics[trial])
            if first == second:
                self.verified += 1
                self.open.discard(trial)
            else:
                self._disputes[trial] = {server: second, workload.source[trial]: first}
                disputed.append(trial)
        return disputed

    def arbitrate(
        self, trial: int, fitness: np.ndarray, metrics: np.ndarray
    ) -> list[str]:
        """Return the servers that were wrong about a disputed trial."""
        outcomes = self._disputes.pop(trial, {})
        self.open.discard(trial)
        right = _bits(fitness, metrics)
        return [server for server, outcome in outcomes.items() if outcome != right]

    def _wait(self, trial: int, source: str) -> None:
        waiting = self.waiting.setdefault(source, {})
        self.count += trial not in waiting
        waiting[trial] = None


def _bits(fitness: np.ndarray, metrics: np.ndarray) -> bytes:
    return one_nan(fitness).tobytes() + one_nan(metrics).tobytes()
