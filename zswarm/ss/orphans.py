"""Processes that simulators start and leave behind: they come to this program, which ends them.

Each slot's process leads a session of its own, so what comes from one is known by its session. Where the system has no
such adoption (it is Linux's), what a simulator leaves behind goes on.
"""

import contextlib
import ctypes
import os
import signal
import sys
from collections.abc import Collection
from pathlib import Path

PR_SET_CHILD_SUBREAPER = 36


def adopt() -> None:
    """Have the kernel give this process what is left behind by those that it starts, directly or not."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1)


def end(living: Collection[int]) -> int:
    """Kill what was left behind, but for what living processes of slots may still use; how many are not gone yet."""
    own, rest = os.getsid(0), 0
    for child in children(os.getpid()):
        with contextlib.suppress(ProcessLookupError, ChildProcessError):
            session = os.getsid(child)
            if session == own or session in living:
                continue
            os.kill(child, signal.SIGKILL)
            rest += os.waitpid(child, os.WNOHANG) == (0, 0)
    return rest


def children(process: int) -> list[int]:
    """Those of all threads of a process; none where the system does not tell."""
    found: list[int] = []
    for task in Path(f"/proc/{process}/task").glob("*/children"):
        with contextlib.suppress(OSError):  # the thread or the process ended
            found += map(int, task.read_text().split())
    return found
