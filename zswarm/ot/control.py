"""What is asked of a run through its folder: to pause, to stop, or to stop after the generation that runs.

A file beside the record holds one word, so whoever may write the folder may ask, from any program and any machine; the run looks
some times a second, and forgets what was asked of it before when it begins or goes on.
"""

import threading
import time
from pathlib import Path
from typing import Literal, get_args

from zswarm.errors import ConfigError
from zswarm.files import write_whole
from zswarm.ot.database import in_words

CONTROL = "control"
LOOK_S = 0.2
LONGEST = 16  # bytes of the file that are read

Word = Literal["pause", "drain", "stop"]
WORDS: tuple[str, ...] = get_args(Word)


def ask(folder: Path, word: Word) -> None:
    """Have the run in a folder do it.

    Raises:
        ConfigError: the folder cannot be written.
    """
    try:
        write_whole(folder / CONTROL, f"{word}\n".encode())
    except OSError as error:
        raise ConfigError(f"{folder}: cannot be written: {in_words(error, folder)}") from None


def forget(folder: Path) -> None:
    """Nothing is asked any more: a run that pauses goes on.

    Raises:
        ConfigError: the folder cannot be written.
    """
    try:
        (folder / CONTROL).unlink(missing_ok=True)
    except OSError as error:
        raise ConfigError(f"{folder}: cannot be written: {in_words(error, folder)}") from None


def asked(folder: Path) -> str:
    """A word, or "" where nothing is asked, or nothing that is known."""
    try:
        with (folder / CONTROL).open("rb") as file:
            word = file.read(LONGEST).decode(errors="replace").strip()
    except OSError:
        return ""
    return word if word in WORDS else ""


class Stop(threading.Event):
    """Set when a run is to stop at once: by its own program, or through its folder."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self._folder = folder
        self._look_at = 0.0

    def is_set(self) -> bool:
        """Looks at the folder some times a second."""
        now = time.monotonic()
        if now >= self._look_at:
            self._look_at = now + LOOK_S
            if asked(self._folder) == "stop":
                self.set()
        return super().is_set()
