"""Memory of slots: a slot's share of the machine, and the limit that its process sets for itself.

The limit is on data (``RLIMIT_DATA``: what a process may write, touched or not), not on address
space, which compilers and drivers reserve in plenty. A system may refuse it; then memory is not
limited. ``slots/jobs.py`` describes what happens when a process reaches its limit.
"""

import contextlib
import functools
import os
import resource
from pathlib import Path

import psutil

from zswarm.errors import ConfigError

SHARE = 0.8  # of the machine's memory, for all slots together
# For the server, the fork server and the first slot, where nothing is evaluated yet.
LEAST_MACHINE_MB = 160
LEAST_MB = 512  # of a slot by default; a fresh one takes about 100
CGROUPS = Path("/sys/fs/cgroup")
MEMBERSHIP = Path("/proc/self/cgroup")
OOM_SCORE = Path("/proc/self/oom_score_adj")
# Of 1000: the kernel ends a slot before the server and before users' programs.
OOM_RAISE = 500


def per_slot_mb(capacity: int) -> int:
    """Return a slot's share of the memory of the machine, or of this program's control group."""
    return max(LEAST_MB, int(SHARE * _machine()) // capacity >> 20)


def check_machine() -> None:
    """Raise ``ConfigError`` if there is too little memory to start."""
    if (there_mb := machine_mb()) < LEAST_MACHINE_MB:
        raise ConfigError(
            f"the machine, or the control group of this program, has {there_mb} MB of memory; "
            f"expected at least {LEAST_MACHINE_MB} MB, and 100 MB more for each slot that works"
        )


def machine_mb() -> int:
    """Return the memory of the machine, or of this program's control group."""
    return _machine() >> 20


def _machine() -> int:
    return min([psutil.virtual_memory().total, *_group_limits()])


def _group_limits() -> list[int]:
    """Return the limits of this program's control groups, and of those above them, in bytes."""
    limits = []
    with contextlib.suppress(OSError):
        for line in MEMBERSHIP.read_text().splitlines():
            number, controllers, path = line.split(":", 2)
            if number == "0":  # version 2
                root, name = CGROUPS, "memory.max"
            elif "memory" in controllers.split(","):
                root, name = CGROUPS / "memory", "memory.limit_in_bytes"
            else:
                continue
            group = root / path.lstrip("/")
            for folder in (group, *group.parents[: len(group.parts) - len(root.parts)]):
                with contextlib.suppress(OSError, ValueError):  # no such file, or "max"
                    limits.append(int((folder / name).read_text()))
    return limits


def restrict(limit_mb: int) -> None:
    """Limit the data of this process; ``lift`` takes that back."""
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    limit = limit_mb << 20
    _set(
        resource.RLIMIT_DATA,
        limit if hard == resource.RLIM_INFINITY else min(limit, hard),
        hard,
    )


def lift() -> None:
    """Lift the limit, so that this process can report that it ran out of memory."""
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    _set(resource.RLIMIT_DATA, hard, hard)


def go_first() -> None:
    """Have the kernel end this process first when the machine is out of memory, without a core."""
    _set(resource.RLIMIT_CORE, 0, 0)
    with contextlib.suppress(OSError, ValueError):
        OOM_SCORE.write_text(str(min(1000, int(OOM_SCORE.read_text()) + OOM_RAISE)))


def used() -> int:
    """Return the data of this process in bytes, as the limit counts it; 0 where it is not known."""
    return int(getattr(_process(os.getpid()).memory_info(), "data", 0))


@functools.cache
def _process(pid: int) -> psutil.Process:
    return psutil.Process(pid)


def _set(kind: int, soft: int, hard: int) -> None:
    with contextlib.suppress(OSError, ValueError):  # a sandbox may refuse it
        resource.setrlimit(kind, (soft, hard))
