"""What a program needs of its surroundings before it loads anything large."""

import io
import os
import resource
import sys
import syslog

LEAST_ADDRESS_MB = 600  # of address space: libraries map that much, touched or not
# Threads of a BLAS and of OpenMP: those that NumPy starts spin for a tenth of a second each.
ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"
)


def prepare(program: str) -> None:
    """Open standard streams that are closed, and end the program if it cannot have the memory.

    NumPy gets one thread, unless the environment says otherwise.

    Args:
        program: its name, for messages.
    """
    _open_streams(program)
    for name, threads in ONE_THREAD.items():
        os.environ.setdefault(name, threads)
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit != resource.RLIM_INFINITY and limit >> 20 < LEAST_ADDRESS_MB:
        sys.stderr.write(
            f"{program}: the address space is limited to {limit >> 20} MB; expected at least "
            f"{LEAST_ADDRESS_MB} MB (ulimit -v unlimited)\n"
        )
        sys.exit(1)


def _open_streams(program: str) -> None:
    """Open /dev/null for each closed stream; Python's stderr is then the system's log.

    Otherwise the next files and sockets would get their numbers, and be written to.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # gets the lowest free number
    # Python sets those to None that were closed when it started.
    for number, (name, mode) in enumerate((("stdin", "r"), ("stdout", "w"))):
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(number, mode, encoding="utf-8", closefd=False))
    if sys.stderr is None:
        setattr(sys, "stderr", SystemLog(program))  # noqa: B010  not a file, as mypy expects


class SystemLog(io.TextIOBase):
    """A stream to syslog, or the journal: one message a line."""

    def __init__(self, program: str) -> None:
        syslog.openlog(program, syslog.LOG_PID, syslog.LOG_DAEMON)
        self._begun = ""

    def writable(self) -> bool:
        """Return True."""
        return True

    def fileno(self) -> int:
        """Return the descriptor for programs that are started, whose output is dropped."""
        return 2

    def write(self, text: str) -> int:
        """Log whole lines."""
        *lines, self._begun = (self._begun + text).split("\n")
        for line in filter(str.strip, lines):
            syslog.syslog(syslog.LOG_ERR, line)
        return len(text)
