"""A folder with a program that drives a robot of ROS 2 over Zenoh, on a machine without ROS and without zswarm."""

from pathlib import Path

from zswarm.controller import Controller
from zswarm.robots.package import Files, c_files, fill, python_files, robot, words
from zswarm.ros import profiles

PROFILE = "turtlebot3-jazzy"
WIRE = Path(profiles.__file__).parent / "over_zenoh.py"  # a file that needs nothing of zswarm: it goes along as it is


def zenoh(controller: Controller, name: str, profile: str = PROFILE) -> Files:
    """The folder of ``zs_<name>``.

    Args:
        name: as ``names.folded`` gives it.
        profile: name, or path of a file, of a robot with ROS 2.

    Raises:
        ConfigError: as ``package.robot``.
    """
    packed = robot(controller, name, profile, ros=2)
    known = words(packed)
    known |= {"target": "ROS 2 over Zenoh", "build": fill("zenoh/build.md", known)}
    return {
        "README.md": fill("README.md", known),
        "requirements.txt": fill("zenoh/requirements.txt", known),
        f"{packed.name}/node.py": fill("zenoh/node.py", known),
        f"{packed.name}/over_zenoh.py": WIRE.read_text(encoding="utf-8"),
        **python_files(packed, known),
        **c_files(packed, known, "src"),
    }
