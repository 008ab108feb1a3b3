"""A program beside a slot that runs commands for it and leaves nothing of them; it runs by itself, on the standard library alone.

It makes a folder and says its path on its standard output. Then it reads one JSON object a line, runs that command, ends all that
the command started and that is left, and answers with one line. When its input ends it ends what runs, and deletes the folder.

roslaunch starts each node in a session of its own; so the kernel is told to give this process whatever comes from it and has lost
its parent (Linux's subreaper), and it ends children until it has none.
"""

import contextlib
import ctypes
import fcntl
import json
import os
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

PR_SET_CHILD_SUBREAPER = 36
PREFIX, FRESH, LOCK = (
    "zswarm-launches-",
    "zswarm-new-",
    "lock",
)  # of folders; the last is held locked as long as this process lives
INPUT = 0  # the standard input, unbuffered: it is polled
ENDING_S = 5.0  # killed processes are waited for


def main() -> None:
    """Run commands until the input ends."""
    ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_DFL)  # a slot hears neither; roslaunch ends nodes by them
    sweep()
    folder, lock = make_folder()
    try:
        say({"folder": str(folder)})
        while line := read_line(INPUT):
            say(run(json.loads(line)))
    finally:
        end_all()
        shutil.rmtree(folder, ignore_errors=True)
        os.close(lock)


def sweep() -> None:
    """Delete this user's folders whose keepers were killed."""
    for folder in Path(tempfile.gettempdir()).glob(f"{PREFIX}*"):
        with contextlib.suppress(OSError):
            if folder.lstat().st_uid == os.getuid() and not held(folder):
                shutil.rmtree(folder, ignore_errors=True)


def held(folder: Path) -> bool:
    """Whether a keeper lives that has this folder; one without a lock is being deleted, or its keeper was killed in that."""
    try:
        lock = os.open(folder / LOCK, os.O_RDWR | os.O_NOFOLLOW)
    except FileNotFoundError:
        return False
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(lock)
    return False


def make_folder() -> tuple[Path, int]:
    """A private folder, and its lock. It gets its name when it is locked, so that nobody sweeps it."""
    fresh = Path(tempfile.mkdtemp(prefix=FRESH))
    lock = os.open(fresh / LOCK, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
    fcntl.flock(lock, fcntl.LOCK_EX)
    folder = fresh.with_name(fresh.name.replace(FRESH, PREFIX, 1))
    fresh.rename(folder)
    return folder, lock


def run(asked: dict[str, Any]) -> dict[str, Any]:
    """Run a command to its end; how it ended, and the number of seconds that it took.

    Args:
        asked: ``command``, ``cwd``, ``environment``, ``output`` (a file for all that it says), ``limit_s`` (0: none).
    """
    begin = time.monotonic()
    try:
        with open(asked["output"], "wb") as output:
            child = subprocess.Popen(
                asked["command"], cwd=asked["cwd"], env=asked["environment"], stdin=subprocess.DEVNULL, stdout=output,
                stderr=subprocess.STDOUT, start_new_session=True,
            )  # fmt: skip
    except OSError as error:
        return {"failed": error.strerror or str(error)}
    ending = os.pidfd_open(child.pid)
    try:
        waiting = select.poll()
        waiting.register(ending, select.POLLIN)
        waiting.register(INPUT, 0)  # whether it was closed
        happened = waiting.poll(asked["limit_s"] * 1000 or None)
    finally:
        os.close(ending)
    if happened and ending not in dict(happened):
        raise SystemExit(0)
    code = child.wait() if happened else None
    end_all()
    return {"code": code, "seconds": time.monotonic() - begin}


def end_all() -> None:
    """Kill all that comes from this process, and wait for it: whose parent is killed becomes a child of this one."""
    give_up = time.monotonic() + ENDING_S
    while time.monotonic() < give_up:
        for child in children():
            with contextlib.suppress(ProcessLookupError):
                os.kill(child, signal.SIGKILL)
        try:
            while os.waitpid(-1, os.WNOHANG)[0]:
                pass
        except ChildProcessError:
            return
        time.sleep(0.002)


def children() -> list[int]:
    """Those of this process."""
    return [int(number) for number in Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()]


def read_line(source: int) -> bytes:
    """Up to the end of a line; nothing when the input ends."""
    line = b""
    while not line.endswith(b"\n"):
        more = os.read(source, 1 << 16)
        if not more:
            return b""
        line += more
    return line


def say(answer: dict[str, Any]) -> None:
    """One line."""
    with contextlib.suppress(BrokenPipeError):
        sys.stdout.write(json.dumps(answer) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
