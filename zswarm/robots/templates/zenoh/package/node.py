"""Drives one robot of ROS 2 without ROS: laser scan and odometry in, velocity out, over Zenoh."""

from __future__ import annotations

import argparse
import os
import queue
import signal
import sys
import time

from . import driving, over_zenoh, robot, settings

DOMAIN = int(os.environ.get("ROS_DOMAIN_ID") or 0)
LIMITS = {"speed": (settings.SPEED, "m/s"), "turn": (settings.TURN, "rad/s")}
TOPICS = {
    "scan": settings.SCAN_TOPIC,
    "odometry": settings.ODOMETRY_TOPIC,
    "velocity": settings.VELOCITY_TOPIC,
}
LOCK_STEP = "for simulations that wait for each decision"


def options():
    """Return what the command line has."""
    about = __doc__.splitlines()[0]
    parser = argparse.ArgumentParser(
        prog=f"python3 -m {settings.NAME}.node", description=about
    )
    add = parser.add_argument
    endpoints = {"action": "append", "default": [], "metavar": "ENDPOINT"}
    add("--connect", help="to dial, such as tcp/robot:7447", **endpoints)
    add("--listen", help="to listen on", **endpoints)
    add("--domain", type=int, default=DOMAIN, help="ROS_DOMAIN_ID")
    add("--namespace", default="", help="of the robot's topics, such as robot_0")
    for name, name_in_ros in TOPICS.items():
        add(f"--{name}", default=name_in_ros, help="topic, default %(default)s")
    for name, (most, unit) in LIMITS.items():
        add(
            f"--{name}",
            type=float,
            default=most,
            help=f"{unit} at most, default %(default)s",
        )
    add(
        "--targets",
        type=float,
        nargs="+",
        default=settings.TARGETS,
        help="x, y of each, m",
    )
    add("--lock-step", action="store_true", help=LOCK_STEP)
    return parser.parse_args()


class Node:
    """The robot's subscriptions and publisher."""

    def __init__(self, session, given):
        own, text = robot.build(given.targets, given.speed, given.turn)
        self.driving = driving.Driving(
            own, settings.WATCHDOG_S, settings.ARRIVED, given.lock_step
        )
        self.lock_step = given.lock_step
        self._messages = queue.SimpleQueue()  # Zenoh calls back from its threads
        distribution, domain = settings.DISTRIBUTION, given.domain
        node = over_zenoh.ZenohNode(
            session, "drive", domain=domain, distribution=distribution
        )
        self._types = node.store.types
        kind = "geometry_msgs/msg/" + ("TwistStamped" if settings.STAMPED else "Twist")
        self._publisher = node.publisher(topic(given.velocity, given.namespace), kind)
        scan, odometry = (
            topic(name, given.namespace) for name in (given.scan, given.odometry)
        )
        node.subscribe(scan, "sensor_msgs/msg/LaserScan", self._messages.put)
        node.subscribe(odometry, "nav_msgs/msg/Odometry", self._messages.put)
        log(text)

    def run(self):
        """Take messages and keep the time, for ever."""
        step_s, watch_s = settings.STEP_S, settings.WATCHDOG_S / 4
        step_at = watch_at = time.monotonic()
        while True:
            now = time.monotonic()
            try:
                message = self._messages.get(
                    timeout=max(min(step_at, watch_at) - now, 0.0)
                )
                self.send(self.driving.on_message(time.monotonic(), message))
            except queue.Empty:
                now = time.monotonic()
            if now >= step_at:
                self.send(self.driving.on_step(now))
                step_at = max(step_at + step_s, now)
            if now >= watch_at:
                self.send(self.driving.on_watch(now))
                watch_at = now + watch_s
            news = self.driving.news()
            if news is not None:
                log(news)

    def send(self, velocity):
        """Publish a velocity; do nothing for None."""
        if velocity is None:
            return
        types = self._types
        vector = types["geometry_msgs/msg/Vector3"]
        linear, angular = (
            vector(velocity.linear, 0.0, 0.0),
            vector(0.0, 0.0, velocity.angular),
        )
        message = types["geometry_msgs/msg/Twist"](linear, angular)
        if settings.STAMPED:
            stamp = types["builtin_interfaces/msg/Time"](
                *divmod(time.time_ns(), 1_000_000_000)
            )
            header = types["std_msgs/msg/Header"](stamp, settings.VELOCITY_FRAME)
            message = types["geometry_msgs/msg/TwistStamped"](header, message)
        self._publisher.publish(message)


def topic(name, namespace):
    """Return a topic's whole name."""
    return (
        name
        if name.startswith("/") or not namespace
        else f"/{namespace.strip('/')}/{name}"
    )


def log(text):
    """Write a line to standard error."""
    print(text, file=sys.stderr, flush=True)


def _end(_signal, _frame):
    raise KeyboardInterrupt


def main():
    """Drive until Ctrl-C or SIGTERM, then stop the robot."""
    given = options()
    signal.signal(signal.SIGTERM, _end)
    signal.signal(signal.SIGINT, _end)
    node = None
    with over_zenoh.open_session(
        given.connect or [over_zenoh.ROUTER], given.listen
    ) as session:
        try:
            node = Node(session, given)
            node.run()
        except (ValueError, driving.Blind) as error:
            log(str(error))
            return 1
        except KeyboardInterrupt:
            pass
        finally:
            if node is not None and not node.lock_step:
                node.send(driving.STOP)
    return 0


if __name__ == "__main__":
    sys.exit(main())
