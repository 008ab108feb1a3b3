"""The output of a slot's process, stdout and stderr, read from a pipe."""

import os
from multiprocessing.connection import Connection

MAX_LINES = 20  # of a process that are logged
LINE_WIDTH = 200  # characters of a line that are logged, or quoted as last words
READ_BYTES = 1 << 16


class Output:
    """The first lines of a process are logged, the last one explains how it ended.

    Attributes:
        ended: nothing more can come.
    """

    def __init__(self, pipe: Connection) -> None:
        os.set_blocking(pipe.fileno(), False)
        self._pipe = pipe
        self._text = b""  # the last bytes
        self._lines = 0  # number of lines so far
        self.ended = False

    def fileno(self) -> int:
        """Return the descriptor to read."""
        return self._pipe.fileno()

    def close(self) -> None:
        """Close the pipe."""
        self._pipe.close()

    def read(self) -> list[str]:
        """Read, and return the lines to log."""
        try:
            new = os.read(self._pipe.fileno(), READ_BYTES)
        except BlockingIOError:
            return []
        self.ended = not new
        logged = self._lines > MAX_LINES
        begun = b"" if logged else self._text[self._text.rfind(b"\n") + 1 :]
        self._text = (self._text + new)[-READ_BYTES:]
        if logged:
            return []
        whole, _, _ = (begun + new).rpartition(b"\n")
        lines = [line for line in whole.split(b"\n") if line.strip()]
        shown = lines[: MAX_LINES - self._lines]
        self._lines += len(lines)
        texts = [line.decode(errors="backslashreplace") for line in shown]
        return texts + ["... further output is not logged"] * (self._lines > MAX_LINES)

    def forget(self) -> None:
        """Take nothing of the output so far for last words: the process is alive."""
        self._text = b""

    def last_words(self) -> str:
        """Return the last line, or where in the code a crash was."""
        for _ in range(16):  # an orphan may write without end
            before = self._text
            if not self.ended:
                self.read()
            if self._text == before:
                break
        text = self._text.decode(errors="backslashreplace")
        lines = [line.strip() for line in text.splitlines() if line.strip()]
        for number in reversed(range(len(lines) - 1)):
            if lines[number].startswith("Current thread"):  # by faulthandler
                return f"{lines[number - 1]}, {lines[number + 1]}"[: 2 * LINE_WIDTH]
        return lines[-1][-LINE_WIDTH:] if lines else ""
