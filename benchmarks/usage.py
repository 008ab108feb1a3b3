"""Read from /proc what a process uses."""

import contextlib
import os
from pathlib import Path
from typing import NamedTuple

SHM = "/dev/shm/"  # noqa: S108  looked at only
PAGE = os.sysconf("SC_PAGE_SIZE")


class Usage(NamedTuple):
    """Use of a process at one moment."""

    rss_mb: float
    descriptors: int
    threads: int
    shm: int  # files of /dev/shm that it has open or mapped


def usage(pid: int) -> Usage | None:
    """Return a process's usage; None when it has ended."""
    proc = Path("/proc") / str(pid)
    try:
        pages = int((proc / "statm").read_text().split()[1])
        if not pages:
            return None  # a zombie
        descriptors = _targets(proc / "fd")
        mapped = {
            line.split(maxsplit=5)[5]
            for line in (proc / "maps").read_text().splitlines()
            if SHM in line
        }
        shm = mapped | {target for target in descriptors if target.startswith(SHM)}
        return Usage(
            pages * PAGE / 1e6,
            len(descriptors),
            len(list((proc / "task").iterdir())),
            len(shm),
        )
    except (FileNotFoundError, ProcessLookupError):
        return None


def children(pid: int) -> list[int]:
    """Return a process's running children."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            parent = int(stat.read_text().rpartition(")")[2].split()[1])
        except (FileNotFoundError, ProcessLookupError):
            continue
        if parent == pid:
            found.append(int(stat.parent.name))
    return sorted(found)


def tree(pid: int) -> list[int]:
    """Return a process and all its descendants."""
    return [pid, *(below for child in children(pid) for below in tree(child))]


def memory_mb(pid: int) -> tuple[float, float]:
    """Return a process's private memory, and its proportional share (PSS)."""
    lines = (Path("/proc") / str(pid) / "smaps_rollup").read_text().splitlines()[1:]
    kb = {name.rstrip(":"): int(value) for name, value, *_ in map(str.split, lines)}
    return (kb["Private_Clean"] + kb["Private_Dirty"]) / 1e3, kb["Pss"] / 1e3


def tree_mb(pid: int) -> float:
    """Return the memory of a process and its descendants, shared pages counted once."""
    total = 0.0
    for each in tree(pid):
        with contextlib.suppress(
            FileNotFoundError, ProcessLookupError, PermissionError, ValueError
        ):
            total += memory_mb(each)[1]
    return total


def _targets(folder: Path) -> list[str]:
    """Return the targets of links in a folder."""
    found = []
    for link in list(folder.iterdir()):
        with contextlib.suppress(FileNotFoundError):
            found.append(os.readlink(link))
    return found
