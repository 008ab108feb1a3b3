"""One child process per slot: the parent's end (``Worker``) and the child's (``main``).

Children are forked from a fork server that has numba loaded and never touched zenoh. A frame on the pipe is one letter and
a body: ``P`` prepare with the probe, ``Q`` prepare without, ``E`` evaluate; back come ``R`` ready, ``F`` failed, ``O`` done.
A child ends when its pipe closes, and is killed when the fork server ends.
"""

import contextlib
import ctypes
import gc
import hashlib
import multiprocessing
import multiprocessing.forkserver
import os
import signal
import sys
import time
from multiprocessing.connection import Connection

import msgspec
import numpy as np

from zswarm.errors import ConfigError, RemoteProtocolError
from zswarm.protocol import codec
from zswarm.protocol.messages import (
    MAX_TEXT,
    PROBE_GENOMES,
    PROBE_SEEDS,
    Evaluate,
    Message,
    Outcomes,
    Refused,
    Reserve,
)

PRELOADED = ["zswarm.ss.worker", "zswarm.evaluate"]
PR_SET_PDEATHSIG = 1

_context = multiprocessing.get_context("forkserver")


class Ready(msgspec.Struct):
    """What preparing found."""

    probe: bytes
    trial_s: float


def start_fork_server() -> None:
    """Start the process that slots are forked from; before zenoh opens and before slow imports, which it does meanwhile."""
    _context.set_forkserver_preload(PRELOADED)
    multiprocessing.forkserver.ensure_running()


class Worker:
    """The parent's end of a slot's process."""

    def __init__(self) -> None:
        self._shared = _context.RawArray("q", 2)
        self.progress = np.frombuffer(self._shared, np.int64)  # [0] the trial it is at, [1] stop
        self._start()

    def _start(self) -> None:
        self.progress[:] = 0
        self.pipe, child_end = _context.Pipe()
        self.process = _context.Process(target=main, args=(child_end, self._shared), daemon=True)
        self.process.start()
        child_end.close()

    def prepare(self, setup: Reserve, *, probe: bool) -> None:
        """Have it build and warm up a problem."""
        self._send(b"P" if probe else b"Q", codec.encode(setup))

    def evaluate(self, body: bytes) -> None:
        """Have it evaluate an encoded batch."""
        self.progress[:] = 0
        self._send(b"E", body)

    def stop(self) -> None:
        """Have its batch end before the next trial."""
        self.progress[1] = 1

    def receive(self) -> tuple[bytes, bytes]:
        """Letter and body of its next answer.

        Raises:
            EOFError, OSError: the process ended.
        """
        frame = self.pipe.recv_bytes()
        return frame[:1], frame[1:]

    def restart(self) -> str:
        """Kill it, whatever it does, and start a new one; how the old one ended."""
        self.process.kill()
        self.process.join()
        code = self.process.exitcode
        self.pipe.close()
        self._start()
        return f"killed by signal {-code}" if code is not None and code < 0 else f"ended with code {code}"

    def exit_reason(self) -> str:
        """How a process that ended by itself ended; it is replaced."""
        self.process.join(1.0)
        return self.restart()

    def close(self) -> None:
        """End it."""
        self.pipe.close()
        self.process.kill()

    def _send(self, letter: bytes, body: bytes) -> None:
        with contextlib.suppress(OSError):  # it ended; its closed pipe tells the loop
            self.pipe.send_bytes(letter + body)


def main(pipe: Connection, shared: object) -> None:
    """The child: prepare and evaluate until the pipe closes."""
    _end_with_parent()
    # Python hands every child the end of the pipe that keeps the fork server alive: it must end with the server alone.
    os.close(multiprocessing.forkserver._forkserver._forkserver_alive_fd)  # type: ignore[attr-defined]  # private
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)  # the server decides when a slot ends
    progress = np.frombuffer(shared, np.int64)  # type: ignore[call-overload]  # a ctypes array is a buffer
    gc.freeze()
    evaluator = None
    with contextlib.suppress(EOFError, OSError):
        while True:
            frame = pipe.recv_bytes()
            letter, body = frame[:1], frame[1:]
            if letter == b"E":
                assert evaluator is not None  # noqa: S101  the slot table prepares before it runs
                pipe.send_bytes(b"O" + codec.encode(evaluator.evaluate(body, progress)))
                continue
            try:
                evaluator = Evaluator(codec.decode_request(body))  # type: ignore[arg-type]  # prepare carries a Reserve
                pipe.send_bytes(b"R" + msgspec.msgpack.encode(evaluator.warm_up(probe=letter == b"P")))
            except (ConfigError, RemoteProtocolError) as error:
                pipe.send_bytes(b"F" + str(error).encode())


class Evaluator:
    """A problem built in this process."""

    def __init__(self, setup: Reserve) -> None:
        from zswarm import evaluate  # numba comes with it: only here, never in the server's own process

        self._evaluate = evaluate.evaluate
        self.simulator, self.representation = evaluate.build(
            setup.simulator.kind, setup.simulator.settings, setup.representation.kind, setup.representation.settings
        )

    def warm_up(self, *, probe: bool) -> Ready:
        """Compile or load all that a trial needs; the digest of the probe's outcomes and the time of one of its trials.

        The probe is the same everywhere: four random genomes, each on two seeds. Without it one trial is played.
        """
        from zswarm.draws import Stream, derive_seed

        genomes = self.representation.random(PROBE_GENOMES, Stream(derive_seed(0, "probe")))
        k = self.simulator.participants
        participants = np.array(
            [[(genome + i) % PROBE_GENOMES for i in range(k)] for genome in range(PROBE_GENOMES) for _ in range(PROBE_SEEDS)]
        )
        seeds = np.array([derive_seed(0, "probe", trial % PROBE_SEEDS) for trial in range(len(participants))], np.uint64)
        first = self._evaluate(self.simulator, self.representation, genomes, participants[:1], seeds[:1])
        if not probe:
            return Ready(b"", 0.0)
        begin = time.perf_counter()
        rest = self._evaluate(self.simulator, self.representation, genomes, participants[1:], seeds[1:])
        elapsed = time.perf_counter() - begin
        digest = hashlib.blake2b(digest_size=16)
        for outcomes in (first, rest):
            digest.update(outcomes.fitness.astype("<f8").tobytes() + outcomes.metrics.astype("<f8").tobytes())
        return Ready(digest.digest(), elapsed / (len(participants) - 1))

    def evaluate(self, body: bytes, progress: np.ndarray) -> Message:
        """The answer to a batch."""
        begin = time.perf_counter()
        try:
            batch = codec.decode_request(body)
            if not isinstance(batch, Evaluate):
                raise RemoteProtocolError("not a batch")
            participants, seeds = codec.trials(batch, self.simulator.participants)
            outcomes = self._evaluate(self.simulator, self.representation, batch.genomes, participants, seeds, progress)
        except (ValueError, RemoteProtocolError) as error:
            return Refused(code="malformed", reason=str(error)[:MAX_TEXT])
        return Outcomes(
            batch=batch.batch,
            fitness=outcomes.fitness.astype("<f8", copy=False).tobytes(),
            metrics=outcomes.metrics.astype("<f8", copy=False).tobytes(),
            seconds=time.perf_counter() - begin,
            error=codec.clean(outcomes.error),
        )


def _end_with_parent() -> None:
    """Have the kernel kill this process when the fork server ends, even inside a simulator that never returns."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() == 1:
            os._exit(1)  # it ended before the call above
