"""Drives one robot: a laser scan and odometry in, a velocity out.

Parameters: targets (x, y of each, m, in the frame of the odometry), speed and turn (m/s and rad/s; they lower the limits, nothing
raises them), lock_step (for simulations that wait for each decision; only with use_sim_time).
"""

from __future__ import annotations

import signal
import sys
import time

import numpy as np
import rclpy
from geometry_msgs.msg import Twist, TwistStamped
from nav_msgs.msg import Odometry
from rclpy.clock import Clock, ClockType
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import LaserScan

from . import driving, robot, settings

LOOK_S = 0.1  # between two looks whether it is to end
LEAVE_S = 0.2  # for the last message to go out


class Node:
    """The robot's place in ROS."""

    def __init__(self, node):
        self._node, self._log = node, node.get_logger()
        speed = node.declare_parameter("speed", settings.SPEED).value
        turn = node.declare_parameter("turn", settings.TURN).value
        targets = list(node.declare_parameter("targets", list(settings.TARGETS)).value)
        self.lock_step = node.declare_parameter("lock_step", False).value
        if self.lock_step and not node.get_parameter("use_sim_time").value:
            raise ValueError("lock_step: for simulations; expected use_sim_time to be true")
        own, how = robot.build(targets, speed, turn)
        self._driving = driving.Driving(own, settings.WATCHDOG_S, settings.ARRIVED, self.lock_step)
        self._silent = self._arrived = False
        self._type = TwistStamped if settings.STAMPED else Twist
        self._publisher = node.create_publisher(self._type, settings.VELOCITY_TOPIC, QoSProfile(depth=1))
        # Best effort hears both those that send so and those that are reliable; in lock-step nothing may be lost.
        quality = QoSProfile(depth=10) if self.lock_step else qos_profile_sensor_data
        node.create_subscription(LaserScan, settings.SCAN_TOPIC, self._on_scan, quality)
        node.create_subscription(Odometry, settings.ODOMETRY_TOPIC, self._on_pose, quality)
        if not self.lock_step:
            node.create_timer(settings.STEP_S, self._on_step)
            node.create_timer(settings.WATCHDOG_S / 4, self._on_watch, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._log.info(
            f"{settings.NAME} drives: at most {speed:g} m/s and {turn:g} rad/s, parameters {settings.SHA256[:12]}, {how}"
        )

    def send(self, velocity):
        """A velocity for the robot; nothing for None."""
        if velocity is None:
            return
        message = self._type()
        twist = message.twist if settings.STAMPED else message
        if settings.STAMPED:
            message.header.stamp = self._node.get_clock().now().to_msg()
            message.header.frame_id = settings.VELOCITY_FRAME
        twist.linear.x, twist.angular.z = velocity.linear, velocity.angular
        self._publisher.publish(message)

    def _on_scan(self, message):
        ranges = np.frombuffer(message.ranges, np.float32)
        scan = driving.Scan(_stamp_ns(message), ranges, message.angle_min, message.angle_increment)
        self.send(self._driving.on_scan(time.monotonic(), scan))

    def _on_pose(self, message):
        place, turned = message.pose.pose.position, message.pose.pose.orientation
        pose = driving.Pose(_stamp_ns(message), place.x, place.y, turned.z, turned.w)
        self.send(self._driving.on_pose(time.monotonic(), pose))

    def _on_step(self):
        self.send(self._driving.on_step(time.monotonic()))
        self._tell()

    def _on_watch(self):
        self.send(self._driving.on_watch(time.monotonic()))
        self._tell()

    def _tell(self):
        silent, arrived = self._driving.silent, self._driving.arrived
        if silent and not self._silent:
            self._log.warning(f"stopped: no new scan or odometry for {settings.WATCHDOG_S:g} s")
        if self._silent and not silent:
            self._log.info("scans and odometry come again: driving")
        if arrived and not self._arrived:
            self._log.info(f"stopped: nearer than {settings.ARRIVED:g} m to a target")
        self._silent, self._arrived = silent, arrived


def _stamp_ns(message):
    return message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec


def main():
    """Drive until Ctrl-C or SIGTERM; the robot stands then."""
    ended = []  # by which signals; rclpy's own handlers would close ROS before the robot is told to stop
    rclpy.init(args=sys.argv, signal_handler_options=SignalHandlerOptions.NO)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, _: ended.append(number))
    node, executor = rclpy.create_node("drive"), SingleThreadedExecutor()
    executor.add_node(node)
    here = None
    try:
        here = Node(node)
        while not ended:
            executor.spin_once(timeout_sec=LOOK_S)
    except (ValueError, driving.Blind) as error:
        node.get_logger().fatal(str(error))
        return 1
    finally:
        if here is not None and not here.lock_step:
            here.send(driving.STOP)
            time.sleep(LEAVE_S)
        node.destroy_node()
        rclpy.shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
