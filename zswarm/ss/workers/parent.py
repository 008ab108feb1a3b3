"""The server's end of a slot's process (``child.py``): starts it, watches it, replaces it.

The fork server starts processes and reports how they ended; while it hangs it does neither.
So a thread asks it for processes, and a killed one is waited for no longer than a moment. Pipes do
not block either (``frames.py``): the server's loop never hangs.
"""

import functools
import math
import multiprocessing
import multiprocessing.forkserver
import multiprocessing.util
import os
import queue
import selectors
import socket
import subprocess
import threading
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from multiprocessing.context import ForkServerProcess
from typing import Protocol

import msgspec
import numpy as np

from zswarm.ss.slots.events import Died, PlayProbe, PrepareSlot, RunChunk
from zswarm.ss.workers import child, memory
from zswarm.ss.workers.child import FromSlot, Here, SharedMemory, encode, from_slot
from zswarm.ss.workers.frames import BrokenFrameError, ServerEnd, new_key, new_pipe
from zswarm.ss.workers.output import Output
from zswarm.system import log, shared_memory
from zswarm.system.processes import exit_reason
from zswarm.system.start import ONE_THREAD
from zswarm.system.text import clean

# Before a process that died early again is replaced.
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.2, 10.0
KILLED_S = 0.2  # for a killed process to go, before the loop continues
EXIT_S = 1.0  # for the fork server to report how a process ended
CUT_OFF = "closed its pipe"  # how it ended if a simulator did that

_context = multiprocessing.get_context("forkserver")


def start_fork_server() -> None:
    """Start the process that slots are forked from.

    It loads numba, so it is to be started before slow imports; and before zenoh is opened.
    """
    os.environ.update(ONE_THREAD)  # a BLAS takes 40 MB for each thread
    # A simulator that iterates over a set of strings then does so in one order in all slots.
    os.environ["PYTHONHASHSEED"] = "0"
    _context.set_forkserver_preload(child.PRELOADED)
    # Its socket is in a private folder, and the current folder is not on its path.
    multiprocessing.util.abstract_sockets_supported = False  # type: ignore[misc]  # once
    multiprocessing.util._args_from_interpreter_flags = _flags  # type: ignore[attr-defined]  # private
    multiprocessing.forkserver.ensure_running()


def _flags() -> list[str]:
    """Return options of Python for the fork server and multiprocessing's own programs."""
    return [*subprocess._args_from_interpreter_flags(), "-P"]  # type: ignore[attr-defined]  # private


class Owner(Protocol):
    """The owner of workers: what they call."""

    def on_message(self, worker: "Worker") -> None:
        """Call ``receive`` until it returns None: something came."""

    def on_output(self, worker: "Worker") -> None:
        """Call ``read_output``: the process wrote something."""

    def on_exit(self, worker: "Worker") -> None:
        """Look for orphans: a process is gone."""

    def on_full_pipe(self, worker: "Worker") -> None:
        """Have the loop call ``watch_pipe``; called in any thread."""


class Worker:
    """The server's end of a slot's process.

    Attributes:
        pipe: to the process; None while none was asked for.
        here: the process has started and is warm.
        leaving: the previous process, which was killed and is not gone yet.
    """

    def __init__(
        self, slot: int, memory_mb: int, selector: selectors.BaseSelector, owner: Owner
    ) -> None:
        self.slot, self.memory_mb = slot, memory_mb
        self.pipe: ServerEnd | None = None
        self.here = False
        self.leaving: ForkServerProcess | None = None
        self._selector, self._owner = selector, owner
        self._shared = _context.RawArray("q", 2)
        self._progress = np.frombuffer(self._shared, np.int64)
        self._process: ForkServerProcess | None = None
        self._start_faults: list[str] = []  # from the thread that asked for the process
        self._output: Output | None = None
        self._words = ""  # the last ones of an output that has ended
        self._prepared = False
        self._held = b""  # a message for the process that is to come
        self._shared_memory: set[str] = set()  # that the process created
        self._early_deaths = 0  # in a row: before any answer
        self._start_at = 0.0
        self._missing_since = math.inf

    # ---- life

    @property
    def session(self) -> int:
        """Return the session of the process and all its children; 0 while there is none."""
        return (
            self._process is not None and self.pipe is not None and self._process.pid
        ) or 0

    @property
    def start_at(self) -> float:
        """Return when to call ``start``, by the monotonic clock; infinite if a process exists."""
        return math.inf if self.leaving is not None else self._start_at

    def start(self) -> None:
        """Ask for the process; ``receive`` returns Here, or logs why it could not be started."""
        self._progress[:] = 0
        self.pipe, child_end = new_pipe(key := new_key())
        output, write_end = _context.Pipe(duplex=False)
        self._output, self._words = Output(output), ""
        self._register(self.pipe, self._on_pipe)
        self._register(self._output, functools.partial(self._owner.on_output, self))
        arguments = child_end, key, self.slot, self._shared, self.memory_mb, write_end
        self._process = _context.Process(target=child.main, args=arguments, daemon=True)
        self._start_faults = []
        self._start_at = math.inf
        self._missing_since = min(self._missing_since, time.monotonic())
        ends = child_end, write_end
        _starter().put(functools.partial(_start, self._process, ends, self._start_faults))

    def kill(self) -> None:
        """Kill the process; a new one is due at once, unless there was a pause already."""
        self._held = b""
        if self.pipe is not None:
            self.close()
            self._start_at = 0.0

    def close(self) -> None:
        """Kill the process for good; one that did not start yet finds its pipe closed."""
        if self.pipe is None or self._process is None:
            return
        self._close_pipes()
        self.here = self._prepared = False
        if self._process.pid is not None:
            self._process.kill()
            self._process.join(KILLED_S)
            if self._process.exitcode is not None:
                self._owner.on_exit(self)
                return
            self.leaving = self._process
            self._register(self.leaving.sentinel, self.look)
            self._missing_since = min(self._missing_since, time.monotonic())

    def look(self) -> None:
        """Check whether the killed process is gone."""
        if self.leaving is not None and self.leaving.exitcode is not None:
            self._selector.unregister(self.leaving.sentinel)
            self.leaving = None
            if self._start_at > time.monotonic():
                self._missing_since = math.inf
            self._owner.on_exit(self)

    def pauses(self, now: float) -> bool:
        """Return whether no process is asked for yet, because several died early."""
        return self.pipe is None and self.leaving is None and self._start_at > now

    def missing_from(self, for_s: float) -> float:
        """Return when the process will have been missing for that long; infinite if it exists."""
        return self._missing_since + for_s

    def missing_reason(self) -> str:
        """Return why the process is missing."""
        if self.leaving is not None:
            return "its process was killed but has not exited"
        if self._process is None or self._process.pid is None:
            return "the fork server does not start its process"
        return "its process started and does not answer"

    # ---- work

    def prepare(self, command: PrepareSlot) -> None:
        """Prepare a problem, in a process that was prepared for no other one."""
        if self._prepared:
            self.kill()
        self._prepared = True
        self._send(encode(command))

    def play_probe(self, command: PlayProbe) -> None:
        """Play trials of the probe."""
        self._send(encode(command))

    def run(self, command: RunChunk) -> None:
        """Evaluate a chunk."""
        self._progress[:] = 0
        self._send(encode(command))

    def answer(self, body: bytes) -> None:
        """Pass on the optimizer's answer to ``Sensors``; from any thread."""
        if (pipe := self.pipe) is not None and not pipe.send(body):
            self._owner.on_full_pipe(self)

    def stop(self) -> None:
        """Stop the chunk before its next trial."""
        self._progress[child.STOP] = 1

    @property
    def stopping(self) -> bool:
        """Return whether the chunk is to stop."""
        return bool(self._progress[child.STOP])

    def trial(self) -> int:
        """Return the trial of the chunk that the process is at; -1 while the chunk is sent."""
        if self.pipe is not None and self.pipe.sending:
            return -1
        return max(0, int(self._progress[child.TRIAL]))

    def receive(self) -> FromSlot | None:
        """Return the next message; None if there is none, or the process could not be started.

        It is Died if the process ended, or wrote something else than messages.
        """
        if self.pipe is None:
            # Killed by what another descriptor of the same turn brought.
            return None
        try:
            if (body := self.pipe.receive()) is None:
                return None
            message = from_slot.decode(body)
        except EOFError:
            return self._ended()
        except (BrokenFrameError, msgspec.DecodeError) as error:
            return self._spoken_over(error)
        if isinstance(message, SharedMemory):
            self._take_shared_memory(message)
            return self.receive()
        if isinstance(message, Here):
            self.here, self._missing_since = True, math.inf
            if self._held:
                self._send(self._held)
            return message
        self._early_deaths = 0
        self._words = ""
        if self._output is not None:
            self._output.forget()
        if isinstance(message, Died):
            self.kill()
        return message

    def _take_shared_memory(self, message: SharedMemory) -> None:
        """Remember what is to be removed when the process has ended."""
        names = self._shared_memory
        (names.add if message.exists else names.discard)(message.name)

    def read_output(self) -> list[str]:
        """Return the lines to log of what the process wrote."""
        if self._output is None:
            return []
        lines = self._output.read()
        if self._output.ended:
            self._selector.unregister(self._output)
            self._words = self._output.last_words()
            self._output.close()
            self._output = None
        return lines

    def _ended(self) -> Died | None:
        if self._start_faults:
            self._close_pipes()
            self._pause(self._start_faults[0])
            return None
        assert self._process is not None  # noqa: S101  it was there to end
        self._held = b""
        self._process.join(EXIT_S)
        reason = exit_reason(self._process.exitcode, CUT_OFF)
        if self._process.exitcode == child.CUT_OFF:
            reason = CUT_OFF
        if (
            words := self._output.last_words()
            if self._output is not None
            else self._words
        ):
            reason += f"; it wrote: {words}"
        trial = max(0, self.trial())
        self._pause(reason)
        self.close()
        return Died(self.slot, trial, f"the slot's process {reason}")

    def _spoken_over(self, error: Exception) -> Died:
        """End a process in which something wrote into the pipe, of which nothing can be trusted."""
        reason = f"the simulator wrote into the pipe of its process: {error}"
        trial = max(0, self.trial())
        self.kill()
        return Died(self.slot, trial, clean(reason))

    def _pause(self, reason: str) -> None:
        """Have a new process started: at once, but after growing pauses if it dies early again."""
        self._early_deaths += 1
        self._start_at, self._missing_since = time.monotonic(), math.inf
        if self._early_deaths > 1:
            pause = min(FIRST_PAUSE_S * 2.0 ** (self._early_deaths - 2), LONGEST_PAUSE_S)
            self._start_at += pause
            log.warning(
                "slot_pauses", slot=self.slot, reason=reason, seconds=round(pause, 1)
            )

    # ---- pipes

    def _send(self, message: bytes) -> None:
        if self.pipe is None or not self.here:
            self._held = message
            return
        self._held = b""
        if not self.pipe.send(message):
            self.watch_pipe()

    def watch_pipe(self) -> None:
        """Have the loop wait until more can be sent, if something is not handed over yet."""
        if (pipe := self.pipe) is None:
            return
        wanted = selectors.EVENT_READ
        if pipe.sending:
            wanted |= selectors.EVENT_WRITE
        self._selector.modify(pipe, wanted, self._on_pipe)

    def _on_pipe(self) -> None:
        """Send on, if something is left to send, and look for messages."""
        if self.pipe is not None and self.pipe.sending and self.pipe.flush():
            self.watch_pipe()
        self._owner.on_message(self)

    def _register(self, file: ServerEnd | Output | int, call: Callable[[], None]) -> None:
        self._selector.register(file, selectors.EVENT_READ, call)

    def _close_pipes(self) -> None:
        for file in (self.pipe, self._output):
            if file is not None:
                self._selector.unregister(file)
                file.close()
        self.pipe = self._output = None
        while self._shared_memory:
            shared_memory.remove(self._shared_memory.pop())


@functools.cache
def _starter() -> queue.SimpleQueue[Callable[[], None]]:
    """Return the queue of a thread that asks for processes, one after the other."""
    calls: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()

    def work() -> None:
        while True:
            calls.get()()

    threading.Thread(target=work, name="starter", daemon=True).start()
    return calls


def _start(
    process: ForkServerProcess,
    its_ends: tuple[socket.socket | Connection, ...],
    faults: list[str],
) -> None:
    try:
        process.start()
        # Python would look at all that it gathers here whenever a process starts, and at its end.
        multiprocessing.process._children.discard(process)  # type: ignore[attr-defined]  # private
    except (OSError, EOFError) as error:  # no process or memory, or the fork server ended
        cause = "the fork server ended" if isinstance(error, EOFError) else str(error)
        faults.append(
            f"could not be started: {cause}; this machine, or the control group of the server, "
            f"has {memory.machine_mb()} MB of memory, which may be too little"
        )
    finally:
        for end in its_ends:
            end.close()  # which wakes the loop if there is no process
