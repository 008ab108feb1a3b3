"""One robot: ros2 launch @{name} drive.launch.py robot:=robot_0 speed:=0.1."""

from typing import List

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

ARGUMENTS = {
    "robot": ("", "the robot's namespace, such as robot_0; none for one that is alone"),
    "speed": ("@{speed}", "m/s at most; lower it for the first drive"),
    "turn": ("@{turn}", "rad/s at most, likewise"),
    "targets": (
        "[@{places}]",
        "x, y of each place to go to, m, in the frame of the odometry",
    ),
    "use_sim_time": ("false", "true with a simulation"),
}


def generate_launch_description():
    """The node, with its arguments."""
    declared = [
        DeclareLaunchArgument(name, default_value=value, description=words)
        for name, (value, words) in ARGUMENTS.items()
    ]
    types = {"speed": float, "turn": float, "targets": List[float], "use_sim_time": bool}
    parameters = {
        name: ParameterValue(LaunchConfiguration(name), value_type=kind)
        for name, kind in types.items()
    }
    node = Node(
        package="@{name}",
        executable="drive",
        namespace=LaunchConfiguration("robot"),
        parameters=[parameters],
        output="screen",
    )
    return LaunchDescription([*declared, node])
