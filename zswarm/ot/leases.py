"""Leases that outlive a call: what a connection evaluates for whoever asks, one problem's at a time.

An optimizer outside calls again and again with a few candidates each. So the leases of the last problem are kept between the
calls, for some seconds; calls of several threads that wait are evaluated together.
"""

import contextlib
import logging
import secrets
import threading
import time
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from zswarm.errors import EvaluationError, Stopped
from zswarm.ot.dispatch import Retracted
from zswarm.ot.evaluations import Evaluations
from zswarm.ot.logger import Logger
from zswarm.ot.problem import Problem
from zswarm.ot.workload import Workload

if TYPE_CHECKING:
    from zswarm.ot.connection import Connection

IDLE_S = 10.0  # without a call; then others may have the slots
LOG = logging.getLogger("zswarm")


class _Call(msgspec.Struct, eq=False):
    """What one thread waits for."""

    problem: Problem
    workload: Workload
    done: bool = False


class _ToLog(Logger):
    """What happens, for whoever listens to the logger ``zswarm`` of Python's ``logging``."""

    def on_say(self, line: str) -> None:
        """See ``Logger``."""
        LOG.info("%s", line)


class Leases:
    """The leases of the problem that was evaluated last; used by any thread."""

    def __init__(self, connection: "Connection") -> None:
        self._connection = connection
        self._stop = threading.Event()
        self._turn = threading.Lock()  # held by the thread that evaluates; it guards what follows
        self._kept: Evaluations | None = None
        self._of = b""
        self._slots = 0  # wanted by what is kept
        self._used = 0.0
        self._calls: list[_Call] = []  # not begun; append and remove are atomic
        self._watch: threading.Thread | None = None

    def evaluate(self, problem: Problem, workload: Workload) -> None:
        """Fill a workload's outcomes.

        Raises:
            EvaluationError: trials cannot be evaluated.
            NoServers: the number of servers asked for was not there in time.
            Stopped: the connection was closed.
        """
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
        """Give the slots to others, unless somebody evaluates now."""
        if self._turn.acquire(blocking=False):
            try:
                self._drop()
            finally:
                self._turn.release()

    def close(self) -> None:
        """End what goes on, for good."""
        self._stop.set()
        with self._turn:
            self._drop()

    def _lead(self, own: _Call) -> None:
        """Evaluate what waits and can be evaluated with this call; it alone if one of them cannot."""
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
            for happened in self._evaluations(of, calls[0].problem, len(together.seeds)).evaluate(together):
                if isinstance(happened, Retracted):
                    LOG.warning("%s computes wrong: what was evaluated on it by earlier calls is doubtful", happened.server)
        except BaseException:  # what is out would come back to the next call
            self._drop()
            raise
        first = 0
        for call in calls:
            after = first + len(call.workload.seeds)
            call.workload.fitness[:], call.workload.metrics[:] = together.fitness[first:after], together.metrics[first:after]
            first, call.done = after, True
            self._forget(call)
        self._used = time.monotonic()
        if self._connection.runs:
            self._drop()

    def _evaluations(self, of: bytes, problem: Problem, slots: int) -> Evaluations:
        if self._stop.is_set():
            raise Stopped("the connection is closed")
        if self._kept is None or self._of != of or slots > self._slots:
            self._drop()
            opened = Evaluations(
                problem,
                self._connection,
                run=f"evaluate-{secrets.token_hex(4)}",
                epoch=0,
                slots=slots,
                probe=b"",
                logger=_ToLog(),
                stop=self._stop,
            )
            opened.__enter__()
            self._kept, self._of, self._slots = opened, of, slots
            for _ in opened.wait():
                pass
        if self._watch is None:
            self._watch = threading.Thread(target=self._release_idle, name="idle-leases", daemon=True)
            self._watch.start()
        return self._kept

    def _release_idle(self) -> None:
        while not self._stop.wait(IDLE_S / 4):
            if time.monotonic() > self._used + IDLE_S:
                self.release()

    def _forget(self, call: _Call) -> None:
        with contextlib.suppress(ValueError):  # whoever waited for it may have been interrupted
            self._calls.remove(call)

    def _drop(self) -> None:
        kept, self._kept = self._kept, None
        if kept is not None:
            kept.__exit__(None, None, None)


def _same_lease(problem: Problem) -> bytes:
    """Equal for problems that differ in their trials only."""
    simulator, representation = problem.experiment.problem, problem.experiment.representation
    return msgspec.json.encode((simulator.simulator, simulator.settings, representation), order="sorted")


def _joined(workloads: list[Workload]) -> Workload:
    if len(workloads) == 1:
        return workloads[0]
    firsts = np.cumsum([0, *(len(workload.genomes) for workload in workloads)])
    return Workload(
        [genome for workload in workloads for genome in workload.genomes],
        np.concatenate([workload.participants + first for workload, first in zip(workloads, firsts[:-1], strict=True)]),
        np.concatenate([workload.seeds for workload in workloads]),
        workloads[0].metrics.shape[1],
    )
