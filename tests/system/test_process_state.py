"""What a process has besides, or otherwise, after something ran in it."""

import os
import resource
import signal
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from zswarm.system.process_state import left_behind, process_state


def test_nothing_is_left_where_nothing_was_done() -> None:
    before = process_state()
    Path(os.devnull).read_bytes()
    thread = threading.Thread(target=lambda: None)
    thread.start()
    thread.join()
    assert left_behind(before) == []


def test_files_and_streams(tmp_path: Path) -> None:
    before = process_state()
    file = tmp_path / "file"
    with file.open("w"):
        assert left_behind(before) == [f"a file open ({file})"]
    reading, writing = os.pipe()
    with_pipe = process_state()
    os.close(reading)
    os.close(writing)
    assert left_behind(with_pipe) == ["files closed that it did not open"]
    stdin = os.dup(0)
    with file.open("rb") as opened:
        os.dup2(opened.fileno(), 0)
    os.dup2(stdin, 1 << 9)
    os.close(stdin)
    assert "another standard stream" in left_behind(before)
    os.dup2(1 << 9, 0)
    os.close(1 << 9)
    assert left_behind(before) == []


def test_an_unreachable_file_is_closed_first(recwarn: pytest.WarningsRecorder) -> None:
    before = process_state()
    circle: list[object] = [Path(os.devnull).open()]  # noqa: SIM115
    circle.append(circle)
    del circle
    assert left_behind(before) == []
    recwarn.clear()


def test_threads() -> None:
    before = process_state()
    done = threading.Event()
    threads = [threading.Thread(target=done.wait) for _ in range(2)]
    threads[0].start()
    assert left_behind(before) == ["1 thread running"]
    threads[1].start()
    assert left_behind(before) == ["2 threads running"]
    two = process_state()
    done.set()
    for thread in threads:
        thread.join()
    assert left_behind(two) == [], "threads may end"


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
    change: Callable[[], object], undo: Callable[[], object], words: str
) -> None:
    sys.setrecursionlimit(1000)
    os.umask(0o22)
    before = process_state()
    try:
        change()
        assert left_behind(before) == [words]
    finally:
        undo()
    assert left_behind(before) == []


def test_the_working_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = process_state()
    with monkeypatch.context() as patch:
        patch.chdir(tmp_path)
        assert left_behind(before) == [f"the working folder changed to {tmp_path}"]
        tmp_path.rmdir()
        assert left_behind(before) == [
            "the working folder changed to one that is deleted"
        ]
