"""Behave as Stage with stageros does: wait for nobody, publish before anybody listens.

Run by the Python that has rospy, with options as JSON: ``robots``; ``interval_s``, between scans;
``tick_s``, real time between them; ``reset_s``, real time that a reset takes; ``lag_s``, that
messages wait on connections that exist, as those of a fast simulation do. A reset puts robots back
and leaves their velocities, and there is no watchdog. Robot i starts at (i, -1), heading 0.
"""

from __future__ import annotations

import json
import math
import sys
import threading
import time
from collections import deque
from typing import Any

import rospy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import LaserScan
from std_srvs.srv import Empty, EmptyResponse

VIEW = math.radians(270)
RAYS = 36


class Connections:
    """Messages that wait on them."""

    def __init__(self, lag_s: float) -> None:
        self._lag_s = lag_s
        self._waiting: deque[tuple[float, Any, Any]] = deque()

    def publish(self, publisher: Any, message: Any) -> None:
        self._waiting.append((time.monotonic() + self._lag_s, publisher, message))
        while self._waiting and self._waiting[0][0] <= time.monotonic():
            _, publisher, message = self._waiting.popleft()
            publisher.publish(message)


class Newcomers(rospy.SubscribeListener):  # type: ignore[misc]  # found only at run time
    """Nothing waits on a new connection."""

    clock = Clock()

    def peer_subscribe(self, _: Any, __: Any, publish: Any) -> None:
        publish(self.clock)


class Robot:
    """A unicycle."""

    def __init__(self, number: int, connections: Connections) -> None:
        self.number, self._connections = number, connections
        self.linear = self.angular = 0.0
        self.put_back()
        name = f"/robot_{number}"
        self._scans = rospy.Publisher(f"{name}/base_scan", LaserScan, queue_size=10)
        self._poses = [
            rospy.Publisher(f"{name}/{topic}", Odometry, queue_size=10)
            for topic in ("odom", "base_pose_ground_truth")
        ]
        rospy.Subscriber(f"{name}/cmd_vel", Twist, self._obey, queue_size=10)

    def put_back(self) -> None:
        self.x, self.y, self.heading = float(self.number), -1.0, 0.0

    def move(self, seconds: float) -> None:
        self.x += self.linear * seconds * math.cos(self.heading)
        self.y += self.linear * seconds * math.sin(self.heading)
        self.heading += self.angular * seconds

    def publish(self, stamp: Any) -> None:
        scan = LaserScan(
            angle_min=-VIEW / 2, angle_max=VIEW / 2, angle_increment=VIEW / (RAYS - 1)
        )
        scan.header.stamp = stamp
        scan.range_max, scan.ranges = 4.0, [4.0] * RAYS
        self._connections.publish(self._scans, scan)
        pose = Odometry()
        pose.header.stamp = stamp
        pose.pose.pose.position.x, pose.pose.pose.position.y = self.x, self.y
        pose.pose.pose.orientation.z = math.sin(self.heading / 2)
        pose.pose.pose.orientation.w = math.cos(self.heading / 2)
        for publisher in self._poses:
            self._connections.publish(publisher, pose)

    def _obey(self, command: Any) -> None:
        self.linear, self.angular = command.linear.x, command.angular.z


def main() -> None:
    """Run until killed."""
    given = json.loads(sys.argv[1])
    rospy.set_param("/use_sim_time", True)
    rospy.init_node("stage_like", disable_signals=True)
    connections, newcomers = Connections(given["lag_s"]), Newcomers()
    robots = [Robot(number, connections) for number in range(given["robots"])]
    clock = rospy.Publisher("/clock", Clock, queue_size=10, subscriber_listener=newcomers)
    at_work = threading.Lock()

    def reset(_: Any) -> Any:
        time.sleep(given["reset_s"])  # the simulation goes on
        with at_work:
            for robot in robots:
                robot.put_back()
        return EmptyResponse()

    rospy.Service("/reset_positions", Empty, reset)
    tick = 0
    while True:
        tick += 1
        stamp = rospy.Time.from_sec(tick * given["interval_s"])
        with at_work:
            for robot in robots:
                robot.move(given["interval_s"])
                robot.publish(stamp)
        newcomers.clock = Clock(clock=stamp)
        connections.publish(clock, newcomers.clock)
        time.sleep(given["tick_s"])


if __name__ == "__main__":
    main()
