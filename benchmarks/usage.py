"""What a process uses, as the kernel tells it in /proc."""

import contextlib
import os
from pathlib import Path
from typing import NamedTuple

SHM = "/dev/shm/"  # noqa: S108  looked at only
PAGE = os.sysconf("SC_PAGE_SIZE")


class Usage(NamedTuple):
    """At one moment."""

    rss_mb: float
    descriptors: int
    threads: int
    shm: int  # files of /dev/shm that it has open or mapped


def usage(pid: int) -> Usage | None:
    """Of a process; None when it has ended."""
    proc = Path("/proc") / str(pid)
    try:
        pages = int((proc / "statm").read_text().split()[1])
        if not pages:
            return None  # a zombie
        descriptors = _targets(proc / "fd")
        mapped = {line.split(maxsplit=5)[5] for line in (proc / "maps").read_text().splitlines() if SHM in line}
        shm = mapped | {target for target in descriptors if target.startswith(SHM)}
        return Usage(pages * PAGE / 1e6, len(descriptors), len(list((proc / "task").iterdir())), len(shm))
    except (FileNotFoundError, ProcessLookupError):
        return None


def children(pid: int) -> list[int]:
    """Processes that it started and that run."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            parent = int(stat.read_text().rpartition(")")[2].split()[1])
        except (FileNotFoundError, ProcessLookupError):
            continue
        if parent == pid:
            found.append(int(stat.parent.name))
    return sorted(found)


def _targets(folder: Path) -> list[str]:
    """What the links in a folder point to; one that has just gone is left out."""
    found = []
    for link in list(folder.iterdir()):
        with contextlib.suppress(FileNotFoundError):
            found.append(os.readlink(link))
    return found
