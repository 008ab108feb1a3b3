"""Define the smallest experiment as text, for tests of experiment files."""

from pathlib import Path

from zswarm.experiment import Experiment, complete, load

SMALL = """
name = "small"
seed = 7
generations = 3
[problem]
simulator = "emergency-exit"
[representation]
kind = "fully-meshed"
[optimizer]
kind = "nnga"
"""


def small(folder: Path, more: str = "") -> Path:
    """Write ``small.toml``, with additional lines after ``[optimizer]``."""
    path = folder / "small.toml"
    path.write_text(SMALL + more)
    return path


def study(folder: Path, more: str) -> Experiment:
    """Return the small experiment with additional lines, complete."""
    path = small(folder, more)
    return complete(load(path), path.name)
