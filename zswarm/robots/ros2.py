"""An ament_python package: an rclpy node for ROS 2, with the controller compiled, or in Python where there is no compiler."""

from zswarm.controller import Controller
from zswarm.robots.package import Files, c_files, fill, python_files, robot, words

PROFILE = "turtlebot3-jazzy"


def ros2(controller: Controller, name: str, profile: str = PROFILE) -> Files:
    """The package ``zs_<name>``.

    Args:
        name: as ``names.folded`` gives it.
        profile: name, or path of a file, of a robot with ROS 2.

    Raises:
        ConfigError: as ``package.robot``.
    """
    packed = robot(controller, name, profile, ros=2)
    known = words(packed)
    known |= {"target": "ROS 2", "build": fill("ros2/build.md", known)}
    return {
        "README.md": fill("README.md", known),
        **{path: fill(f"ros2/{path}", known) for path in ("package.xml", "setup.py", "setup.cfg", "launch/drive.launch.py")},
        f"resource/{packed.name}": "",
        f"{packed.name}/node.py": fill("ros2/node.py", known),
        **python_files(packed, known),
        **c_files(packed, known, "src"),
    }
