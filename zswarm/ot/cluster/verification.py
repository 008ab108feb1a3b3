"""Trials that a second server evaluates, too, and which server is wrong if outcomes differ."""

import itertools
from collections.abc import Collection, Iterable

import msgspec
import numpy as np

from zswarm.ot.workload import Workload, one_nan

# Its multiples are evenly distributed in 0..1: no pattern of trials escapes.
GOLDEN = 0.6180339887498949


class Checks(msgspec.Struct, eq=False):
    """The trials of a workload that are to be verified."""

    share: float  # of the trials to come that is verified
    verified: int = 0  # trials for which two servers had the same outcome
    open: set[int] = set()  # trials that are to be verified, or disputed
    # Those of them that no server has, in order, by the server that was counted.
    waiting: dict[str, dict[int, None]] = {}
    count: int = 0  # of these
    _drawn: int = 0  # trials that were chosen, or not
    _disputes: dict[int, dict[str, bytes]] = {}  # outcomes by trial and server

    def clear(self) -> None:
        """Forget all trials: the workload ended."""
        self.open.clear()
        self.waiting.clear()
        self.count = 0
        self._disputes.clear()

    def choose(self, trials: np.ndarray, sources: Iterable[str]) -> None:
        """Choose from counted trials, each with the server whose outcome was counted."""
        if not self.share:
            return
        numbers = np.arange(self._drawn, self._drawn + len(trials))
        self._drawn += len(trials)
        chosen = (numbers * GOLDEN % 1.0 < self.share).tolist()
        counted = zip(trials.tolist(), sources, strict=True)
        for trial, source in itertools.compress(counted, chosen):
            self.open.add(trial)
            self._wait(trial, source)

    def take(self, server: str, limit: int) -> np.ndarray:
        """Take trials for a server that were counted for another one."""
        taken: list[int] = []
        while len(taken) < limit:
            source = next((source for source in self.waiting if source != server), None)
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

    def drop(self, trials: Iterable[int]) -> None:
        """Leave trials unverified."""
        self.open.difference_update(trials)
        waiting, self.waiting, self.count = self.waiting, {}, 0
        for source, of_source in waiting.items():
            for trial in of_source:
                if trial in self.open:
                    self._wait(trial, source)

    def alone(self, servers: Collection[str]) -> list[int]:
        """Return the waiting trials for which none of these servers is a second one."""
        if len(servers) > 1:
            return []
        return [
            trial
            for source, waiting in self.waiting.items()
            if not any(server != source for server in servers)
            for trial in waiting
        ]

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
