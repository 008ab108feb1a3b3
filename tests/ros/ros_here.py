"""Detect which parts of ROS are on this machine; tests that need missing ones are skipped."""

import importlib.util
import os
import shutil

import pytest

from tests.repository import REPOSITORY

ROS_2 = REPOSITORY / "build" / "ros2"
LINKS = ("rospy", "rclpy", "zenoh")


def need(link: str) -> None:
    """Skip the test if a link cannot work."""
    if link == "rospy" and shutil.which("rosmaster") is None:
        pytest.skip(
            "no ROS 1 here: apt-get install ros-core and the Python packages of its messages"
        )
    if link == "zenoh" and importlib.util.find_spec("rosbags") is None:
        pytest.skip("rosbags is not installed: extra ros")
    if link == "rclpy":
        if not (ROS_2 / "ready").exists():
            pytest.skip("no rclpy here: build/ros2, which .ci/run makes")
        os.environ["ZSWARM_ROS2_PYTHON"] = str(ROS_2 / "bin" / "python")
