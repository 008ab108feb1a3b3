"""Options to start programs of zswarm, and how a child process ended, in words for an error."""

import re
import signal

from zswarm.system.text import clean

# Options of Python for programs of zswarm: without -P what lies in the current folder would be run.
MODULE, CODE = ("-P", "-m"), ("-P", "-c")
MAX_OUTPUT = 300  # characters of a process's output in an error message
SIGNALS = {number.value: number.name for number in signal.Signals}


def exit_reason(code: int | None, running: str = "closed its output") -> str:
    """Return how a process ended, such as "was killed by signal 11 (SIGSEGV)".

    Args:
        code: as in ``subprocess``: below 0 the number of a signal; None for a process that runs.
        running: what to return for a process that runs.
    """
    if code is None:
        return running
    if code >= 0:
        return f"ended with code {code}"
    name = SIGNALS.get(-code)
    if -code == signal.SIGKILL:
        name = "SIGKILL; the machine may have run out of memory"
    return f"was killed by signal {-code}" + (f" ({name})" if name else "")


def ending(
    code: int | None, output: str | bytes, running: str = "closed its output"
) -> str:
    """Return how a process ended, as ``exit_reason``, and what it wrote last."""
    return exit_reason(code, running) + wrote(output)


def last_lines(output: str | bytes, count: int = 3) -> str:
    """Return the last lines of a program's output that have letters or digits, as one line."""
    text = output if isinstance(output, str) else output.decode(errors="replace")
    lines = [line.strip() for line in text.splitlines() if re.search(r"\w", line)]
    return clean(" / ".join(lines[-count:]))[-MAX_OUTPUT:]


def wrote(output: str | bytes) -> str:
    """Return the end of an error message: what the program wrote last, "" if nothing."""
    text = last_lines(output)
    return f"; it wrote: {text}" if text else ""
