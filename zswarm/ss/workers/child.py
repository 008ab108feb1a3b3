"""A slot's process: prepare a problem and evaluate chunks until the pipe closes.

It is forked from a fork server that has numba loaded and never touched zenoh. It leads a session,
and no process that it starts has its pipe: so it is over when it ends. It ends when its pipe
closes, and is killed when the fork server ends.
"""

import contextlib
import ctypes
import faulthandler
import gc
import importlib
import multiprocessing
import multiprocessing.forkserver
import os
import signal
import sys
import time
from functools import partial
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
from msgspec.msgpack import Decoder, Encoder

from zswarm.errors import ConfigError, EvaluationError, RemoteProtocolError
from zswarm.kernels.jit import PLAIN
from zswarm.plugins.version_hash import version_hash
from zswarm.protocol import codec
from zswarm.protocol.messages import Outcomes, Refused, Reserve, Sensors
from zswarm.security import keyring
from zswarm.ss.slots.events import (
    Died,
    Exhausted,
    Finished,
    Prepared,
    PrepareSlot,
    RunChunk,
    SlotEvent,
    SlotMessage,
    Unprepared,
)
from zswarm.ss.workers import memory
from zswarm.ss.workers.remote import Trial, Unanswered
from zswarm.system import landlock
from zswarm.system.text import clean

PRELOADED = ["zswarm.ss.workers.child", "zswarm.evaluate"]
if not PLAIN:
    PRELOADED.append("zswarm.kernels.compiler")
PR_SET_PDEATHSIG = 1
TRIAL, STOP = range(2)  # the shared numbers, see evaluate.py


class Here(SlotMessage, frozen=True):
    """The process has started and is warm: numba is loaded."""


# Messages on the pipe; after ``Sensors`` of the wire, the bytes of the optimizer's answer follow.
ToSlot = PrepareSlot | RunChunk
FromSlot = Here | Sensors | SlotEvent
encode = Encoder().encode
to_slot: Decoder[ToSlot] = Decoder(ToSlot)
from_slot: Decoder[FromSlot] = Decoder(FromSlot)


def main(
    pipe: Connection, slot: int, shared: object, memory_mb: int, output: Connection
) -> None:
    """Run the process of a slot.

    Args:
        shared: int64 (2,), the trial that it is at and whether to stop.
        memory_mb: for runs that do not ask for less.
        output: pipe for stdout and stderr.
    """
    _end_with_parent()
    os.setsid()
    os.set_inheritable(pipe.fileno(), False)
    # A forked copy of this process that returns to here finds its pipe closed.
    os.register_at_fork(after_in_child=pipe.close)
    _redirect(output)
    memory.go_first()
    landlock.hide({keyring.SYSTEM, keyring.of_user(), keyring.find() or keyring.SYSTEM})
    # Every child inherits the pipe that keeps the fork server alive: it must end with the server.
    os.close(multiprocessing.forkserver._forkserver._forkserver_alive_fd)  # type: ignore[attr-defined]  # private
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)  # the server decides when a slot ends
    progress = np.frombuffer(shared, np.int64)  # type: ignore[call-overload]  # ctypes is a buffer
    for module in PRELOADED[1:]:  # loaded already unless the fork server could not
        importlib.import_module(module)
    gc.freeze()
    process = SlotProcess(slot, memory_mb, pipe, progress)
    with contextlib.suppress(EOFError, OSError):
        pipe.send_bytes(encode(Here(slot)))
        while True:
            command = to_slot.decode(pipe.recv_bytes())
            pipe.send_bytes(encode(process.handle(command)))


class SlotProcess:
    """The loop's state: a problem that was prepared, with a limit of memory."""

    def __init__(
        self, slot: int, memory_mb: int, pipe: Connection, progress: np.ndarray
    ) -> None:
        # numba comes with it: imported here, never in the server's process
        from zswarm import evaluate

        self._evaluate = evaluate
        self._slot, self._memory_mb = slot, memory_mb
        self._pipe, self._progress = pipe, progress
        self._recycle_at = 0  # bytes

    def handle(self, command: ToSlot) -> SlotEvent:
        """Carry out a command, and return what came of it."""
        try:
            if isinstance(command, RunChunk):
                return self._run(command)
            return self._prepare(command)
        except MemoryError:
            memory.lift()
            if isinstance(command, RunChunk) and len(command.work.seeds) > 8:
                return Exhausted(self._slot, self._trial())
            return Died(self._slot, self._trial(), self._too_much(), "memory")
        except EvaluationError as error:  # the program of a foreign simulator ended
            return Died(self._slot, self._trial(), clean(str(error)))
        except (ConfigError, RemoteProtocolError) as error:
            return Unprepared(self._slot, clean(str(error)))

    def _prepare(self, command: PrepareSlot) -> Prepared:
        """Build a problem, and compile or load all that a trial needs."""
        self._reserve = reserve = command.reserve
        _check_version(reserve)
        limit_mb = reserve.trial_memory_mb or self._memory_mb
        memory.restrict(limit_mb)
        parts = self.simulator, self.representation = self._evaluate.build(
            reserve.simulator.kind,
            reserve.simulator.settings,
            reserve.representation.kind,
            reserve.representation.settings,
            hosting=not reserve.asks,
            in_slot=True,
        )
        probe, trial_s, in_turns = b"", 0.0, bool(reserve.asks)
        if command.probe:
            probe, trial_s = self._evaluate.probe(*parts, in_turns=in_turns)
        else:
            self._evaluate.warm_up(*parts, in_turns=in_turns)
        self._recycle_at = (memory.used() + (limit_mb << 20)) // 2
        # The probe's trials do not ask the optimizer; those of the run take longer.
        return Prepared(self._slot, probe, 0.0 if reserve.asks else trial_s)

    def _run(self, command: RunChunk) -> Finished:
        begin, work = time.perf_counter(), command.work
        reply: Outcomes | Refused
        try:
            participants, seeds = codec.trials(work, self.simulator.participants)
            asking = partial(self._asking, command) if self._reserve.asks else None
            found = self._evaluate.evaluate(
                self.simulator,
                self.representation,
                work.genomes,
                participants,
                seeds,
                self._progress,
                asking,
            )
            reply = Outcomes(
                batch=work.batch,
                fitness=found.fitness.astype("<f8", copy=False).tobytes(),
                metrics=found.metrics.astype("<f8", copy=False).tobytes(),
                seconds=time.perf_counter() - begin,
                error=clean(found.error),
            )
        except Unanswered as error:
            reply = error.refused
        except (ValueError, RemoteProtocolError) as error:
            reply = Refused(code="malformed", reason=clean(str(error)))
        return Finished(self._slot, reply, self._used_up())

    def _asking(self, command: RunChunk, trial: int) -> Trial:
        trial += command.first
        return Trial(
            self._pipe, command.work, trial, self.simulator.outputs, self._reserve.asks
        )

    def _trial(self) -> int:
        return max(0, int(self._progress[TRIAL]))

    def _used_up(self) -> bool:
        """Return whether more than half of the memory that was free after preparing is used."""
        if memory.used() <= self._recycle_at:
            return False
        gc.collect()
        return memory.used() > self._recycle_at

    def _too_much(self) -> str:
        if asked_mb := self._reserve.trial_memory_mb:
            return (
                f"it needs more than the {asked_mb} MB of cluster.trial_memory_mb: raise that, "
                "if servers have more"
            )
        return (
            f"it needs more than the {self._memory_mb} MB of a slot: raise slot_memory_mb of the "
            "server, or run it with fewer slots"
        )


def _check_version(reserve: Reserve) -> None:
    """Check that files, which this process loads now, are those that the server offered."""
    simulator, representation = reserve.simulator.kind, reserve.representation.kind
    if version_hash(simulator, representation) != reserve.version_hash:
        raise ConfigError(
            f"files of {simulator}, {representation} or zswarm changed after the server was "
            "started; start the server again, for a run must not continue with other code"
        )


def _redirect(output: Connection) -> None:
    """Write stdout and stderr to a pipe, those of C code too, and where a crash was."""
    for number, name in ((1, "stdout"), (2, "stderr")):
        os.dup2(output.fileno(), number)
        options: dict[str, Any] = {"encoding": "utf-8", "errors": "backslashreplace"}
        stream = os.fdopen(number, "w", buffering=1, closefd=False, **options)
        setattr(sys, name, stream)
        setattr(sys, f"__{name}__", stream)
    output.close()
    faulthandler.enable()


def _end_with_parent() -> None:
    """Have the kernel kill this process when the fork server ends, even inside a simulator."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        parent = multiprocessing.parent_process()
        if os.getppid() in (1, parent.pid if parent else 1):
            # It ended before the call above, and the server adopted this process.
            os._exit(1)
