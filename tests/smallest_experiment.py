"""The smallest experiment, as text, for tests of what may stand in an experiment file."""

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
    """Its file, ``small.toml``; more goes on in ``[optimizer]``."""
    path = folder / "small.toml"
    path.write_text(SMALL + more)
    return path


def study(folder: Path, more: str) -> Experiment:
    """It, complete."""
    path = small(folder, more)
    return complete(load(path), path.name)
