"""Check the compile cache: programs that compile at once, and folders that are no longer used."""

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.repository import REPOSITORY
from zswarm.kernels import cache

# Of any type: numba compiles it for each that it is called with.
SHARED = """
from zswarm.kernels.jit import inline

@inline
def scaled(number):
    return number * number / number + number
"""
COMPILE = """
import sys
from pathlib import Path
from numba.core.caching import IndexDataCacheFile
import numpy as np
import shared_function

folder, order = Path(sys.argv[2]), sys.argv[3:]

def in_turn(name):
    step = getattr(IndexDataCacheFile, name)
    def wait_and_do(self, *arguments):
        event = f"{sys.argv[1]}{name}"
        if event in order:
            before = order[:order.index(event)]
            while not all((folder / other).exists() for other in before):
                pass
        result = step(self, *arguments)
        (folder / event).touch()
        return result
    return wait_and_do

def save(self, key, data):
    for name in ("_load_index", "_save_index", "_save_data"):
        setattr(IndexDataCacheFile, name, in_turn(name))
    saved(self, key, data)

saved = IndexDataCacheFile.save
if order:
    IndexDataCacheFile.save = save
for kind in sys.argv[1].split(","):
    print(repr(float(shared_function.scaled(getattr(np, kind)(1.155)))))
if not order:
    print(sum(shared_function.scaled.dispatcher.stats.cache_hits.values()))
"""
# Both read the empty index; the last index is that of one, the last data are those of the other.
ORDER = (
    "float32_load_index float64_load_index float32_save_index float64_save_index "
    "float64_save_data float32_save_data"
).split()


@pytest.fixture
def module(tmp_path: Path) -> Path:
    (tmp_path / "shared_function.py").write_text(SHARED)
    return tmp_path


def start(folder: Path, kind: str, order: list[str]) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", COMPILE, kind, folder, *order],
        env=os.environ
        | {
            "PYTHONPATH": os.pathsep.join([str(folder), str(REPOSITORY)]),
            "ZSWARM_CACHE": str(folder / "cache"),
            "ZSWARM_PLAIN": "",
        },
        stdout=subprocess.PIPE,
        text=True,
    )


@pytest.mark.long
def test_programs_that_compile_for_different_types_at_once_keep_their_machine_code(
    module: Path,
) -> None:
    """Each chose the same file for its code, so one type was computed by the other's."""
    both = [start(module, kind, ORDER) for kind in ("float64", "float32")]
    (exact,), (rounded,) = (
        program.communicate(timeout=120)[0].split() for program in both
    )
    assert exact == "2.31" != rounded
    for hits in ("1", "2"):  # the first compiles again what one index lacked
        again = start(module, "float64,float32", []).communicate(timeout=120)[0]
        assert again.split() == [exact, rounded, hits]


@pytest.fixture
def place(tmp_path: Path) -> Iterator[Path]:
    """A folder of caches; this process gives up its claims afterwards."""
    before = len(cache._claims)
    yield tmp_path
    for descriptor in cache._claims[before:]:
        os.close(descriptor)
    del cache._claims[before:]


def made(place: Path, digit: str, days: float) -> Path:
    """A folder of compiled kernels that was last used so many days ago."""
    folder = place / (digit * 32)
    folder.mkdir(mode=0o700)
    (folder / cache.LOCK).touch()
    (folder / "kernel.nbi").touch()
    then = time.time() - days * 86400
    for path in (folder / cache.LOCK, folder):
        os.utime(path, (then, then))
    return folder


def test_folders_that_were_not_used_for_30_days_are_deleted(place: Path) -> None:
    old, lately, own = made(place, "a", 31), made(place, "b", 29), made(place, "c", 40)
    without_lock = made(place, "d", 31)
    (without_lock / cache.LOCK).unlink()
    os.utime(without_lock, (0, 0))
    foreign = place / "notes"
    foreign.mkdir()
    os.utime(foreign, (0, 0))
    assert cache.claimed(own) == own
    assert sorted(place.iterdir()) == sorted([lately, own, foreign])
    assert (own / "kernel.nbi").exists()
    assert not old.exists()
    assert time.time() - (own / cache.LOCK).stat().st_mtime < 86400


def test_a_folder_that_a_running_process_uses_is_never_deleted(place: Path) -> None:
    """A server may run for months, and its slots are forked from the process that claimed it."""
    used, own = made(place, "a", 0), place / ("b" * 32)
    code = (
        "import os, sys, pathlib; from zswarm.kernels import cache;"
        "cache.claimed(pathlib.Path(sys.argv[1]));"
        "print(flush=True); os.fork() and os._exit(0); sys.stdin.read()"
    )
    command = [sys.executable, "-c", code, used]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen(command, text=True, **pipes) as holder:
        assert holder.stdin is not None
        assert holder.stdout is not None
        holder.stdout.readline()
        holder.wait(60)  # its child is left
        for path in (used / cache.LOCK, used):
            os.utime(path, (0, 0))
        cache.claimed(own)
        assert (used / "kernel.nbi").exists()
        holder.stdin.close()  # the child ends, and with it its end of the pipe
        assert holder.stdout.read() == ""
    cache.claimed(own)
    assert not used.exists()


def test_a_folder_that_is_deleted_while_it_is_claimed_is_made_again(
    place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own, locked = made(place, "a", 0), cache._locked
    deleted = []

    def delayed(folder: Path, how: int) -> int | None:
        descriptor = locked(folder, how)
        if not deleted:
            shutil.rmtree(folder)
            deleted.append(folder)
        return descriptor

    monkeypatch.setattr(cache, "_locked", delayed)
    cache.claimed(own)
    assert (own / cache.LOCK).exists()
    assert deleted
