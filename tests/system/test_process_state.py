"""What a process has besides, or otherwise, after something ran in it."""

import gc
import os
import resource
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from zswarm.system import process_state as module
from zswarm.system.process_state import (
    DESCRIPTORS,
    StateWatch,
    left_behind,
    process_state,
)

Look = Callable[[], list[str]]  # what was left behind since then
Begin = Callable[[], Look]


def slowly() -> Look:
    before = process_state()
    return lambda: left_behind(before)


@pytest.fixture(params=[slowly, lambda: StateWatch().left_behind], ids=["whole", "often"])
def look_from_now(request: pytest.FixtureRequest) -> Begin:
    """Return what begins to look, by either way.

    A look that finds something collects garbage first: a file of an earlier test would be closed.
    """
    gc.collect()
    begin: Begin = request.param
    return begin


def test_nothing_is_left_where_nothing_was_done(
    look_from_now: Begin,
) -> None:
    look = look_from_now()
    Path(os.devnull).read_bytes()
    thread = threading.Thread(target=lambda: None)
    thread.start()
    thread.join()
    assert look() == []


def test_files_and_streams(look_from_now: Begin, tmp_path: Path) -> None:
    look = look_from_now()
    file = tmp_path / "file"
    with file.open("w"):
        assert look() == [f"a file open ({file})"]
    reading, writing = os.pipe()
    with_pipe = look_from_now()
    os.close(reading)
    os.close(writing)
    assert with_pipe() == ["files closed that it did not open"]
    stdin = os.dup(0)
    with file.open("rb") as opened:
        os.dup2(opened.fileno(), 0)
    os.dup2(stdin, 1 << 9)
    os.close(stdin)
    assert "another standard stream" in look()
    os.dup2(1 << 9, 0)
    os.close(1 << 9)
    assert look() == []


def test_an_unreachable_file_is_closed_first(
    look_from_now: Begin, recwarn: pytest.WarningsRecorder
) -> None:
    look = look_from_now()
    circle: list[object] = [Path(os.devnull).open()]  # noqa: SIM115
    circle.append(circle)
    del circle
    assert look() == []
    recwarn.clear()


FIRST_THREAD = """
import threading
from zswarm.system.process_state import StateWatch, left_behind, process_state

before, watch = process_state(), StateWatch()
thread = threading.Thread(target=lambda: None)
thread.start()
thread.join()
print(watch.left_behind(), left_behind(before._replace(files=process_state().files)))
"""


def test_the_first_thread_of_a_process_may_end() -> None:
    """The C library then handles signals that it did not handle before."""
    done = subprocess.run(
        [sys.executable, "-c", FIRST_THREAD], capture_output=True, text=True, check=True
    )
    assert done.stdout == "[] []\n"


THREADS = """
import sys, threading
from zswarm.system.process_state import StateWatch, left_behind, process_state

def whole():
    before = process_state()
    return lambda: left_behind(before)

look_from_now = {"whole": whole, "often": lambda: StateWatch().left_behind}[sys.argv[1]]
look = look_from_now()
done = threading.Event()
threads = [threading.Thread(target=done.wait) for _ in range(2)]
threads[0].start()
print(*look())
threads[1].start()
print(*look())
two = look_from_now()
done.set()
for thread in threads:
    thread.join()
print(two())
"""


@pytest.mark.parametrize("way", ["whole", "often"])
def test_threads(way: str) -> None:
    """In a process of their own: threads of other tests may end meanwhile. Threads may end."""
    done = subprocess.run(
        [sys.executable, "-c", THREADS, way], capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines() == ["1 thread running", "2 threads running", "[]"]


SOFT, HARD = resource.getrlimit(resource.RLIMIT_NOFILE)


@pytest.mark.parametrize(
    ("change", "undo", "words"),
    [
        (
            lambda: signal.alarm(3600),
            lambda: signal.alarm(0),
            "a timer or an alarm set",
        ),
        (
            lambda: signal.setitimer(signal.ITIMER_PROF, 3600.0),
            lambda: signal.setitimer(signal.ITIMER_PROF, 0.0),
            "a timer or an alarm set",
        ),
        (
            lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (500, HARD)),
            lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (SOFT, HARD)),
            "the limit NOFILE changed to 500",
        ),
        (
            lambda: sys.setrecursionlimit(1234),
            lambda: sys.setrecursionlimit(1000),
            "the recursion limit changed to 1234",
        ),
        (lambda: os.umask(0o77), lambda: os.umask(0o22), "the umask changed to 0077"),
        (
            lambda: os.environ.update(BAD="1"),
            lambda: os.environ.pop("BAD"),
            "the environment variable BAD changed",
        ),
        (
            lambda: signal.signal(signal.SIGUSR1, signal.SIG_IGN),
            lambda: signal.signal(signal.SIGUSR1, signal.SIG_DFL),
            "the handling of SIGUSR1 changed",
        ),
        (
            lambda: signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGHUP]),
            lambda: signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGHUP]),
            "the handling of SIGHUP changed",
        ),
    ],
)
def test_settings(
    look_from_now: Begin,
    change: Callable[[], object],
    undo: Callable[[], object],
    words: str,
) -> None:
    sys.setrecursionlimit(1000)
    os.umask(0o22)
    look = look_from_now()
    try:
        change()
        assert look() == [words]
    finally:
        undo()
    assert look() == []


def test_the_working_folder(
    look_from_now: Begin, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    look = look_from_now()
    with monkeypatch.context() as patch:
        patch.chdir(tmp_path)
        assert look() == [f"the working folder changed to {tmp_path}"]
        tmp_path.rmdir()
        assert look() == ["the working folder changed to one that is deleted"]


def test_a_file_instead_of_another_is_found(look_from_now: Begin, tmp_path: Path) -> None:
    """There are as many as before."""
    closed = os.open(os.devnull, os.O_RDONLY)
    look = look_from_now()
    other = os.dup2(closed, 700)
    os.close(closed)
    try:
        assert look() == [
            f"a file open ({os.devnull})",
            "files closed that it did not open",
        ]
    finally:
        os.close(other)


def test_the_whole_state_is_compared_only_if_something_differs(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Where the system counts descriptors: Linux since 6.2."""
    watch = StateWatch()
    compared = []
    monkeypatch.setattr(module, "left_behind", lambda _: compared.append(1) or [])
    assert watch.left_behind() == []
    assert bool(compared) == (os.stat(DESCRIPTORS).st_size == 0)
    compared.clear()
    with Path(os.devnull).open():
        watch.left_behind()
    assert compared


def test_a_watch_whose_descriptors_are_closed_looks_on(tmp_path: Path) -> None:
    """A simulator may close all that it did not open."""
    watch = StateWatch()
    for opened in watch._opened:
        os.close(opened)
    module._opened.cache_clear()  # for others
    assert watch.left_behind() == ["files closed that it did not open"]
    with (tmp_path / "file").open("w"):
        watch.begin()
        assert watch.left_behind() == []
        os.umask(0o77)
        assert watch.left_behind() == ["the umask changed to 0077"]
        os.umask(0o22)
