"""Counted trials that a second server evaluates too, and who is wrong when the outcomes differ."""

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
        self.waiting: list[int] = []  # of them, with no server
        self._share = share
        self._drawn = 0  # trials that were chosen or not
        self._disputes: dict[int, dict[str, bytes]] = {}  # what is claimed, by trial and server

    def clear(self) -> None:
        """The workload ended."""
        self.open.clear()
        self.waiting.clear()
        self._disputes.clear()

    def choose(self, trials: np.ndarray) -> None:
        """Choose from counted trials."""
        if not self._share:
            return
        numbers = np.arange(self._drawn, self._drawn + len(trials))
        self._drawn += len(trials)
        chosen = trials[numbers * GOLDEN % 1.0 < self._share].tolist()
        self.open.update(chosen)
        self.waiting += chosen

    def take(self, server: str, limit: int, workload: Workload) -> np.ndarray | None:
        """Trials for a server, none of them its own; None when there are none."""
        taken = [trial for trial in self.waiting if workload.source[trial] != server][:limit]
        self.waiting = sorted(set(self.waiting) - set(taken))
        return np.array(taken) if taken else None

    def give_back(self, trials: np.ndarray) -> None:
        """A server does not have them any more."""
        self.waiting += [trial for trial in trials.tolist() if trial in self.open]

    def drop(self, trials: Iterable[int]) -> None:
        """Leave trials unverified."""
        self.open.difference_update(trials)
        self.waiting = [trial for trial in self.waiting if trial in self.open]

    def lonely(self, servers: set[str], workload: Workload) -> list[int]:
        """Waiting trials for which none of these servers is a second one."""
        return [trial for trial in self.waiting if not servers - {workload.source[trial]}]

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
