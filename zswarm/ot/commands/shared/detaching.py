"""Continue a program without its terminal: in a session of its own, with a log in a run's folder.

The program forks before it starts anything. What it prints before its folder exists goes through a
pipe to the terminal, errors among them; everything later goes to the log.
"""

import contextlib
import fcntl
import json
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path

import click

from zswarm.ot.commands.shared.exits import EXIT_FAILED
from zswarm.system import terminal
from zswarm.system.text import clean

LOG = "log"  # in the folder of a run or study; locked while a detached program writes it


def detach(*, wanted: bool, as_json: bool) -> Callable[[Path], None]:
    """Return in a child process that outlives the terminal; this process ends.

    Returns:
        What takes the folder of the run or study, once that exists. If detaching is not wanted,
        this is the same process, and the folder is not used.

    Raises:
        SystemExit: in the parent, always.
    """
    if not wanted:
        return lambda folder: None  # noqa: ARG005
    sys.stdout.flush()
    sys.stderr.flush()
    (lines, said), (answer, folder_is) = os.pipe(), os.pipe()
    child = os.fork()
    if child:
        os.close(said)
        os.close(folder_is)
        raise SystemExit(_begin(child, lines, answer, as_json=as_json))
    os.close(lines)
    os.close(answer)
    os.setsid()
    streams = _copies_of_streams()
    _redirect(streams, said)
    os.close(said)
    with open(os.devnull, "rb") as nothing:
        os.dup2(nothing.fileno(), 0)

    def settle(folder: Path) -> None:
        log = os.open(folder / LOG, os.O_CREAT | os.O_WRONLY | os.O_APPEND, 0o666)
        fcntl.flock(log, fcntl.LOCK_EX)
        sys.stdout.flush()
        sys.stderr.flush()
        os.write(folder_is, os.fsencode(folder))
        os.close(folder_is)
        _redirect(streams, log)  # ``log`` itself stays open, for the lock

    return settle


def _copies_of_streams() -> list[int]:
    """Return the descriptors of stdout and stderr, with copies such as that for JSON."""
    ours = [os.fstat(number) for number in (1, 2, terminal.stdout().fileno())]
    found = []
    for number in map(int, os.listdir("/dev/fd")):
        with contextlib.suppress(OSError):  # that of the folder itself
            if any(os.path.samestat(os.fstat(number), own) for own in ours):
                found.append(number)
    return found


def _redirect(streams: list[int], file: int) -> None:
    for number in streams:
        os.dup2(file, number, inheritable=number in (1, 2))


def is_detached(folder: Path) -> bool:
    """Return whether a detached program writes the log of a run or study now."""
    try:
        with (folder / LOG).open("rb") as log:
            fcntl.flock(log, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    return False


def _begin(child: int, lines: int, answer: int, *, as_json: bool) -> int:
    """Print what the child does until it has a folder; return the exit code."""
    try:
        with os.fdopen(lines, "rb") as said:
            for line in said:
                sys.stderr.buffer.write(line)
                sys.stderr.flush()
        with os.fdopen(answer, "rb") as answers:
            folder = clean(os.fsdecode(answers.read()))
    except KeyboardInterrupt:
        os.kill(child, signal.SIGTERM)
        raise
    if not folder:
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        return code if code >= 0 else EXIT_FAILED
    if as_json:
        found = {"event": "detached", "run": folder, "process": child}
        click.echo(json.dumps(found), file=terminal.stdout())
        return 0
    click.echo(
        f"run     {folder}, which continues without this terminal (process {child})\n"
        f"next    zswarm-ot attach {folder}\n"
        f"        zswarm-ot status {folder}\n"
        f"        zswarm-ot stop {folder}"
    )
    return 0
