"""Open the runs below a folder."""

from collections.abc import Sequence
from pathlib import Path

from zswarm.errors import ConfigError
from zswarm.ot.record.folder import DATABASE, EXPERIMENT, folders_below, no_run
from zswarm.ot.record.reader import Run
from zswarm.system.text import clean


def runs_below(paths: Sequence[Path], left_out: list[str] | None = None) -> list[Run]:
    """Return the runs of folders; each is that of a run, or of several runs such as a study's.

    Args:
        left_out: receives a line for each unreadable run; without it, such a run is an error.

    Returns:
        Runs in the order of the paths, and below each by name, with numbers in natural order; each
        run once.

    Raises:
        ConfigError: a path has no runs, or one of them cannot be read.
    """
    runs: dict[Path, Run] = {}
    for path in paths:
        folders = folders_below(path)
        if not folders:
            files = f"with {EXPERIMENT} and {DATABASE}, or one that holds such folders"
            raise ConfigError(f"{no_run(path)} {files}")
        for folder in folders:
            try:
                runs.setdefault(folder.resolve(), Run(folder))
            except ConfigError as error:
                if left_out is None or folder == path:
                    raise
                left_out.append(f"left out: {error}")
        if left_out and not runs:
            first = left_out[0].removeprefix("left out: ")
            raise ConfigError(f"{clean(str(path))}: no run that can be read; {first}")
    return list(runs.values())
