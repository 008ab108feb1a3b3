"""Run the main function of a command-line program, and end it although a thread hangs."""

import os
import sys
import threading
from collections.abc import Callable

from zswarm.system import terminal

# Threads of this name may wait for a dead link, also while the interpreter ends.
CLOSING = "closing"


def run(main: Callable[[], None]) -> None:
    """Run a program; end the process at once if a session still waits for a dead link.

    Only command-line programs do so: a library call never ends the program of its user.
    """
    terminal.prepare()
    code: object = None
    try:
        main()
    except SystemExit as ended:
        code = ended.code
        if not _closing():
            raise
    if _closing():
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        os._exit(code if isinstance(code, int) else int(code is not None))


def _closing() -> bool:
    return any(thread.name == CLOSING for thread in threading.enumerate())
