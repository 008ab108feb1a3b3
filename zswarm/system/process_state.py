"""What a process has: files, threads, timers, limits. It shows what a trial left behind."""

import contextlib
import functools
import gc
import os
import resource
import select
import signal
import sys
import threading
import time
from collections.abc import Sequence
from typing import NamedTuple

from zswarm.system.format import plural

DESCRIPTORS = "/proc/self/fd" if sys.platform == "linux" else "/dev/fd"
TASKS = "/proc/self/task"
STATUS, STATUS_BYTES = "/proc/self/status", 1 << 14
TIMERS = (signal.ITIMER_REAL, signal.ITIMER_VIRTUAL, signal.ITIMER_PROF)
THREADS_SIGNALS = (
    3 << 31
)  # 32 and 33, which the C library handles from the first thread on
NO_TIMERS = [(0.0, 0.0)] * len(TIMERS)
LIMITS = {
    getattr(resource, name): name.removeprefix("RLIMIT_")
    for name in sorted(dir(resource), reverse=True)  # NOFILE rather than its alias OFILE
    if name.startswith("RLIMIT_")
}
# For threads that are ending, before they count as left behind.
ENDING_S, ENDING_STEP_S = 0.05, 0.001


class ProcessState(NamedTuple):
    """What this process has now, as far as one part of a program can spoil it for the next."""

    files: frozenset[str]  # descriptors
    streams: list[tuple[int, int]]  # device and inode of stdin, stdout and stderr
    threads: int
    umask: str
    signals: tuple[int, ...]  # blocked, ignored and caught, a bit each; () if not known
    timers: list[bool]  # which are armed
    limits: list[tuple[int, int]]
    recursion: int
    folder: str
    environment: dict[bytes, bytes]


def process_state() -> ProcessState:
    """Return what this process has now; that takes some 30 us, see ``StateWatch``."""
    threads, umask, signals = _kernel_status()
    return ProcessState(
        _files(),
        [_identity(number) for number in range(3)],
        threads,
        umask,
        signals,
        [signal.getitimer(timer)[0] > 0 for timer in TIMERS],
        [resource.getrlimit(limit) for limit in LIMITS],
        sys.getrecursionlimit(),
        _folder(),
        dict(os.environ._data),  # type: ignore[attr-defined]  # private: os.environ decodes
    )


@functools.cache
def _opened(process: int) -> Sequence[int]:  # noqa: ARG001  a fork has its own
    """Return descriptors of the threads, of the status, and of the descriptors."""
    try:
        return [os.open(path, os.O_RDONLY) for path in (TASKS, STATUS, DESCRIPTORS)]
    except OSError:  # not Linux
        return []


class StateWatch:
    """Look often for what was left behind: that takes a third of the time of ``process_state``.

    Linux counts descriptors and threads, so these are not listed: where all known descriptors are
    open and there are as many as before, these are the same. Where the system does not count, the
    whole state is compared.

    Attributes:
        before: the state that later ones are compared with.
    """

    def __init__(self) -> None:
        self._opened = _opened(os.getpid())
        self.begin()

    def begin(self) -> None:
        """Compare with the state of now, and with no timer."""
        self.before = process_state()._replace(timers=[False] * len(TIMERS))
        self._known = select.poll()
        for number in self.before.files:
            self._known.register(int(number), 0)
        # Not all systems count, and a simulator may have closed these descriptors.
        self._fast = self._counts() == (len(self.before.files), self.before.threads)
        self._umask_and_signals = self._status() if self._fast else b""

    def left_behind(self) -> list[str]:
        """Return what this process has besides, or otherwise, in words."""
        if self._fast and self._same():
            return []
        left = left_behind(self.before)
        if self._fast and not left:  # the first thread makes signals of its own
            self._umask_and_signals = self._status()
        return left

    def _counts(self) -> tuple[int, int]:
        """Return the number of descriptors and of threads; (0, 0) if they are not known."""
        try:
            tasks, _, files = map(os.fstat, self._opened)
        except (OSError, ValueError):
            return 0, 0
        return files.st_size, tasks.st_nlink - 2

    def _status(self) -> bytes:
        """Return the lines of umask and signals, which have one length; b"" if not known."""
        try:
            status = os.pread(self._opened[1], STATUS_BYTES, 0)
        except (OSError, IndexError):
            return b""
        umask, signals = status.find(b"Umask:"), status.find(b"SigBlk:")
        return status[umask : umask + 11] + status[signals : signals + 74]

    def _same(self) -> bool:
        """Return whether nothing differs; false if that is not certain."""
        before = self.before
        files, threads = self._counts()
        if files != len(before.files) or threads > before.threads:
            return False
        closed = [event for _, event in self._known.poll(0) if event & select.POLLNVAL]
        return (
            not closed
            and self._status() == self._umask_and_signals
            and [_identity(0), _identity(1), _identity(2)] == before.streams
            and list(map(signal.getitimer, TIMERS)) == NO_TIMERS
            and list(map(resource.getrlimit, LIMITS)) == before.limits
            and sys.getrecursionlimit() == before.recursion
            and _folder() == before.folder
            and os.environ._data == before.environment  # type: ignore[attr-defined]  # private
        )


def left_behind(before: ProcessState) -> list[str]:
    """Return what this process has besides, or otherwise, in words: "1 thread running".

    Args:
        before: its state before what may have left something.
    """
    now = process_state()
    if not _differ(before, now):
        return []
    gc.collect()  # an unreachable file is closed
    end = time.monotonic() + ENDING_S
    while (now := process_state()).threads > before.threads and time.monotonic() < end:
        time.sleep(ENDING_STEP_S)
    return [text for text in _texts(before, now) if text]


def _differ(before: ProcessState, now: ProcessState) -> bool:
    """Return whether something may have been left; a thread that ended is no loss."""
    return now.threads > before.threads or now._replace(threads=0) != before._replace(
        threads=0
    )


def _texts(before: ProcessState, now: ProcessState) -> list[str]:
    """Describe each difference; "" if there is none."""
    threads = now.threads - before.threads
    opened = sorted(map(_path, now.files - before.files))
    limits = [
        f"the limit {name} changed to {new[0]}"
        for name, old, new in zip(LIMITS.values(), before.limits, now.limits, strict=True)
        if old != new
    ]
    variables = sorted(
        os.fsdecode(name)
        for name in before.environment.keys() | now.environment.keys()
        if before.environment.get(name) != now.environment.get(name)
    )
    changed = [
        ("the umask", before.umask, now.umask),
        ("the recursion limit", before.recursion, now.recursion),
        ("the working folder", before.folder, now.folder),
    ]
    return [
        f"{plural(threads, 'thread')} running" if threads > 0 else "",
        f"a file open ({opened[0]})" if opened else "",
        "files closed that it did not open" if before.files - now.files else "",
        "another standard stream" if before.streams != now.streams else "",
        "a timer or an alarm set" if before.timers != now.timers else "",
        *limits,
        *(f"{what} changed to {new}" for what, old, new in changed if old != new),
        f"the environment variable {variables[0]} changed" if variables else "",
        f"the handling of {_signal(before, now)} changed"
        if before.signals != now.signals
        else "",
    ]


def _signal(before: ProcessState, now: ProcessState) -> str:
    """Name the first signal that is handled otherwise."""
    for old, new in zip(before.signals, now.signals, strict=True):
        if bits := old ^ new:
            number = (bits & -bits).bit_length()
            with contextlib.suppress(ValueError):
                return signal.Signals(number).name
            return f"signal {number}"
    return "signals"


def _kernel_status() -> tuple[int, str, tuple[int, ...]]:
    """Return the number of threads, the umask, and the signals' bits."""
    try:
        opened = os.open(STATUS, os.O_RDONLY)
    except OSError:  # not Linux
        return threading.active_count(), "", ()
    try:
        return _of_status(os.read(opened, STATUS_BYTES))
    finally:
        os.close(opened)


def _of_status(text: bytes) -> tuple[int, str, tuple[int, ...]]:
    signals = text.partition(b"SigBlk:")[2].split(None, 5)
    return (
        int(text.partition(b"Threads:")[2].split(None, 1)[0]),
        text.partition(b"Umask:")[2].split(None, 1)[0].decode(),
        tuple(int(bits, 16) & ~THREADS_SIGNALS for bits in signals[0:5:2]),
    )


def _files() -> frozenset[str]:
    """Return the open descriptors, but for the one that the list is read with."""
    lowest = os.open(os.devnull, os.O_RDONLY)
    os.close(lowest)
    return frozenset(os.listdir(DESCRIPTORS)) - {str(lowest)}


def _identity(number: int) -> tuple[int, int]:
    try:
        found = os.fstat(number)
    except OSError:
        return 0, 0
    return found.st_dev, found.st_ino


def _folder() -> str:
    try:
        return os.getcwd()
    except OSError:  # it was deleted
        return "one that is deleted"


def _path(number: str) -> str:
    """Return what a descriptor is."""
    try:
        return os.readlink(f"{DESCRIPTORS}/{number}")
    except OSError:  # not Linux
        return f"number {number}"
