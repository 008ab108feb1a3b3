"""Drives one robot: a laser scan and odometry in, a velocity out.

Parameters: targets (x, y of each, m, in the frame of the odometry), speed and turn (m/s and rad/s;
they lower the limits), lock_step (for simulations that wait for each decision; with use_sim_time).
"""

from __future__ import annotations

import signal
import sys
import time

import rclpy
from geometry_msgs.msg import Twist, TwistStamped
from nav_msgs.msg import Odometry
from rclpy.clock import Clock, ClockType
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import LaserScan

from . import driving, robot, settings

LOOK_S = 0.1  # between checks for signals
LEAVE_S = 0.2  # for the last message to be sent


class Node:
    """The robot's subscriptions and publisher."""

    def __init__(self, node):
        self._node, self._log = node, node.get_logger()
        speed = node.declare_parameter("speed", settings.SPEED).value
        turn = node.declare_parameter("turn", settings.TURN).value
        targets = list(node.declare_parameter("targets", list(settings.TARGETS)).value)
        self.lock_step = node.declare_parameter("lock_step", False).value
        if self.lock_step and not node.get_parameter("use_sim_time").value:
            raise ValueError(
                "lock_step: for simulations; expected use_sim_time to be true"
            )
        own, text = robot.build(targets, speed, turn)
        self._driving = driving.Driving(
            own, settings.WATCHDOG_S, settings.ARRIVED, self.lock_step
        )
        self._type = TwistStamped if settings.STAMPED else Twist
        velocity = settings.VELOCITY_TOPIC
        self._publisher = node.create_publisher(self._type, velocity, QoSProfile(depth=1))
        # Best effort matches all publishers; in lock-step no message may be lost.
        quality = QoSProfile(depth=10) if self.lock_step else qos_profile_sensor_data
        node.create_subscription(
            LaserScan, settings.SCAN_TOPIC, self._on_message, quality
        )
        node.create_subscription(
            Odometry, settings.ODOMETRY_TOPIC, self._on_message, quality
        )
        if not self.lock_step:
            steady = Clock(clock_type=ClockType.STEADY_TIME)
            node.create_timer(settings.STEP_S, self._on_step)
            node.create_timer(settings.WATCHDOG_S / 4, self._on_watch, clock=steady)
        self._log.info(text)

    def send(self, velocity):
        """Publish a velocity; do nothing for None."""
        if velocity is None:
            return
        message = self._type()
        twist = message.twist if settings.STAMPED else message
        if settings.STAMPED:
            message.header.stamp = self._node.get_clock().now().to_msg()
            message.header.frame_id = settings.VELOCITY_FRAME
        twist.linear.x, twist.angular.z = velocity.linear, velocity.angular
        self._publisher.publish(message)

    def _on_message(self, message):
        self.send(self._driving.on_message(time.monotonic(), message))

    def _on_step(self):
        self.send(self._driving.on_step(time.monotonic()))
        self._log_news()

    def _on_watch(self):
        self.send(self._driving.on_watch(time.monotonic()))
        self._log_news()

    def _log_news(self):
        text = self._driving.news()
        if text is not None:
            self._log.warning(text) if self._driving.silent else self._log.info(text)


def main():
    """Drive until Ctrl-C or SIGTERM, then stop the robot."""
    signals = []  # rclpy's own handlers would close ROS before the robot is stopped
    rclpy.init(args=sys.argv, signal_handler_options=SignalHandlerOptions.NO)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, _: signals.append(number))
    node, executor = rclpy.create_node("drive"), SingleThreadedExecutor()
    executor.add_node(node)
    here = None
    try:
        here = Node(node)
        while not signals:
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
