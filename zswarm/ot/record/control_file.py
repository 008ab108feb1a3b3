"""Requests to a run: pause, drain (stop after this generation) or stop.

A request is one word in a file of the run's folder, so any program and any machine that may write
the folder can control the run. The run reads the file several times a second and deletes it when
it starts or resumes.
"""

import threading
import time
from pathlib import Path
from typing import Literal, get_args

from zswarm.errors import ConfigError
from zswarm.ot.record.database import describe
from zswarm.system.files import write_whole

CONTROL = "control"
CHECK_S = 0.2
LONGEST = 16  # bytes of the file that are read

Word = Literal["pause", "drain", "stop"]
WORDS: tuple[str, ...] = get_args(Word)


def ask(folder: Path, word: Word) -> None:
    """Send a request to a run; raise ConfigError if the folder cannot be written."""
    try:
        write_whole(folder / CONTROL, f"{word}\n".encode())
    except OSError as error:
        raise ConfigError(
            f"{folder}: cannot be written: {describe(error, folder)}"
        ) from None


def forget(folder: Path) -> None:
    """Withdraw the request: a paused run resumes.

    Raises:
        ConfigError: the folder cannot be written.
    """
    try:
        (folder / CONTROL).unlink(missing_ok=True)
    except OSError as error:
        raise ConfigError(
            f"{folder}: cannot be written: {describe(error, folder)}"
        ) from None


def asked(folder: Path) -> str:
    """Return the requested word, or "" without a valid request."""
    try:
        with (folder / CONTROL).open("rb") as file:
            word = file.read(LONGEST).decode(errors="replace").strip()
    except OSError:
        return ""
    return word if word in WORDS else ""


class StopRequest(threading.Event):
    """Set when a run has to stop at once: by its own program, or through its folder."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self._folder = folder
        self._check_at = 0.0

    def is_set(self) -> bool:
        """Check the folder too, several times a second."""
        now = time.monotonic()
        if now >= self._check_at:
            self._check_at = now + CHECK_S
            if asked(self._folder) == "stop":
                self.set()
        return super().is_set()
