"""List the simulators and examples that the installed packages can play."""

import importlib.util
from collections.abc import Iterable


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
