"""One child process per slot: the parent's end (``Worker``) and the child's (``main``).

Children are forked from a fork server that has numba loaded and never touched zenoh. A frame on the pipe is one letter and
a body: ``P`` prepare with the probe, ``Q`` prepare without, ``E`` evaluate; back come ``H`` here (once, when the process is
warm), ``R`` ready, ``F`` failed, ``O`` done, ``W`` done and worn (little memory is left), ``X`` exhausted (no memory is left
for the rest of the batch), ``M`` (one trial, or preparing, took all memory), and ``D`` (the program of a foreign simulator
ended in a trial, or in preparing; with the reason). ``S`` asks what controllers elsewhere decide (``asking.py``), and an answer
without a letter comes back. A child ends when its pipe closes, and is killed when the fork server ends.

What a simulator writes to stdout and stderr goes into a second pipe, of which the server logs the first lines and keeps the last.
A child leads a session of its own, and no process that it starts has its pipe: so it is over when the child ends.

The fork server starts processes and reports how they ended; while it stands still it does neither. So a thread asks it for
processes, and what was killed is waited for no longer than a moment: the caller never hangs.
"""

import contextlib
import ctypes
import faulthandler
import functools
import gc
import importlib
import math
import multiprocessing
import multiprocessing.forkserver
import os
import queue
import signal
import sys
import threading
import time
from collections.abc import Callable
from functools import partial
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from zswarm.errors import ConfigError, EvaluationError, RemoteProtocolError
from zswarm.protocol import codec
from zswarm.protocol.messages import Evaluate, Outcomes, Refused, Reserve
from zswarm.ss import memory
from zswarm.ss.asking import Trial, Unanswered
from zswarm.version_hash import version_hash

if TYPE_CHECKING:
    from zswarm.evaluate import Outcomes as Played

PRELOADED = ["zswarm.ss.worker", "zswarm.evaluate"]
PR_SET_PDEATHSIG = 1
ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")  # a slot is one; a BLAS takes 40 MB for each
TRIAL, STOP, FIRST, ALONE, BEGIN = range(5)  # of the shared numbers
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.2, 10.0  # before a process that died early again is started anew
GOING_S = 0.2  # a killed process is waited for, before others go on
ENDING_S = 1.0  # the word on how a process ended is waited for
SAID_LINES = 20  # that a process says, which are logged
SAID_WIDTH = 200  # characters of a line that are logged, or told as last words
SAID_BYTES = 1 << 16  # read at once; of the last ones words are told

_context = multiprocessing.get_context("forkserver")


class Ready(msgspec.Struct):
    """What preparing found."""

    probe: bytes
    trial_s: float


class Rest(msgspec.Struct):
    """Where a batch goes on that its process has no memory for, and what that process finished of it."""

    done: int
    alone: int
    part: Outcomes


class OutOfMemoryError(Exception):
    """One trial took all the memory there is for a slot."""


def start_fork_server() -> None:
    """Start the process that slots are forked from; before zenoh opens and before slow imports, which it does meanwhile."""
    os.environ.update(dict.fromkeys(ONE_THREAD, "1"))
    _context.set_forkserver_preload(PRELOADED)
    multiprocessing.forkserver.ensure_running()


class Worker:
    """The parent's end of a slot's process.

    Attributes:
        pipe: to it; None while none was asked for.
        said: what it says, for ``listen``; None while nothing can come.
        here: it is there and warm: numba is loaded, and it said so.
        leaving: the one before it, which was killed and is not gone yet; ``look`` when its ``sentinel`` can be read.
    """

    def __init__(self, memory_mb: int) -> None:
        self._memory_mb = memory_mb
        # Trial and stop (see evaluate.py), where these begin, a trial to play alone, where in the run's batch this one begins.
        self._shared = _context.RawArray("q", 5)
        self._progress = np.frombuffer(self._shared, np.int64)
        self._process: multiprocessing.context.ForkServerProcess | None = None
        self._unborn: list[str] = []  # why it could not be started, from the thread that tried
        self._said, self._lines = b"", 0  # the last bytes that it said, how many lines of it were logged
        self._prepared = False
        self._held = b""  # a frame for the process that is to come
        self._early_deaths = 0  # in a row: before it answered anything
        self._start_at = 0.0
        self._missed_since = math.inf
        self.pipe: Connection | None = None
        self.said: Connection | None = None
        self.here = False
        self.leaving: multiprocessing.context.ForkServerProcess | None = None

    @property
    def session(self) -> int:
        """Of the process and of all that it starts; 0 while there is none."""
        return (self._process is not None and self.pipe is not None and self._process.pid) or 0

    @property
    def start_at(self) -> float:
        """When to call ``start``, by the monotonic clock; infinite while it is there or the one before it is."""
        return math.inf if self.leaving is not None else self._start_at

    def start(self) -> None:
        """Ask for the process: it says that it is here, or ``receive`` says that it could not be started."""
        self._progress[:] = 0
        self.pipe, child_end = _context.Pipe()
        self.said, saying = _context.Pipe(duplex=False)
        os.set_blocking(self.said.fileno(), False)
        self._process = _context.Process(target=main, args=(child_end, self._shared, self._memory_mb, saying), daemon=True)
        self._unborn, self._said, self._lines = [], b"", 0
        self._start_at = math.inf
        self._missed_since = min(self._missed_since, time.monotonic())
        _starter().put(functools.partial(_start, self._process, (child_end, saying), self._unborn))

    def look(self) -> None:
        """See whether the killed process is gone."""
        if self.leaving is not None and self.leaving.exitcode is not None:
            self.leaving = None
            if self._start_at > time.monotonic():
                self._missed_since = math.inf

    def pauses(self, now: float) -> bool:
        """Whether nothing is asked for yet, because one after the other died."""
        return self.pipe is None and self.leaving is None and self._start_at > now

    def missed(self, now: float, for_s: float) -> str:
        """What is wrong with a process that should be there for so many seconds and is not, or ""."""
        if now < self.missed_from(for_s):
            return ""
        if self.leaving is not None:
            return "its killed process does not go away"
        if self._process is None or self._process.pid is None:
            return "the fork server does not start its process"
        return "its process started and does not answer"

    def missed_from(self, for_s: float) -> float:
        """When ``missed`` will say so if nothing changes; infinite while nothing is waited for."""
        return self._missed_since + for_s

    def trial(self) -> int:
        """The trial that it is at."""
        return max(0, int(self._progress[TRIAL] + self._progress[FIRST]))

    def prepare(self, setup: Reserve, *, probe: bool, known: bool = False) -> None:
        """Have it build and warm up a problem; a process that had another one before makes room for a new process.

        Args:
            known: it had the same one before.
        """
        if self._prepared and not known:
            self.kill()
        self._prepared = True
        self._send(b"P" if probe else b"Q", codec.encode(setup))

    def evaluate(self, body: bytes, first: int, alone: int, begin: int = 0) -> None:
        """Have it evaluate an encoded batch from a trial on, one trial (or -1: none) by itself.

        Args:
            begin: which trial of the run's batch is the first of this one.
        """
        self._progress[:] = 0, 0, first, alone, begin
        self._send(b"E", body)

    def answer(self, body: bytes) -> None:
        """Tell it what the optimizer answered to its question."""
        if (pipe := self.pipe) is not None:  # not when the program ends
            with contextlib.suppress(OSError):  # as in _send
                pipe.send_bytes(body)

    @property
    def stopping(self) -> bool:
        """Whether its batch is to end."""
        return bool(self._progress[STOP])

    def stop(self) -> None:
        """Have its batch end before the next trial."""
        self._progress[STOP] = 1

    def receive(self) -> tuple[bytes, bytes]:
        """Letter and body of what it says next; ``N`` and why when it could not be started, which is due again after a while.

        Raises:
            EOFError, OSError: the process ended.
        """
        assert self.pipe is not None  # noqa: S101  the loop polls pipes that are there
        try:
            frame = self.pipe.recv_bytes()
        except (EOFError, OSError):
            if not self._unborn:
                raise
            self.pipe.close()
            self.pipe = None
            if self.said is not None:
                self.said.close()
                self.said = None
            self._died_early()
            return b"N", self._unborn[0].encode(errors="backslashreplace")
        if frame[:1] == b"H":
            self.here, self._missed_since = True, math.inf
            if self._held:
                self._send(self._held[:1], self._held[1:])
        else:
            self._early_deaths, self._said = 0, b""  # it lived on: these were no last words
        return frame[:1], frame[1:]

    def listen(self) -> list[str]:
        """Lines that it said, to be logged; none beyond the first of a process."""
        assert self.said is not None  # noqa: S101  the loop polls what is there
        try:
            new = os.read(self.said.fileno(), SAID_BYTES)
        except BlockingIOError:
            return []
        if not new:
            self.said.close()
            self.said = None
        begun = self._said[self._said.rfind(b"\n") + 1 :] if self._lines <= SAID_LINES else b""
        self._said = (self._said + new)[-SAID_BYTES:]
        if self._lines > SAID_LINES:
            return []
        whole, _, _ = (begun + new).rpartition(b"\n")
        said = [line.decode(errors="backslashreplace") for line in whole.split(b"\n") if line.strip()]
        lines = said[: SAID_LINES - self._lines]
        self._lines += len(said)
        if self._lines > SAID_LINES:
            lines.append("... what it says more is not logged")
        return lines

    def kill(self) -> None:
        """End it, whatever it does; a new one is due at once, unless one was to be waited for already."""
        self._held = b""
        if self.pipe is not None:
            self.close()
            self._start_at = 0.0

    def exit_reason(self) -> str:
        """How a process that ended by itself ended. A new one is due at once; after a while if it dies early again."""
        assert self._process is not None  # noqa: S101  it was there to end
        self._held = b""
        self._process.join(ENDING_S)
        code = self._process.exitcode
        self._died_early()
        words = self._last_words()
        self.close()
        return _ending(code) + (f"; it said: {words}" if words else "")

    def _last_words(self) -> str:
        """Its last line, or where it was when it crashed."""
        for _ in range(16):  # somebody whom it left behind may go on saying something
            before = self._said
            if self.said is not None:
                self.listen()
            if self._said == before:
                break
        lines = [line.strip() for line in self._said.decode(errors="backslashreplace").splitlines() if line.strip()]
        crash = [number for number, line in enumerate(lines) if line.startswith("Current thread") and number + 1 < len(lines)]
        if crash:
            return f"{lines[crash[-1] - 1]}, {lines[crash[-1] + 1]}"[: 2 * SAID_WIDTH]
        return lines[-1][-SAID_WIDTH:] if lines else ""

    def close(self) -> None:
        """End it for good. One that was asked for and did not start yet ends when it finds its pipe closed."""
        if self.pipe is None or self._process is None:
            return
        self.pipe.close()
        self.pipe, self.here, self._prepared = None, False, False
        if self.said is not None:
            self.said.close()
            self.said = None
        if self._process.pid is not None:
            self._process.kill()
            self._process.join(GOING_S)
            if self._process.exitcode is None:
                self.leaving = self._process
                self._missed_since = min(self._missed_since, time.monotonic())

    def _died_early(self) -> None:
        self._early_deaths += 1
        pause = 0.0 if self._early_deaths < 2 else min(FIRST_PAUSE_S * 2.0 ** (self._early_deaths - 2), LONGEST_PAUSE_S)
        self._start_at = time.monotonic() + pause
        self._missed_since = math.inf

    def _send(self, letter: bytes, body: bytes) -> None:
        if self.pipe is None or not self.here:
            self._held = letter + body
            return
        self._held = b""
        with contextlib.suppress(OSError):  # it ended; its closed pipe tells the loop
            self.pipe.send_bytes(letter + body)


@functools.cache
def _starter() -> queue.SimpleQueue[Callable[[], None]]:
    """What one thread does, one after the other: ask for processes, which takes as long as the fork server wants."""
    waiting: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()

    def work() -> None:
        while True:
            waiting.get()()

    threading.Thread(target=work, name="starter", daemon=True).start()
    return waiting


def _start(process: multiprocessing.context.ForkServerProcess, its_ends: tuple[Connection, ...], unborn: list[str]) -> None:
    try:
        process.start()
        # What Python gathers here it looks at whenever a process starts, and waits for at the program's end.
        multiprocessing.process._children.discard(process)  # type: ignore[attr-defined]  # private
    except (OSError, EOFError) as error:  # the machine has no process or memory left, or the fork server ended
        unborn.append(f"it could not be started: {type(error).__name__}: {error}")
    finally:
        for end in its_ends:
            end.close()  # which tells the loop when there is no process


def _ending(code: int | None) -> str:
    if code is None or code >= 0:
        return f"ended with code {code}" if code is not None else "closed its pipe"
    if -code == signal.SIGKILL:
        return "was killed by signal 9 (the machine may have run out of memory)"
    names = {number.value: f" ({number.name})" for number in signal.Signals}
    return f"was killed by signal {-code}{names.get(-code, '')}"


def main(pipe: Connection, shared: object, memory_mb: int, saying: Connection) -> None:
    """The child: prepare and evaluate until the pipe closes, with so much memory if a run does not ask for less."""
    _end_with_parent()
    os.setsid()
    os.set_inheritable(pipe.fileno(), False)
    os.register_at_fork(after_in_child=pipe.close)  # a copy of this process that goes on here finds that it has nobody to answer
    _speak_into(saying)
    memory.go_first()
    # Python hands every child the end of the pipe that keeps the fork server alive: it must end with the server alone.
    os.close(multiprocessing.forkserver._forkserver._forkserver_alive_fd)  # type: ignore[attr-defined]  # private
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)  # the server decides when a slot ends
    progress = np.frombuffer(shared, np.int64)  # type: ignore[call-overload]  # a ctypes array is a buffer
    importlib.import_module(PRELOADED[1])  # there already where the fork server could load it
    gc.freeze()
    evaluator = None
    too_much = b""
    with contextlib.suppress(EOFError, OSError):
        pipe.send_bytes(b"H")
        while True:
            frame = pipe.recv_bytes()
            letter, body = frame[:1], frame[1:]
            try:
                if letter == b"E":
                    assert evaluator is not None  # noqa: S101  the slot table prepares before it runs
                    pipe.send_bytes(b"".join(evaluator.evaluate(body, progress)))
                    continue
                setup = codec.decode_request(body)
                assert isinstance(setup, Reserve)  # noqa: S101  that is what prepare sends
                _check_version(setup)
                too_much = _too_much(setup.trial_memory_mb, memory_mb).encode()
                evaluator = Evaluator(setup, setup.trial_memory_mb or memory_mb, pipe)
                pipe.send_bytes(b"R" + msgspec.msgpack.encode(evaluator.warm_up(probe=letter == b"P")))
            except (MemoryError, OutOfMemoryError):
                memory.lift()
                pipe.send_bytes(b"M" + too_much)
            except EvaluationError as error:
                pipe.send_bytes(b"D" + str(error).encode(errors="backslashreplace"))
            except (ConfigError, RemoteProtocolError) as error:
                pipe.send_bytes(b"F" + str(error).encode(errors="backslashreplace"))


def _speak_into(saying: Connection) -> None:
    """All that is written to stdout and stderr, by C, too; at a crash also where that was."""
    for number, name in ((1, "stdout"), (2, "stderr")):
        os.dup2(saying.fileno(), number)
        stream = os.fdopen(number, "w", buffering=1, encoding="utf-8", errors="backslashreplace", closefd=False)
        setattr(sys, name, stream)
        setattr(sys, f"__{name}__", stream)
    saying.close()
    faulthandler.enable()


def _too_much(asked_mb: int, memory_mb: int) -> str:
    if asked_mb:
        return f"it needs more than the {asked_mb} MB of cluster.trial_memory_mb: raise that, if servers have more"
    return f"it needs more than the {memory_mb} MB of a slot: raise slot_memory_mb of the server, or run it with fewer slots"


def _check_version(setup: Reserve) -> None:
    """See that the code is still what the server said: this process loads it from files that somebody may have changed since.

    Raises:
        ConfigError: it is not.
    """
    simulator, representation = setup.simulator.kind, setup.representation.kind
    if version_hash(simulator, representation) != setup.version_hash:
        raise ConfigError(
            f"files of {simulator}, {representation} or zswarm changed after the server was started; a run must not go on with "
            "other code: start the server again"
        )


class Evaluator:
    """A problem built in this process, which takes so much memory and no more."""

    def __init__(self, setup: Reserve, limit_mb: int, pipe: Connection) -> None:
        from zswarm import evaluate  # numba comes with it: only here, never in the server's own process

        memory.restrict(limit_mb)
        self._limit = limit_mb << 20
        self._ready = 0  # bytes taken when it was warmed up
        self._evaluate, self._pipe, self._asks = evaluate, pipe, setup.asks
        simulator, representation = setup.simulator, setup.representation
        self.simulator, self.representation = evaluate.build(
            simulator.kind, simulator.settings, representation.kind, representation.settings, hosting=not setup.asks
        )

    def warm_up(self, *, probe: bool) -> Ready:
        """Compile or load all that a trial needs, and play the probe if told."""
        if not probe:
            self._evaluate.warm_up(self.simulator, self.representation, in_turns=bool(self._asks))
            ready = Ready(b"", 0.0)
        else:
            digest, trial_s = self._evaluate.probe(self.simulator, self.representation, in_turns=bool(self._asks))
            ready = Ready(digest, 0.0 if self._asks else trial_s)  # one that asks takes longer
        self._ready = memory.used()
        return ready

    def evaluate(self, body: bytes, progress: np.ndarray) -> tuple[bytes, bytes]:
        """Letter and body of the answer to a batch.

        Raises:
            OutOfMemoryError: the trial that ``progress`` names took all memory, though half of it was there when it began.
        """
        begin = time.perf_counter()
        try:
            batch = codec.decode_request(body)
            if not isinstance(batch, Evaluate):
                raise RemoteProtocolError("not a batch")
            done, alone, pieces = self._play(batch, progress)
        except Unanswered as error:
            return b"O", codec.encode(error.refused)
        except (ValueError, RemoteProtocolError) as error:
            return b"O", codec.encode(Refused(code="malformed", reason=codec.clean(str(error))))
        outcomes = Outcomes(
            batch=batch.batch,
            fitness=b"".join(piece.fitness.astype("<f8", copy=False).tobytes() for piece in pieces),
            metrics=b"".join(piece.metrics.astype("<f8", copy=False).tobytes() for piece in pieces),
            seconds=time.perf_counter() - begin,
            error=next((codec.clean(piece.error) for piece in pieces if piece.error), ""),
        )
        if done * 8 < len(batch.seeds):
            return b"X", msgspec.msgpack.encode(Rest(done, alone, outcomes))
        return b"W" if self._worn() else b"O", codec.encode(outcomes)

    def _play(self, batch: Evaluate, progress: np.ndarray) -> tuple[int, int, list["Played"]]:
        """Trials done, the trial to play alone next (-1: none), and the outcomes of those that this process played.

        All trials that are left are played at once. When memory runs out among them, a new process plays those before the one
        it ran out at, then that one alone, so that it is known whether that one is to blame or what was left behind by others.
        """
        participants, seeds = codec.trials(batch, self.simulator.participants)
        done, alone = int(progress[FIRST]), int(progress[ALONE])
        pieces: list[Played] = []
        for end in sorted({alone, alone + 1, len(seeds)}):
            if end <= done:
                continue
            if pieces and self._worn():
                return done, alone, pieces
            progress[TRIAL], progress[FIRST] = 0, done
            part = slice(done, end)
            asking = partial(self._asking, batch, int(progress[BEGIN]) + done) if self._asks else None
            try:
                pieces.append(
                    self._evaluate.evaluate(
                        self.simulator, self.representation, batch.genomes, participants[part], seeds[part], progress[:FIRST],
                        asking,
                    )
                )  # fmt: skip
            except MemoryError:
                memory.lift()  # there must be enough to say so
                if end - done == 1:
                    raise OutOfMemoryError from None
                return done, done + int(progress[TRIAL]), pieces
            done = end
        return done, -1, pieces

    def _asking(self, batch: Evaluate, begin: int, trial: int) -> Trial:
        return Trial(self._pipe, batch, begin + trial, self.simulator.outputs, self._asks)

    def _worn(self) -> bool:
        """Whether more than half of what was left when it was ready is taken now."""
        if memory.used() <= (self._ready + self._limit) // 2:
            return False
        gc.collect()
        return memory.used() > (self._ready + self._limit) // 2


def _end_with_parent() -> None:
    """Have the kernel kill this process when the fork server ends, even inside a simulator that never returns."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        adopted = multiprocessing.parent_process()
        if os.getppid() in (1, adopted.pid if adopted else 1):
            os._exit(1)  # it ended before the call above, and this process was given to the server
