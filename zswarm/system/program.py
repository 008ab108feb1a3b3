"""Run the main function of a command-line program, and end it whatever its threads do."""

import atexit
import os
import re
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from zswarm.system import terminal

if TYPE_CHECKING:  # libraries import this module, too
    import click

# Threads of this name may wait for a dead link, also while the interpreter ends.
CLOSING = "closing"
UNFLUSHED = 120  # exit code, Python's own
ABORTED = 1  # a question was not answered


def run_command(command: "click.Command") -> None:
    """Run a command as the program; what click refuses is reported in one line."""
    import click

    def called() -> None:
        try:
            command.main(standalone_mode=False)
        except click.exceptions.Abort:
            sys.exit(ABORTED)
        except click.ClickException as error:
            refuse(error)

    run(called)


def refuse(error: "click.ClickException") -> None:
    """Exit with a line that says why a command line is refused; with the help of an empty one."""
    import click

    if isinstance(error, click.exceptions.NoArgsIsHelpError):
        error.show()
        sys.exit(error.exit_code)
    context = getattr(error, "ctx", None)
    path = context.command_path if context is not None else Path(sys.argv[0]).name
    text = " ".join(error.format_message().split()).rstrip(".")
    text = re.sub(r"is not a valid (\w+) range$", r"is not a valid \1", text)
    text = f"{path.split(' ')[0]}: {text[:1].lower()}{text[1:]}"
    sys.stderr.write(f"{text} (see {path} --help)\n")
    sys.exit(error.exit_code)


def run(main: Callable[[], None]) -> None:
    """Run a program, and end the process without taking the interpreter down.

    Threads of zenoh that call Python meanwhile would abort the process (signal 6). If a session
    still waits for a dead link, functions of ``atexit`` are not called either. Only command-line
    programs end so: a library call never ends the program of its user.
    """
    terminal.prepare()
    code: object = None
    try:
        main()
    except SystemExit as ended:
        code = ended.code
    if code is not None and not isinstance(code, int):
        sys.stderr.write(f"{code}\n")
        code = 1
    if not any(thread.name == CLOSING for thread in threading.enumerate()):
        atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except (OSError, ValueError):  # no reader, a full disk, or closed
            code = code or UNFLUSHED
    os._exit(code or 0)
