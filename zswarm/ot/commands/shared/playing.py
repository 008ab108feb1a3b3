"""Play runs and studies in the foreground, until they end or are stopped."""

import contextlib
import importlib.util
import os
import signal
import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

import click

from zswarm.errors import ZswarmError
from zswarm.ot.commands.shared.dashboard_process import dashboard
from zswarm.ot.commands.shared.exits import EXIT_FAILED, EXIT_INTERRUPTED, EXIT_TERMINATED
from zswarm.system.processes import CODE

if TYPE_CHECKING:
    from zswarm.ot.cluster.connection import Connection
    from zswarm.ot.evolution import Evolution
    from zswarm.ot.logger import Logger
    from zswarm.ot.study.study import Study

DRAW = """
import os, sys
from pathlib import Path
os.nice(10)
from zswarm.ot.analysis import picture
for folder in sys.argv[1:]:
    picture.save_picture(Path(folder))
"""
ENDINGS = (KeyboardInterrupt, SystemExit, ZswarmError, sqlite3.Error, OSError)


def finish(run: "Evolution", shown: "Logger", *, with_dashboard: bool) -> None:
    """Evolve a run to its end; if it is stopped, close it and print how to resume it."""
    _catch_signals()
    try:
        with dashboard(run.folder, shown.on_say, wanted=with_dashboard):
            run.finish()
    except ENDINGS as error:
        run.close()
        _say_how_to_resume(run.folder, error)
        raise


def play(
    study: "Study",
    connection: "Connection | None",
    folders: list[Path],
    *,
    as_json: bool,
    with_dashboard: bool,
) -> None:
    """Play a study to its end, and add it to ``folders``; if it is stopped, print how to resume.

    Raises:
        SystemExit: some of its runs failed.
    """
    from zswarm.ot.study.display import display

    _catch_signals()
    shown = display(study, as_json=as_json)
    try:
        with dashboard(study.folder, shown.on_say, wanted=with_dashboard):
            outcome = study.play(connection, shown)
    except ENDINGS as error:
        _say_how_to_resume(study.folder, error)
        # A second Ctrl-C, or a disk that takes nothing: do not wait for the threads of the runs.
        if study.going_on:
            if connection is not None:
                connection.close()
            for line in getattr(error, "__notes__", []):
                click.echo(f"zswarm-ot: {error}\n{line}", err=True)
            codes = {KeyboardInterrupt: EXIT_INTERRUPTED, SystemExit: EXIT_TERMINATED}
            os._exit(codes.get(type(error), EXIT_FAILED))
        raise
    folders.append(study.folder)
    if outcome.failed:
        raise SystemExit(EXIT_FAILED)


@contextlib.contextmanager
def figures() -> Iterator[list[Path]]:
    """Collect folders, and have their figures drawn when everything else is done."""
    folders: list[Path] = []
    try:
        yield folders
    finally:
        if folders and importlib.util.find_spec("matplotlib") is not None:
            _draw(folders)


def _draw(folders: list[Path]) -> None:
    """Have another program draw figures, which takes longer than to start it and to end."""
    with contextlib.suppress(
        OSError
    ):  # such as no room for a process: the run is recorded
        subprocess.Popen(
            [sys.executable, *CODE, DRAW, *map(os.path.abspath, folders)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,  # Ctrl-C and the end of the terminal are not for it
        ).returncode = 0  # it is not waited for


def _say_how_to_resume(folder: Path, error: BaseException) -> None:
    """Print it, or, if the program ends with an error message, have it printed after that."""
    line = f"stopped; nothing is lost. Resume with: zswarm-ot resume {folder}"
    if isinstance(error, (KeyboardInterrupt, SystemExit)):
        click.echo(line, err=True)
    else:
        error.add_note(line)


def _catch_signals() -> None:
    """End as cleanly as by Ctrl-C when asked to, or when the terminal is closed (without nohup)."""
    signal.signal(signal.SIGTERM, _terminate)
    if signal.getsignal(signal.SIGHUP) == signal.SIG_DFL:
        signal.signal(signal.SIGHUP, _terminate)


def _terminate(_number: int, _frame: FrameType | None) -> None:
    raise SystemExit(EXIT_TERMINATED)
