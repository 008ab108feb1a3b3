"""Define the smallest experiment as text, for tests of experiment files."""

import importlib.util
from collections.abc import Iterable
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


def vmas_is_here() -> bool:
    """Return whether the extra ``vmas`` is installed: it is large, and only in ``make vmas``."""
    return (
        importlib.util.find_spec("vmas") is not None
        and importlib.util.find_spec("torch") is not None
    )


def playable(names: Iterable[str]) -> list[str]:
    """Return simulators and examples whose packages are installed (ROS: tests/ros)."""
    return [
        name
        for name in names
        if name != "turtlebot-exit-ros" and (name != "vmas" or vmas_is_here())
    ]
