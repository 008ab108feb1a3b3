"""Drives one robot of ROS 2 with no ROS installed here: a laser scan and odometry in, a velocity out, over Zenoh."""

from __future__ import annotations

import argparse
import os
import queue
import signal
import sys
import time

import numpy as np

from . import driving, over_zenoh, robot, settings


def options():
    """What the command line says."""
    parser = argparse.ArgumentParser(prog=f"python3 -m {settings.NAME}.node", description=__doc__.splitlines()[0])
    parser.add_argument("--connect", action="append", default=[], metavar="ENDPOINT", help="to dial, such as tcp/robot:7447")
    parser.add_argument("--listen", action="append", default=[], metavar="ENDPOINT", help="to listen on")
    parser.add_argument("--domain", type=int, default=int(os.environ.get("ROS_DOMAIN_ID") or 0), help="ROS_DOMAIN_ID")
    parser.add_argument("--namespace", default="", help="of the robot's topics, such as robot_0")
    parser.add_argument("--scan", default=settings.SCAN_TOPIC, help="topic, default %(default)s")
    parser.add_argument("--odometry", default=settings.ODOMETRY_TOPIC, help="topic, default %(default)s")
    parser.add_argument("--velocity", default=settings.VELOCITY_TOPIC, help="topic, default %(default)s")
    parser.add_argument("--speed", type=float, default=settings.SPEED, help="m/s at most, default %(default)s")
    parser.add_argument("--turn", type=float, default=settings.TURN, help="rad/s at most, default %(default)s")
    parser.add_argument("--targets", type=float, nargs="+", default=settings.TARGETS, help="x, y of each, m")
    parser.add_argument("--lock-step", action="store_true", help="for simulations that wait for each decision")
    return parser.parse_args()


class Node:
    """The robot's place among the topics."""

    def __init__(self, session, given):
        own, how = robot.build(given.targets, given.speed, given.turn)
        self.driving = driving.Driving(own, settings.WATCHDOG_S, settings.ARRIVED, given.lock_step)
        self.lock_step = given.lock_step
        self._messages = queue.SimpleQueue()  # zenoh calls from threads of its own
        self._silent = self._arrived = False
        self._wire = over_zenoh.Node(session, "drive", domain=given.domain, distribution=settings.DISTRIBUTION)
        kind = "TwistStamped" if settings.STAMPED else "Twist"
        self._types = self._wire.store.types
        self._publisher = self._wire.publisher(topic(given.velocity, given.namespace), f"geometry_msgs/msg/{kind}")
        for name, kind in ((given.scan, "sensor_msgs/msg/LaserScan"), (given.odometry, "nav_msgs/msg/Odometry")):
            self._wire.subscribe(topic(name, given.namespace), kind, self._messages.put)
        limits = f"at most {given.speed:g} m/s and {given.turn:g} rad/s"
        say(f"{settings.NAME} drives: {limits}, parameters {settings.SHA256[:12]}, {how}")

    def run(self):
        """Take messages and let time pass, for ever."""
        step_s, watch_s = settings.STEP_S, settings.WATCHDOG_S / 4
        step_at = watch_at = time.monotonic()
        while True:
            now = time.monotonic()
            try:
                self._take(self._messages.get(timeout=max(min(step_at, watch_at) - now, 0.0)))
            except queue.Empty:
                now = time.monotonic()
            if now >= step_at:
                self.send(self.driving.on_step(now))
                step_at = max(step_at + step_s, now)
            if now >= watch_at:
                self.send(self.driving.on_watch(now))
                watch_at = now + watch_s
            self._tell()

    def send(self, velocity):
        """A velocity for the robot; nothing for None."""
        if velocity is None:
            return
        vector, twist = self._types["geometry_msgs/msg/Vector3"], self._types["geometry_msgs/msg/Twist"]
        message = twist(vector(velocity.linear, 0.0, 0.0), vector(0.0, 0.0, velocity.angular))
        if settings.STAMPED:
            now_ns = time.time_ns()
            stamp = self._types["builtin_interfaces/msg/Time"](now_ns // 1_000_000_000, now_ns % 1_000_000_000)
            header = self._types["std_msgs/msg/Header"](stamp, settings.VELOCITY_FRAME)
            message = self._types["geometry_msgs/msg/TwistStamped"](header, message)
        self._publisher.publish(message)

    def _take(self, message):
        now_s, stamp = time.monotonic(), message.header.stamp
        stamp_ns = stamp.sec * 1_000_000_000 + stamp.nanosec
        if hasattr(message, "ranges"):
            ranges = np.ascontiguousarray(message.ranges, np.float32)
            seen = driving.Scan(stamp_ns, ranges, float(message.angle_min), float(message.angle_increment))
            self.send(self.driving.on_scan(now_s, seen))
        else:
            place, turned = message.pose.pose.position, message.pose.pose.orientation
            self.send(self.driving.on_pose(now_s, driving.Pose(stamp_ns, place.x, place.y, turned.z, turned.w)))

    def _tell(self):
        silent, arrived = self.driving.silent, self.driving.arrived
        if silent and not self._silent:
            say(f"stopped: no new scan or odometry for {settings.WATCHDOG_S:g} s")
        if self._silent and not silent:
            say("scans and odometry come again: driving")
        if arrived and not self._arrived:
            say(f"stopped: nearer than {settings.ARRIVED:g} m to a target")
        self._silent, self._arrived = silent, arrived


def topic(name, namespace):
    """A topic's whole name."""
    return name if name.startswith("/") or not namespace else f"/{namespace.strip('/')}/{name}"


def say(words):
    """A line of the log."""
    print(words, file=sys.stderr, flush=True)


def _end(_signal, _frame):
    raise KeyboardInterrupt


def main():
    """Drive until Ctrl-C or SIGTERM; the robot stands then."""
    given = options()
    signal.signal(signal.SIGTERM, _end)
    signal.signal(signal.SIGINT, _end)
    node = None
    with over_zenoh.open_session(given.connect or [over_zenoh.ROUTER], given.listen) as session:
        try:
            node = Node(session, given)
            node.run()
        except (ValueError, driving.Blind) as error:
            say(str(error))
            return 1
        except KeyboardInterrupt:
            pass
        finally:
            if node is not None and not node.lock_step:
                node.send(driving.STOP)
    return 0


if __name__ == "__main__":
    sys.exit(main())
