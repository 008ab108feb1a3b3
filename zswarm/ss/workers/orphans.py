"""Orphans: processes that a simulator started and that outlived their slot's process.

The kernel gives them to this program (on Linux), which ends them. Each slot's process leads a
session, so the session of an orphan tells which slot it is from.
"""

import contextlib
import ctypes
import os
import signal
import sys
import time
from collections.abc import Collection

import psutil

PR_SET_CHILD_SUBREAPER = 36
ENDING_S = 5.0  # for killed processes
POLL_S = 0.002


def adopt() -> None:
    """Have the kernel make this process the parent of orphans."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1)


def end(sessions: Collection[int]) -> int:
    """Kill the orphans outside of these sessions; return how many there were.

    While there were some, call it again: the children of those that were killed are orphans then.
    """
    own, found = os.getsid(0), 0
    for child in psutil.Process().children():
        with contextlib.suppress(ProcessLookupError, ChildProcessError):
            session = os.getsid(child.pid)
            if session == own or session in sessions:
                continue
            os.kill(child.pid, signal.SIGKILL)
            found += 1
            os.waitpid(child.pid, os.WNOHANG)
    return found


def end_all() -> None:
    """Kill all orphans, and wait until none is left: this program ends."""
    give_up = time.monotonic() + ENDING_S
    while end(()) and time.monotonic() < give_up:
        time.sleep(POLL_S)


def parents() -> set[int]:
    """Return the processes among this program's descendants that have children."""
    found = set()
    for child in psutil.Process().children(recursive=True):
        with contextlib.suppress(psutil.NoSuchProcess):
            found.add(child.ppid())
    return found
