"""Run the main function of a command-line program, and end it whatever its threads do."""

import atexit
import os
import sys
import threading
from collections.abc import Callable

from zswarm.system import terminal

# Threads of this name may wait for a dead link, also while the interpreter ends.
CLOSING = "closing"
UNFLUSHED = 120  # exit code, Python's own


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
