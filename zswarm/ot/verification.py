"""Counted trials that a second server evaluates too, and who is wrong when the outcomes differ."""

import itertools
from collections.abc import Iterable

import numpy as np

from zswarm.ot.workload import Workload, one_nan

GOLDEN = 0.6180339887498949  # its multiples fall evenly into 0..1: no pattern of trials escapes


class Checks:
    """The trials of a workload that are to be verified."""

    def __init__(self, share: float) -> None:
        """Start with none; ``share`` of the trials will be chosen."""
        self.verified = 0  # trials that two servers gave the same outcome
        self.open: set[int] = set()
        self.waiting: dict[str, dict[int, None]] = {}  # of them, with no server, in order, by the one who was counted
        self._share = share
        self._drawn = 0  # trials that were chosen or not
        self._disputes: dict[int, dict[str, bytes]] = {}  # what is claimed, by trial and server

    def clear(self) -> None:
        """The workload ended."""
        self.open.clear()
        self.waiting.clear()
        self._disputes.clear()

    def choose(self, trials: np.ndarray, sources: Iterable[str]) -> None:
        """Choose from counted trials, each with the server whose outcome was counted."""
        if not self._share:
            return
        numbers = np.arange(self._drawn, self._drawn + len(trials))
        self._drawn += len(trials)
        chosen = numbers * GOLDEN % 1.0 < self._share
        for trial, source in itertools.compress(zip(trials.tolist(), sources, strict=True), chosen.tolist()):
            self.open.add(trial)
            self.waiting.setdefault(source, {})[trial] = None

    def take(self, server: str, limit: int) -> np.ndarray | None:
        """Trials for a server, none of them its own; None when there are none."""
        taken: list[int] = []
        for source in [source for source in self.waiting if source != server]:
            trials = self.waiting[source]
            for trial in list(itertools.islice(trials, limit - len(taken))):
                del trials[trial]
                taken.append(trial)
            if not trials:
                del self.waiting[source]
            if len(taken) == limit:
                break
        return np.array(sorted(taken)) if taken else None

    def give_back(self, trials: np.ndarray, workload: Workload) -> None:
        """A server does not have them any more."""
        for trial in trials.tolist():
            if trial in self.open:
                self.waiting.setdefault(workload.source[trial], {})[trial] = None

    def drop(self, trials: Iterable[int]) -> None:
        """Leave trials unverified."""
        self.open.difference_update(trials)
        left = {source: {trial: None for trial in waiting if trial in self.open} for source, waiting in self.waiting.items()}
        self.waiting = {source: waiting for source, waiting in left.items() if waiting}

    def lonely(self, servers: Iterable[str]) -> list[int]:
        """Waiting trials for which none of these servers is a second one."""
        servers = list(servers)
        return [
            trial
            for source, waiting in self.waiting.items()
            if not any(server != source for server in servers)
            for trial in waiting
        ]

    def compare(self, server: str, trials: np.ndarray, fitness: np.ndarray, metrics: np.ndarray, workload: Workload) -> list[int]:
        """Compare a second server's outcomes bit by bit; the trials where they differ, which are open until settled."""
        disputed = []
        for row, trial in enumerate(trials.tolist()):
            if trial not in self.open or not workload.counted[trial]:
                continue  # what it was to be compared with was retracted
            claim = _bits(fitness[row], metrics[row])
            counted = _bits(workload.fitness[trial], workload.metrics[trial])
            if claim == counted:
                self.verified += 1
                self.open.discard(trial)
            else:
                self._disputes[trial] = {server: claim, workload.source[trial]: counted}
                disputed.append(trial)
        return disputed

    def settle(self, trial: int, fitness: np.ndarray, metrics: np.ndarray) -> list[str]:
        """The servers that were wrong about a disputed trial."""
        claims = self._disputes.pop(trial, {})
        self.open.discard(trial)
        return [server for server, claim in claims.items() if claim != _bits(fitness, metrics)]


def _bits(fitness: np.ndarray, metrics: np.ndarray) -> bytes:
    return one_nan(fitness).tobytes() + one_nan(metrics).tobytes()
