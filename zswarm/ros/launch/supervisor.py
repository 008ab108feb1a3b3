"""A program that runs commands for a slot and ends all that they start; only the standard library.

It creates a folder and writes its path to standard output. Then it reads one JSON object a line,
runs that command, ends all that the command started, and answers with one line. When its input
ends, it ends what runs, and deletes the folder.

roslaunch starts each node in its own session. So this process is a subreaper (Linux): it becomes
the parent of descendants that lost theirs, and kills children until there are none.
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
PREFIX, FRESH = "zswarm-launches-", "zswarm-new-"  # of folders
LOCK = "lock"  # in a folder, held while this process lives
INPUT = 0  # standard input, unbuffered: it is polled
ENDING_S = 5.0  # for killed processes


def main() -> None:
    """Run commands until the input ends."""
    ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1)
    for number in (signal.SIGINT, signal.SIGTERM):
        # Slots ignore them; roslaunch ends nodes by them.
        signal.signal(number, signal.SIG_DFL)
    sweep()
    folder, lock = make_folder()
    try:
        answer({"folder": str(folder)})
        while line := read_line(INPUT):
            answer(run(json.loads(line)))
    finally:
        end_all()
        shutil.rmtree(folder, ignore_errors=True)
        os.close(lock)


def sweep() -> None:
    """Delete this user's folders whose supervisors were killed."""
    for folder in Path(tempfile.gettempdir()).glob(f"{PREFIX}*"):
        with contextlib.suppress(OSError):
            if folder.lstat().st_uid == os.getuid() and not held(folder):
                shutil.rmtree(folder, ignore_errors=True)


def held(folder: Path) -> bool:
    """Return whether a folder's supervisor lives; a folder without a lock is half deleted."""
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
    """Create a private folder, and its lock. It is renamed once locked: before, none sweeps it."""
    fresh = Path(tempfile.mkdtemp(prefix=FRESH))
    lock = os.open(fresh / LOCK, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
    fcntl.flock(lock, fcntl.LOCK_EX)
    folder = fresh.with_name(fresh.name.replace(FRESH, PREFIX, 1))
    fresh.rename(folder)
    return folder, lock


def run(request: dict[str, Any]) -> dict[str, Any]:
    """Run a command to its end; return how it ended."""
    try:
        with open(request["output"], "wb") as output:
            child = subprocess.Popen(
                request["command"],
                cwd=request["cwd"],
                env=request["environment"],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
    except OSError as error:
        return {"failed": error.strerror or str(error)}
    ending = os.pidfd_open(child.pid)
    try:
        waiting = select.poll()
        waiting.register(ending, select.POLLIN)
        waiting.register(INPUT, 0)  # whether it was closed
        events = waiting.poll(request["limit_s"] * 1000 or None)
    finally:
        os.close(ending)
    if events and ending not in dict(events):
        raise SystemExit(0)
    code = child.wait() if events else None
    end_all()
    return {"code": code}


def end_all() -> None:
    """Kill all descendants, and reap them: those whose parent is killed become children of this."""
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
    """Return the children of this process."""
    return [
        int(pid)
        for pid in Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()
    ]


def read_line(source: int) -> bytes:
    """Return a line, or b"" when the input ends."""
    line = b""
    while not line.endswith(b"\n"):
        more = os.read(source, 1 << 16)
        if not more:
            return b""
        line += more
    return line


def answer(message: dict[str, Any]) -> None:
    """Write one line."""
    with contextlib.suppress(BrokenPipeError):
        sys.stdout.write(json.dumps(message) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
