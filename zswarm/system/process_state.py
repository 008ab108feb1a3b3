"""What a process has: files, threads, timers, limits. It shows what a trial left behind."""

import contextlib
import gc
import os
import resource
import signal
import sys
import threading
import time
from typing import NamedTuple

from zswarm.system.format import plural

DESCRIPTORS = "/proc/self/fd" if sys.platform == "linux" else "/dev/fd"
STATUS = "/proc/self/status"
TIMERS = (signal.ITIMER_REAL, signal.ITIMER_VIRTUAL, signal.ITIMER_PROF)
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
    """Return what this process has now; that takes some 30 us."""
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
        text = os.read(opened, 1 << 14).decode()
    finally:
        os.close(opened)
    signals = text.partition("SigBlk:")[2].split(None, 5)
    return (
        int(text.partition("Threads:")[2].split(None, 1)[0]),
        text.partition("Umask:")[2].split(None, 1)[0],
        tuple(int(bits, 16) for bits in signals[0:5:2]),
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
