"""Memory of slots: what a machine has for each, and what a slot's process may take (it sets its own limit).

The limit is on data (``RLIMIT_DATA``: what a process may write, touched or not), not on address space, which compilers and
drivers reserve in plenty. Where the system refuses a limit there is none.
"""

import contextlib
import os
import resource
from pathlib import Path

SHARE = 0.8  # of the machine's memory that all slots may take together
LEAST_MB = 512  # of a slot, when the server is not told; a fresh one takes about 100
CGROUPS = Path("/sys/fs/cgroup")
MEMBERSHIP = Path("/proc/self/cgroup")
OOM_SCORE = Path("/proc/self/oom_score_adj")
OOM_RAISE = 500  # of 1000: the kernel ends a slot before the server, and before what the machine's user does
PAGE = resource.getpagesize()


def per_slot_mb(capacity: int) -> int:
    """A slot's share of the memory of the machine, or of the control group this program is in."""
    return max(LEAST_MB, int(SHARE * _machine()) // capacity >> 20)


def machine_mb() -> int:
    """Memory of the machine, or of the control group."""
    return _machine() >> 20


def _machine() -> int:
    return min([os.sysconf("SC_PHYS_PAGES") * PAGE, *_group_limits()])


def _group_limits() -> list[int]:
    """Limits in bytes of this program's control groups and those above them; version 2, and memory of version 1."""
    limits = []
    with contextlib.suppress(OSError):
        for line in MEMBERSHIP.read_text().splitlines():
            number, controllers, path = line.split(":", 2)
            if number == "0":
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
    """Let this process have so much data; ``lift`` can take that back."""
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    limit = limit_mb << 20
    _set(resource.RLIMIT_DATA, limit if hard == resource.RLIM_INFINITY else min(limit, hard), hard)


def lift() -> None:
    """Let this process have more again, to tell that it ran out."""
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    _set(resource.RLIMIT_DATA, hard, hard)


def go_first() -> None:
    """Have the kernel end this process first when the machine runs out of memory, and write no core file then or ever."""
    _set(resource.RLIMIT_CORE, 0, 0)
    with contextlib.suppress(OSError, ValueError):
        OOM_SCORE.write_text(str(min(1000, int(OOM_SCORE.read_text()) + OOM_RAISE)))


def used() -> int:
    """Bytes of data of this process, as the limit counts them; 0 where the system does not tell."""
    try:
        with open("/proc/self/statm", "rb") as statm:
            return int(statm.read().split()[5]) * PAGE
    except OSError:
        return 0


def _set(kind: int, soft: int, hard: int) -> None:
    with contextlib.suppress(OSError, ValueError):  # a sandbox may refuse it
        resource.setrlimit(kind, (soft, hard))
