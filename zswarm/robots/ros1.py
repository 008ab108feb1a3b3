"""A catkin package: a C++ node for ROS 1, with the controller in C99."""

from zswarm.controller import Controller
from zswarm.robots.names import quoted
from zswarm.robots.package import Files, c_files, fill, robot, words

PROFILE = "turtlebot2"
STAMPED = "    message.header.stamp = ros::Time::now();\n    message.header.frame_id = {frame};\n"


def ros1(controller: Controller, name: str, profile: str = PROFILE) -> Files:
    """The package ``zs_<name>``.

    Args:
        name: as ``names.folded`` gives it.
        profile: name, or path of a file, of a robot with ROS 1.

    Raises:
        ConfigError: as ``package.robot``.
    """
    packed = robot(controller, name, profile, ros=1)
    known = words(packed)
    twist = "message.twist" if packed.profile.velocity.stamped else "message"
    filled = STAMPED.format(frame=quoted(known["frame"])) if packed.profile.velocity.stamped else ""
    filled += f"    {twist}.linear.x = velocity.linear;\n    {twist}.angular.z = velocity.angular;"
    known |= {"fill": filled, "target": "ROS 1", "build": fill("ros1/build.md", known)}
    return {
        "README.md": fill("README.md", known),
        **{path: fill(f"ros1/{path}", known) for path in ("package.xml", "CMakeLists.txt", "launch/drive.launch")},
        **{f"src/{path}": fill(f"ros1/{path}", known) for path in ("node.cpp", "driving.hpp")},
        **c_files(packed, known, "src"),
    }
