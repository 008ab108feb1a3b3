"""The folder of a run: its files, its name and its lock."""

import contextlib
import fcntl
import os
import re
import time
from pathlib import Path

from zswarm import experiment
from zswarm.errors import ConfigError
from zswarm.experiment import Experiment
from zswarm.system.text import clean

DATABASE, EXPERIMENT = "run.sqlite", "experiment.toml"
RUNS = Path("runs")  # the default of --out
DEPTH = 2  # of folders below one: runs/STUDY/RUN
LOCK_TRIES, LOCK_PAUSE_S = 20, 0.005  # `is_running` holds the lock for an instant


def load_experiment(folder: Path) -> Experiment:
    """Return the complete experiment of a run; raise ConfigError if the folder holds no run."""
    check_run(folder)
    return experiment.complete(
        experiment.load(folder / EXPERIMENT), str(folder / EXPERIMENT)
    )


def check_run(folder: Path) -> None:
    """Raise ConfigError unless the folder has the files of a run."""
    if not all(os.path.isfile(folder / name) for name in (EXPERIMENT, DATABASE)):
        raise ConfigError(f"{no_run(folder)} with {EXPERIMENT} and {DATABASE}")


def no_run(folder: Path) -> str:
    """Return the beginning of an error message.

    It suggests the folder of that name in ``runs``, or a run in the folder.
    """
    below, hint = RUNS / folder, ""
    if folder != below and not folder.exists() and os.path.isfile(below / EXPERIMENT):
        hint = f" (did you mean {clean(str(below))}?)"
    elif os.path.isdir(folder) and (inside := sorted(folder.glob(f"*/{DATABASE}"))):
        hint = f", but a folder of runs, such as {clean(str(inside[0].parent))}"
    return f"{clean(str(folder))}: no run{hint}; expected a folder"


def folders_below(path: Path) -> list[Path]:
    """Return the folders with a record, maybe damaged: the path, or those two levels below it."""

    def natural_order(folder: Path) -> list[list[tuple[bool, int, str]]]:
        return [_natural(part) for part in folder.relative_to(path).parts]

    try:
        if (path / DATABASE).is_file():
            return [path]
        patterns = ["*/" * depth + DATABASE for depth in range(1, DEPTH + 1)]
        files = [
            file for pattern in patterns for file in path.glob(pattern) if file.is_file()
        ]
    except OSError:  # not readable, or the name is too long
        return []
    return sorted({file.parent for file in files}, key=natural_order)


def new_folder(parent: Path, name: str) -> Path:
    """Make a folder ``parent/name``; if that exists ``name-2``, and so on.

    Raises:
        ConfigError: it cannot be made.
    """
    for number in range(1, 100_000):
        folder = parent / (name if number == 1 else f"{name}-{number}")
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            continue
        except OSError as error:
            raise unusable(folder, f"cannot be made: {error.strerror}") from None
        return folder
    raise ConfigError(f"{parent}: too many runs are called {name}")


def unusable(folder: Path, why: str) -> ConfigError:
    """Return the error for a new folder of a run or study that cannot be used."""
    return ConfigError(f"{folder}: {why}; choose another place with --out")


def lock_folder(folder: Path, what: str = "run") -> int:
    """Return a file descriptor that locks the folder until it is closed.

    Raises:
        ConfigError: another program has the lock, or the folder cannot be written.
    """
    try:
        # Of a folder that somebody else made: a link would create a file elsewhere.
        lock = os.open(folder / "lock", os.O_CREAT | os.O_RDWR | os.O_NOFOLLOW, 0o644)
    except OSError as error:
        raise ConfigError(f"{folder}: cannot be written: {error.strerror}") from None
    for attempt in range(LOCK_TRIES):
        if attempt:
            time.sleep(LOCK_PAUSE_S)
        with contextlib.suppress(OSError):
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return lock
    os.close(lock)
    raise ConfigError(
        f"{folder}: this {what} is in use by another zswarm-ot process; stop that one first"
    )


def is_running(folder: Path) -> bool:
    """Return whether a program has locked the folder."""
    try:
        lock = os.open(folder / "lock", os.O_RDONLY | os.O_NONBLOCK | os.O_NOFOLLOW)
    except OSError:
        return False
    try:
        fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:  # a file system without locks
        return False
    finally:
        os.close(lock)
    return False


def _natural(name: str) -> list[tuple[bool, int, str]]:
    """Return a key that sorts ``seed-2`` before ``seed-10``."""
    return [
        (part.isdecimal(), int(part) if part.isdecimal() else 0, part)
        for part in re.split(r"(\d+)", name)
        if part
    ]
