"""A slot's process: prepare a problem and evaluate chunks until the pipe closes.

It is forked from a fork server that has numba loaded and never touched zenoh. It leads a session,
and no process that it starts has its pipe: so it is over when it ends. It ends when its pipe
closes, and is killed when the fork server ends.

Trials that Python code plays may change the process that later ones are played in. So after each of
them its state is compared with that after preparing, and if something was left behind, the chunk
ends there: the rest of it is played in a new process.
"""

import contextlib
import ctypes
import faulthandler
import gc
import importlib
import math
import mmap
import multiprocessing
import multiprocessing.forkserver
import os
import signal
import socket
import sys
import time
from functools import partial
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
from msgspec.msgpack import Decoder, Encoder

from zswarm.errors import ConfigError, EvaluationError, RemoteProtocolError
from zswarm.kernels.jit import PLAIN, compile_all
from zswarm.plugins.version_hash import version_hash
from zswarm.protocol import codec
from zswarm.protocol.messages import (
    PROBE_TRIALS,
    Outcomes,
    Refused,
    Reserve,
    Sensors,
)
from zswarm.security import keyring
from zswarm.ss.slots.events import (
    Died,
    Exhausted,
    Finished,
    PlayProbe,
    Prepared,
    PrepareSlot,
    Preparing,
    RunChunk,
    SlotEvent,
    SlotMessage,
    Unprepared,
)
from zswarm.ss.workers import memory
from zswarm.ss.workers.frames import BrokenFrameError, ProcessEnd
from zswarm.ss.workers.passing import may_pass
from zswarm.ss.workers.remote import Trial, Unanswered
from zswarm.system import landlock, shared_memory
from zswarm.system.process_state import StateWatch
from zswarm.system.text import clean

# In this order; the fork server binds itself to the server before all that takes long.
FORK_SERVER = "zswarm.ss.workers.fork_server"
PRELOADED = [FORK_SERVER, "zswarm.ss.workers.child", "zswarm.evaluate"]
if not PLAIN:
    PRELOADED.append("zswarm.kernels.compiler")
TRIAL, STOP = range(2)  # the shared numbers, see evaluate.py
MAP_FIXED = 0x10  # the same on Linux and macOS
CUT_OFF = 86  # exit code: a simulator closed or used the pipe to the server


class Here(SlotMessage, frozen=True):
    """The process has started and is warm: numba is loaded."""


class SharedMemory(SlotMessage, frozen=True):
    """A simulator creates shared memory by name, or has removed it."""

    name: str
    exists: bool


# Messages on the pipe; after ``Sensors`` of the wire, the bytes of the optimizer's answer follow.
ToSlot = PrepareSlot | PlayProbe | RunChunk
FromSlot = Here | SharedMemory | Sensors | SlotEvent
encode = Encoder().encode
to_slot: Decoder[ToSlot] = Decoder(ToSlot)
from_slot: Decoder[FromSlot] = Decoder(FromSlot)


def main(
    end: socket.socket,
    key: bytes,
    slot: int,
    shared: object,
    memory_mb: int,
    output: Connection,
) -> None:
    """Run the process of a slot.

    Args:
        end: of the pipe to the server, whose frames begin with the key.
        shared: int64 (2,), the trial that it is at and whether to stop.
        memory_mb: for runs that do not ask for less.
        output: pipe for stdout and stderr.
    """
    if (fork_server := sys.modules.get(FORK_SERVER)) is not None:
        fork_server.end_with_parent(fork_server.PID)
    os.setsid()
    progress = np.frombuffer(shared, np.int64)  # type: ignore[call-overload]  # ctypes is a buffer
    pipe = ProcessEnd(end, key)
    pipe.hide()
    _cut_off_copies(pipe, progress)
    _redirect(output)
    memory.go_first()
    landlock.hide(keyring.folders())
    # Every child inherits the pipe that keeps the fork server alive: it must end with the server.
    os.close(multiprocessing.forkserver._forkserver._forkserver_alive_fd)  # type: ignore[attr-defined]  # private
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)  # the server decides when a slot ends
    for module in PRELOADED[2:]:  # loaded already unless the fork server could not
        importlib.import_module(module)
    gc.freeze()
    gc.enable()
    process = SlotProcess(slot, memory_mb, pipe, progress)
    shared_memory.watch(process.on_shared_memory)
    with contextlib.suppress(EOFError, OSError):
        pipe.send(encode(Here(slot)))
        while True:
            try:
                command = to_slot.decode(pipe.receive())
            except BrokenFrameError:
                os._exit(CUT_OFF)
            pipe.send(encode(process.handle(command)))


class SlotProcess:
    """The loop's state: a problem that was prepared, with a limit of memory."""

    def __init__(
        self, slot: int, memory_mb: int, pipe: ProcessEnd, progress: np.ndarray
    ) -> None:
        # numba comes with it: imported here, never in the server's process
        from zswarm import evaluate
        from zswarm.probe import ALONE_S, probe

        self._evaluate, self._probe, self._alone_s = evaluate, probe, ALONE_S
        self._slot, self._memory_mb = slot, memory_mb
        self._pipe, self._progress = pipe, progress
        self._recycle_at = 0  # bytes
        self._state = StateWatch()
        self._shared_memory: set[str] = set()  # that simulators created
        self._left: list[str] = []  # what a trial left behind

    def handle(self, command: ToSlot) -> SlotEvent:
        """Carry out a command, and return what came of it."""
        try:
            if isinstance(command, RunChunk):
                return self._run(command)
            if isinstance(command, PlayProbe):
                return self._play(command.first, command.count, loaded=True)
            return self._prepare(command)
        except MemoryError:
            memory.lift()
            if isinstance(command, RunChunk) and len(command.work.seeds) > 8:
                return Exhausted(self._slot, self._trial())
            return Died(self._slot, self._trial(), self._too_much(), "memory")
        except EvaluationError as error:  # the program of a foreign simulator ended
            return Died(self._slot, self._trial(), clean(str(error)))
        except (ConfigError, RemoteProtocolError, OSError) as error:
            if isinstance(error, OSError) and isinstance(command, RunChunk):
                raise
            return Unprepared(self._slot, clean(str(error)), may_pass(error))

    def _prepare(self, command: PrepareSlot) -> Prepared:
        """Build a problem, and compile or load all that a trial needs."""
        self._reserve = reserve = command.reserve
        _check_version(reserve)
        memory.restrict(reserve.trial_memory_mb or self._memory_mb)
        self.simulator, self.representation = self._evaluate.build(
            reserve.simulator.kind,
            reserve.simulator.settings,
            reserve.representation.kind,
            reserve.representation.settings,
            hosting=not reserve.asks,
            in_slot=True,
        )
        trials = PROBE_TRIALS if self.simulator.repeatable else 1
        if not reserve.asks:  # else no kernel is needed

            def report(missing: int, kernels: int) -> None:
                self._pipe.send(encode(Preparing(self._slot, missing, trials, kernels)))

            compile_all(report)
        self._pipe.send(encode(Preparing(self._slot, 0, trials)))
        return self._play(command.first, command.most)

    def _play(self, first: int, most: int, *, loaded: bool = False) -> Prepared:
        """Play trials of the probe; what the process has then is what each trial begins with.

        Args:
            most: trials; if it is not loaded, fewer of long ones.
        """
        probe, trial_s = self._probe(
            self.simulator,
            self.representation,
            most,
            first=first,
            budget_s=math.inf if loaded else self._alone_s,
            in_turns=bool(self._reserve.asks),
        )
        limit_mb = self._reserve.trial_memory_mb or self._memory_mb
        self._recycle_at = (memory.used() + (limit_mb << 20)) // 2
        self._state.begin()
        self._known_memory = self._shared_memory.copy()
        return Prepared(self._slot, probe, trial_s, first, loaded)

    def _run(self, command: RunChunk) -> Finished:
        begin, work = time.perf_counter(), command.work
        reply: Outcomes | Refused
        try:
            participants, seeds = codec.trials(work, self.simulator.participants)
            asking = partial(self._asking, command) if self._reserve.asks else None
            self._left = []
            found = self._evaluate.evaluate(
                self.simulator,
                self.representation,
                work.genomes,
                participants,
                seeds,
                self._progress,
                asking,
                self._spoiled,
            )
            played = len(found.fitness)
            reply = Outcomes(
                batch=work.batch,
                fitness=found.fitness.astype("<f8", copy=False).tobytes(),
                metrics=found.metrics.astype("<f8", copy=False).tobytes(),
                seconds=time.perf_counter() - begin,
                trials=b"" if played == len(seeds) else codec.indices(range(played)),
                error=clean(found.error),
                left=clean("; ".join(self._left)),
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

    def _spoiled(self) -> bool:
        """Return whether the last trial left something behind that later ones could meet."""
        if not self._pipe.connected():
            os._exit(CUT_OFF)  # at this trial, which is to blame
        self._left = self._state.left_behind()
        new = sorted(self._shared_memory - self._known_memory)
        self._left += [f"shared memory ({name})" for name in new]
        return bool(self._left)

    def on_shared_memory(self, name: str, exists: bool) -> None:
        """Let the server know: it removes what is there when this process has ended."""
        (self._shared_memory.add if exists else self._shared_memory.discard)(name)
        with contextlib.suppress(OSError):  # a forked copy has no pipe
            self._pipe.send(encode(SharedMemory(self._slot, name, exists)))

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
    """Write stdout and stderr to a pipe, those of C code too, and where a crash was; no stdin."""
    nothing = os.open(os.devnull, os.O_RDONLY)
    if nothing:
        os.dup2(nothing, 0)
        os.close(nothing)
    for number, name in ((1, "stdout"), (2, "stderr")):
        os.dup2(output.fileno(), number)
        options: dict[str, Any] = {"encoding": "utf-8", "errors": "backslashreplace"}
        stream = os.fdopen(number, "w", buffering=1, closefd=False, **options)
        setattr(sys, name, stream)
        setattr(sys, f"__{name}__", stream)
    output.close()
    faulthandler.enable()


def _cut_off_copies(pipe: ProcessEnd, progress: np.ndarray) -> None:
    """Have forked copies of this process, which a simulator may make, do nothing of its work.

    One that returns to the loop finds its pipe closed; before, it gets a page of its own for the
    shared numbers, which tells it to stop.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    libc.mmap.argtypes = [ctypes.c_void_p, ctypes.c_size_t, *[ctypes.c_int] * 3]
    libc.mmap.argtypes += [ctypes.c_long]
    page = progress.ctypes.data & -mmap.PAGESIZE
    protection = mmap.PROT_READ | mmap.PROT_WRITE
    flags = mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS | MAP_FIXED

    def cut_off() -> None:
        pipe.close()
        libc.mmap(page, mmap.PAGESIZE, protection, flags, -1, 0)
        progress[STOP] = 1

    os.register_at_fork(after_in_child=cut_off)
