"""Time a lock-step through each ROS link: scans and poses out, velocities back.

Both sides are programs of their own, each with its bridge. Prints the table of docs/profiles.md; a
link whose ROS is not there is left out.
"""

import argparse
import statistics
import subprocess
import sys
import time
from contextlib import ExitStack

import machine
import msgspec
import numpy as np

from zswarm.errors import ConfigError
from zswarm.robots.profiles import profile as profiles
from zswarm.ros.link import graph
from zswarm.ros.link.link import Link
from zswarm.ros.link.messages import Clock, Message, Odometry, Scan, Velocity

LINKS: tuple[graph.LinkKind, ...] = ("rospy", "zenoh", "rclpy")
ROBOTS = (1, 8)
RAYS = 36
TIMEOUT_S = 60.0
STEP_NS = 100_000_000
CHANNELS = ("clock", "scan", "odometry", "velocity")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--steps", type=int, default=500, help="[default: 500]")
    parser.add_argument(
        "--simulation", nargs=2, metavar=("GRAPH", "ROBOTS"), help=argparse.SUPPRESS
    )
    options = parser.parse_args()
    if options.simulation:
        simulate(
            msgspec.json.decode(options.simulation[0], type=graph.RosGraph),
            int(options.simulation[1]),
            options.steps,
        )
        return
    machine.warn_if_busy()
    print(
        "| link | "
        + " | ".join(f"{robots} robots" if robots > 1 else "1 robot" for robots in ROBOTS)
        + " |"
    )
    print("| --- " * (1 + len(ROBOTS)) + "|")
    for link in LINKS:
        try:
            print(
                f"| `{link}` | "
                + " | ".join(
                    f"{1000 * step_s(link, robots, options.steps):.2f} ms"
                    for robots in ROBOTS
                )
                + " |"
            )
        except ConfigError as error:
            print(f"{link}: {error}", file=sys.stderr)


def profile(link: graph.LinkKind) -> profiles.Profile:
    return profiles.read("stageros" if link == "rospy" else "stage_ros2")


def step_s(link: graph.LinkKind, robots: int, steps: int) -> float:
    """Return the median step in seconds, on the controllers' side."""
    with ExitStack() as stack:
        here = stack.enter_context(graph.private(link))
        command = [
            sys.executable,
            __file__,
            f"--steps={steps}",
            "--simulation",
            msgspec.json.encode(here.dialled()),
            str(robots),
        ]
        side = stack.enter_context(
            Link(
                here, profile(link), robots=robots, side="controllers", channels=CHANNELS
            )
        )
        simulation = stack.enter_context(subprocess.Popen(command))
        side.ready(TIMEOUT_S)
        side.send(
            [
                Velocity(robot=robot, stamp_ns=0, linear=0.1, angular=0.1)
                for robot in range(robots)
            ]
        )
        times = []
        for _ in range(steps):
            begin = time.perf_counter()
            take(side, Scan, robots)
            side.send(
                [
                    Velocity(robot=robot, stamp_ns=0, linear=0.1, angular=0.1)
                    for robot in range(robots)
                ]
            )
            times.append(time.perf_counter() - begin)
        simulation.wait(TIMEOUT_S)
    return statistics.median(times)


def simulate(here: graph.RosGraph, robots: int, steps: int) -> None:
    """Answer velocities with a scan and a pose of each robot."""
    with Link(
        here, profile(here.link), robots=robots, side="simulation", channels=CHANNELS
    ) as link:
        link.ready(TIMEOUT_S)
        for step in range(steps):
            take(link, Velocity, robots)
            link.send(
                [
                    Clock(stamp_ns=step * STEP_NS),
                    *(m for robot in range(robots) for m in seen(robot, step * STEP_NS)),
                ]
            )
        take(link, Velocity, robots)


def seen(robot: int, stamp_ns: int) -> tuple[Message, Message]:
    return Odometry(robot=robot, stamp_ns=stamp_ns, x=0.1, y=0.2, z=0.6, w=0.8), Scan(
        robot=robot,
        stamp_ns=stamp_ns,
        ranges=np.ones(RAYS, np.float32),
        angle_min=-1.5,
        angle_max=1.5,
        angle_increment=3 / (RAYS - 1),
        range_min=0.0,
        range_max=4.0,
    )


def take(link: Link, kind: type[Message], count: int) -> None:
    """Receive until enough messages of a kind came."""
    while count:
        message = link.receive(TIMEOUT_S)
        if message is None:
            raise TimeoutError(f"{count} {kind.__name__} did not come")
        count -= isinstance(message, kind)


if __name__ == "__main__":
    main()
