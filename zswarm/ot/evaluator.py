"""Evaluate candidates for an optimizer of the user's.

Such an optimizer calls again and again with a few candidates each. So the leases for the last
problem are held between calls, for some seconds. Calls of several threads that wait are evaluated
together.
"""

import contextlib
import logging
import math
import operator
import secrets
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, ExitStack
from typing import Any, NamedTuple

import msgspec
import numpy as np

from zswarm import evaluate
from zswarm.errors import EvaluationError, Stopped
from zswarm.ot.cluster.events import (
    Arbitrated,
    Disputed,
    ProbeArbitrated,
    ProbeDisputed,
    Retracted,
)
from zswarm.ot.cluster.shell import Cluster
from zswarm.ot.generation import Assessment
from zswarm.ot.notes import Note, words
from zswarm.ot.problem import Problem, check_whole
from zswarm.ot.workload import Workload
from zswarm.probe import probe as play_probe

IDLE_S = 10.0  # without a call; then others may have the slots
LOG = logging.getLogger("zswarm")


class CandidateOutcomes(NamedTuple):
    """What candidates did, trial by trial."""

    fitness: np.ndarray  # (candidates, trials) float64; NaN: the simulator failed
    metrics: dict[str, np.ndarray]  # each (candidates, trials) float64

    def __repr__(self) -> str:
        candidates, trials = self.fitness.shape
        names = ", ".join(self.metrics) or "none"
        return f"CandidateOutcomes(fitness: {candidates} x {trials}, metrics: {names})"


class _Call(msgspec.Struct, eq=False):
    """What one thread waits for."""

    problem: Problem
    workload: Workload
    done: bool = False


class CandidateEvaluator:
    """Evaluates one problem at a time, for any thread.

    Args:
        cluster: holds leases for a problem: ``Connection.cluster``.
        wait: waits for the number of servers that is asked for: ``Connection.wait``.
        wanted: tells whether a run waits for the slots.
    """

    def __init__(
        self,
        cluster: Callable[..., AbstractContextManager[Cluster]],
        wait: Callable[[Cluster], Any],
        wanted: Callable[[], bool],
    ) -> None:
        self._new_cluster, self._wait, self._wanted = cluster, wait, wanted
        self._stop = threading.Event()
        # Held by the thread that evaluates; it guards what follows.
        self._turn = threading.Lock()
        self._held = ExitStack()
        self._cluster: Cluster | None = None
        self._of = b""  # what the lease is for
        self._slots = 0  # that it asked for
        self._used = 0.0
        self._calls: list[_Call] = []  # not begun; append and remove are atomic
        self._idle: threading.Thread | None = None

    def evaluate(self, problem: Problem, candidates: Any, generation: int) -> np.ndarray:
        """See ``Connection.evaluate``."""
        genomes = _genomes(problem, candidates, generation)
        assessment = Assessment(problem, genomes, generation)
        self.play(problem, assessment.workload)
        while assessment.advance():
            self.play(problem, assessment.workload)
        return assessment.fitness()

    def outcomes(
        self,
        problem: Problem,
        candidates: Any,
        generation: int,
        seeds: Sequence[int] | None,
    ) -> CandidateOutcomes:
        """See ``Connection.outcomes``."""
        genomes = _genomes(problem, candidates, generation)
        simulator, settings = problem.simulator, problem.experiment.problem
        if simulator.participants > 1:
            raise ValueError(
                f"problem: {settings.simulator} is a game of {simulator.participants}: no"
                " candidate has trials of its own; evaluate has candidates play each other"
            )
        chosen = None if seeds is None else np.array(_checked_seeds(seeds), np.uint64)
        workload = problem.workload(genomes, generation, chosen)
        self.play(problem, workload)
        shape = (len(genomes), -1) if genomes else (0, settings.trials)
        columns = {
            name: workload.metrics[:, column].reshape(shape)
            for column, name in enumerate(simulator.metrics)
        }
        return CandidateOutcomes(workload.fitness.reshape(shape), columns)

    def play(self, problem: Problem, workload: Workload) -> None:
        """Fill in a workload's outcomes."""
        if not len(workload.seeds):
            return
        call = _Call(problem, workload)
        self._calls.append(call)
        try:
            with self._turn:
                if not call.done:
                    self._lead(call)
        finally:
            self._forget(call)

    def release(self) -> None:
        """Give the slots to others, unless a thread evaluates now."""
        if self._turn.acquire(blocking=False):
            try:
                self._drop()
            finally:
                self._turn.release()

    def close(self) -> None:
        """End all evaluations, for good."""
        self._stop.set()
        with self._turn:
            self._drop()

    def _lead(self, own: _Call) -> None:
        """Evaluate a call with others that wait; by itself if one of them cannot be evaluated."""
        of = _same_lease(own.problem)
        calls = [call for call in list(self._calls) if _same_lease(call.problem) == of]
        if len(calls) > 1:
            try:
                self._play(of, calls)
                return
            except EvaluationError:
                pass
        self._play(of, [own])

    def _play(self, of: bytes, calls: list[_Call]) -> None:
        together = _joined([call.workload for call in calls])
        try:
            cluster = self._leased(of, calls[0].problem, len(together.seeds))
            for item in cluster.evaluate(together):
                _log(item)
        except BaseException:  # what is still out would come back to the next call
            self._drop()
            raise
        first = 0
        for call in calls:
            trials = slice(first, first + len(call.workload.seeds))
            call.workload.fitness[:] = together.fitness[trials]
            call.workload.metrics[:] = together.metrics[trials]
            first, call.done = trials.stop, True
            self._forget(call)
        self._used = time.monotonic()
        if self._wanted():
            self._drop()

    def _leased(self, of: bytes, problem: Problem, slots: int) -> Cluster:
        """Return a cluster with leases for a problem: the present one if it fits."""
        if self._stop.is_set():
            raise Stopped("the connection is closed")
        if self._cluster is None or self._of != of or slots > self._slots:
            self._drop()
            run = f"evaluate-{secrets.token_hex(4)}"
            held = self._new_cluster(
                problem, run=run, slots=slots, say=_say, wait=_say, stop=self._stop
            )
            self._cluster = self._held.enter_context(held)
            self._of = of
            self._slots = slots
            for item in self._wait(self._cluster):
                _log(item)
        if self._idle is None:
            watch = self._release_idle
            self._idle = threading.Thread(target=watch, name="idle-leases", daemon=True)
            self._idle.start()
        return self._cluster

    def _release_idle(self) -> None:
        while not self._stop.wait(IDLE_S / 4):
            if time.monotonic() > self._used + IDLE_S:
                self.release()

    def _forget(self, call: _Call) -> None:
        # The thread that waited may have been interrupted.
        with contextlib.suppress(ValueError):
            self._calls.remove(call)

    def _drop(self) -> None:
        self._cluster = None
        self._held.close()


def arbitrate(
    problem: Problem, dispute: Disputed | ProbeDisputed, workload: Workload | None
) -> Arbitrated | ProbeArbitrated:
    """Evaluate on this machine what servers disagree about; trials are of the workload."""
    simulator, representation = problem.simulator, problem.representation
    if isinstance(dispute, ProbeDisputed):
        most = dispute.trials
        probe = play_probe(simulator, representation, most, budget_s=math.inf)
        return ProbeArbitrated(probe.digest)
    assert workload is not None  # noqa: S101  a trial is of one
    trials = workload.batch(np.array([dispute.trial]))
    outcomes = evaluate.evaluate(simulator, representation, *trials)
    return Arbitrated(dispute.trial, outcomes.fitness[0], outcomes.metrics[0])


def _log(item: object) -> None:
    match item:
        case Note():
            if line := words(item):
                _say(line)
        case Retracted():
            text = "%s computes wrong: what earlier calls evaluated on it is doubtful"
            LOG.warning(text, item.server)


def _say(line: str) -> None:
    LOG.info("%s", line)


def _genomes(problem: Problem, candidates: Any, generation: int) -> list[bytes]:
    if not isinstance(problem, Problem):
        raise TypeError(
            "problem: expected what zswarm.problem gives, before the candidates, not an object of"
            f" {type(problem).__name__}"
        )
    check_whole("generation", generation)
    return problem.genomes(candidates)


def _checked_seeds(seeds: Any) -> list[int]:
    expected = (
        "seeds: expected a list of whole numbers, one at least, each from 0 to 2^64 - 1"
    )
    try:
        numbers = [operator.index(seed) for seed in seeds]
    except TypeError:
        raise TypeError(f"{expected}, not {seeds!r:.60}") from None
    if not numbers or min(numbers) < 0 or max(numbers) >= 2**64:
        raise ValueError(f"{expected}, not {seeds!r:.60}")
    return numbers


def _same_lease(problem: Problem) -> bytes:
    """Return a key that is equal for problems that differ in their trials only."""
    simulator = problem.experiment.problem
    representation = problem.experiment.representation
    parts = (simulator.simulator, simulator.settings, representation)
    return msgspec.json.encode(parts, order="sorted")


def _joined(workloads: list[Workload]) -> Workload:
    if len(workloads) == 1:
        return workloads[0]
    participants: list[np.ndarray] = []
    genomes: list[bytes] = []
    for workload in workloads:
        participants.append(workload.participants + len(genomes))
        genomes += workload.genomes
    seeds = np.concatenate([workload.seeds for workload in workloads])
    metrics = workloads[0].metrics.shape[1]
    return Workload(genomes, np.concatenate(participants), seeds, metrics)
