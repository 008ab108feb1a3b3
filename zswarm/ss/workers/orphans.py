"""Orphans: processes that a simulator started and that outlived their slot's process.

The kernel gives them to this program (on Linux), which ends them. Each slot's process leads a
session, so the session of an orphan tells which slot it is from.
"""

import contextlib
import ctypes
import os
import signal
import sys
from collections.abc import Collection

import psutil

PR_SET_CHILD_SUBREAPER = 36


def adopt() -> None:
    """Have the kernel make this process the parent of orphans."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1)


def end(sessions: Collection[int]) -> int:
    """Kill the orphans outside of these sessions; return how many are not gone yet."""
    own, rest = os.getsid(0), 0
    for child in psutil.Process().children():
        with contextlib.suppress(ProcessLookupError, ChildProcessError):
            session = os.getsid(child.pid)
            if session == own or session in sessions:
                continue
            os.kill(child.pid, signal.SIGKILL)
            rest += os.waitpid(child.pid, os.WNOHANG) == (0, 0)
    return rest


def parents() -> set[int]:
    """Return the processes among this program's descendants that have children."""
    found = set()
    for child in psutil.Process().children(recursive=True):
        with contextlib.suppress(psutil.NoSuchProcess):
            found.add(child.ppid())
    return found
