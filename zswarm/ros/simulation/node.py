"""The room of turtlebot-exit as a ROS simulation (docs/ros.md).

For each robot that is inside, and once for one that just left, it publishes odometry, ground truth
and scan, with one stamp, after the clock. In lock-step it then waits for a velocity of each.
Free-running it follows real time, as Stage does, with the last velocities, and stops a robot that
got none for the profile's ``watchdog_s``. Odometry is exact and in the room's frame. The clock
restarts with each trial. Run as ``python -m zswarm.ros.simulation.node``.
"""

import json
import os
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple, get_args

import click
import msgspec
import numpy as np

from zswarm.config.decode import convert
from zswarm.errors import ConfigError, EvaluationError
from zswarm.robots.profiles import profile as profiles
from zswarm.robots.profiles.profile import Channel, Profile
from zswarm.ros.link.bridges import frames
from zswarm.ros.link.child import START_S
from zswarm.ros.link.graph import LinkKind, RosGraph
from zswarm.ros.link.link import Link
from zswarm.ros.link.messages import Clock, Message, Odometry, ResetWorld, Scan, Velocity
from zswarm.ros.simulation.lock_step import LockStep, Overdue, Step
from zswarm.sims.turtlebot_exit import TurtlebotExit, TurtlebotExitSettings

POSES: tuple[Channel, ...] = ("odometry", "ground_truth")
PUBLISHED: tuple[Channel, ...] = ("scan", *POSES)  # of each robot
IDLE_S = 60.0  # between polls when nothing is due
NS = 1_000_000_000
NEAREST_M = 0.0  # that the scanner measures


class NodeOptions(NamedTuple):
    """How the node behaves."""

    lock_step: bool
    rate: float  # free-running: s of simulated time per second
    deadline_s: float
    channels: tuple[Channel, ...]  # of ``PUBLISHED``


class SimulationNode:
    """A simulation on a link.

    Attributes:
        poses: of the trial, (robots, 4) float64 at its start and after each step.
    """

    def __init__(
        self, simulator: TurtlebotExit, link: Link, profile: Profile, options: NodeOptions
    ) -> None:
        self._simulator, self._link, self._options = simulator, link, options
        self._watchdog_ns = round(profile.watchdog_s * NS)
        self._has_clock = profile.clock is not None
        self._step_ns = round(simulator.settings.step_s * NS)
        self._period_s = simulator.settings.step_s / options.rate
        self._lock = LockStep(options.deadline_s)
        robots = simulator.settings.robots
        self._linear, self._angular = np.zeros(robots), np.zeros(robots)
        self._heard_ns = np.zeros(robots, np.int64)
        self._agents: list[int] = []  # of the current trial
        self._stamp_ns = 0
        self.poses: list[np.ndarray] = []

    def play(self, seed: int) -> None:
        """Play one trial, to its end."""
        self._begin(seed)
        while self._agents:
            self._handle(self._next_message())

    def serve(self, *, forgiving: bool) -> None:
        """Play trial after trial, as resets come; does not return.

        Args:
            forgiving: a robot that sends no velocity ends only its trial.
        """
        while True:
            message = self._next_message()
            try:
                if isinstance(message, ResetWorld):
                    self._begin(message.seed)
                else:
                    self._handle(message)
            except EvaluationError as error:  # an error of the link is raised again above
                if not forgiving:
                    raise
                self._agents = []
                click.echo(f"zswarm.ros.simulation.node: {error}", err=True)

    def _next_message(self) -> Message | None:
        now = time.monotonic()
        if self._options.lock_step:
            return self._link.receive(self._lock.left_s(now, IDLE_S))
        return self._link.receive(
            max(0.0, self._next_step - now) if self._stamp_ns else IDLE_S
        )

    def _begin(self, seed: int) -> None:
        wait_for_listeners(self._link, self._options.deadline_s, self._options.channels)
        turn = self._simulator.reset(seed)
        self._linear[:] = self._angular[:] = 0
        self._heard_ns[:] = 0
        self._agents, self._stamp_ns = list(turn.agents), self._step_ns
        self.poses = [self._simulator.poses.copy()]
        self._next_step = time.monotonic() + self._period_s
        self._publish(self._agents)
        self._lock.ask(self._agents, self._stamp_ns, time.monotonic())

    def _handle(self, message: Message | None) -> None:
        velocity = message if isinstance(message, Velocity) else None
        if self._options.lock_step:
            self._handle_lock_step(velocity)
            return
        now = time.monotonic()
        if velocity is not None:
            self._take(velocity)
        if self._stamp_ns and now >= self._next_step:
            self._next_step += self._period_s
            silent = self._heard_ns + self._watchdog_ns < self._stamp_ns
            self._linear[silent] = self._angular[silent] = 0
            self._step()

    def _handle_lock_step(self, velocity: Velocity | None) -> None:
        match self._lock.handle(velocity, time.monotonic()):
            case Step(velocities):
                for each in velocities.values():
                    self._take(each)
                self._step()
            case Overdue(robots, stamp_ns):
                raise EvaluationError(
                    f"no velocity of robot {', '.join(map(str, robots))} at {stamp_ns / NS:g} s "
                    f"within {self._options.deadline_s:g} s (deadline_s)"
                )

    def _take(self, velocity: Velocity) -> None:
        robot = velocity.robot
        if 0 <= robot < len(self._linear):
            self._linear[robot], self._angular[robot] = velocity.linear, velocity.angular
            self._heard_ns[robot] = self._stamp_ns

    def _step(self) -> None:
        """Let a step pass and publish it; after a free-running trial only the clock moves."""
        self._stamp_ns += self._step_ns
        robots = self._agents or list(range(len(self._linear)))
        if self._agents:
            turn = self._simulator.drive(self._linear, self._angular)
            self._agents = [] if turn is None else list(turn.agents)
            self.poses.append(self._simulator.poses.copy())
        self._publish(robots)
        if self._options.lock_step:
            self._lock.ask(self._agents, self._stamp_ns, time.monotonic())

    def _publish(self, robots: list[int]) -> None:
        messages: list[Message] = (
            [Clock(stamp_ns=self._stamp_ns)] if self._has_clock else []
        )
        channels = self._options.channels
        for robot in robots:
            odometry = self._odometry(robot)
            if "odometry" in channels:
                messages.append(odometry)
            if "ground_truth" in channels:
                messages.append(msgspec.structs.replace(odometry, truth=True))
            if "scan" in channels:
                messages.append(self._scan(robot))
        self._link.send(messages)

    def _odometry(self, robot: int) -> Odometry:
        pose = dict(zip("xyzw", self._simulator.poses[robot].tolist(), strict=True))
        linear, angular = float(self._linear[robot]), float(self._angular[robot])
        stamp_ns = self._stamp_ns
        return Odometry(
            robot=robot, stamp_ns=stamp_ns, linear=linear, angular=angular, **pose
        )

    def _scan(self, robot: int) -> Scan:
        interface = self._simulator.task.interface
        first = float(np.float32(-interface.view / 2))
        return Scan(
            robot=robot,
            stamp_ns=self._stamp_ns,
            ranges=self._simulator.scans[robot].copy(),
            angle_min=first,
            angle_max=-first,
            angle_increment=float(np.float32(interface.view / (interface.rays - 1))),
            range_min=NEAREST_M,
            range_max=interface.range,
        )


def wait_for_listeners(
    link: Link, timeout_s: float, channels: tuple[Channel, ...]
) -> None:
    """Wait until channels are connected; of poses one is enough, since controllers use one."""
    poses = [channel for channel in channels if channel in POSES]
    link.ready(
        timeout_s, [channel for channel in channels if channel not in POSES], either=poses
    )


def _end_with_parent() -> None:
    """Report that the node is ready, and end when its standard input closes; see ``Child``."""

    def wait() -> None:
        while os.read(0, frames.CHUNK):
            pass
        os._exit(0)  # the link's child ends when its own input closes

    os.write(1, frames.frame(frames.CONTROL, b""))
    threading.Thread(target=wait, daemon=True).start()


LINKS = click.Choice(get_args(LinkKind))
MODES = click.Choice(["lock-step", "free-running"])
SEED = click.IntRange(0, 2**64 - 1)
FILE = click.Path(dir_okay=False, path_type=Path)
CHANNELS = "published for each robot, separated by commas"


@click.command()
@click.option("--link", type=LINKS, required=True, help="how to reach ROS")
@click.option(
    "--profile", required=True, help="names of topics: a bundled profile, or FILE.toml"
)
@click.option("--master", default="", help="rospy: URI of the master")
@click.option("--domain", default=0, help="rclpy, zenoh: ROS domain")
@click.option("--connect", multiple=True, help="zenoh: endpoint to dial")
@click.option("--listen", multiple=True, help="zenoh: endpoint to listen on")
@click.option(
    "--local/--not-local", default=True, help="whether nothing leaves this machine"
)
@click.option("--settings", default="{}", help="of turtlebot-exit, as JSON")
@click.option("--channels", default=",".join(PUBLISHED), help=CHANNELS)
@click.option("--mode", type=MODES, default="lock-step")
@click.option(
    "--rate", type=click.FloatRange(1e-3, 1e3), default=1.0, help="free-running: speed"
)
@click.option(
    "--deadline-s", type=click.FloatRange(1e-3, 1e6), default=10.0, help="for an answer"
)
@click.option("--seed", type=SEED, help="play one trial, print its outcome and end")
@click.option("--poses", type=FILE, help="with --seed: FILE.npy of all poses")
@click.option("--child", is_flag=True, hidden=True, help="started by a slot")
def main(**options: Any) -> None:
    """Simulate the room of turtlebot-exit for ROS."""
    try:
        run(SimpleNamespace(**options))
    except (ConfigError, EvaluationError) as error:
        click.echo(f"zswarm.ros.simulation.node: {error}", err=True)
        sys.exit(2 if isinstance(error, ConfigError) else 1)


def run(given: Any) -> None:
    """Set up and play, with the options of ``main``."""
    names = set(given.channels.split(","))
    if unknown := names - {*PUBLISHED}:
        raise ConfigError(
            f"--channels: expected some of {', '.join(PUBLISHED)}, not {min(unknown)!r}"
        )
    try:
        parsed = json.loads(given.settings)
    except ValueError as error:
        raise ConfigError(f"--settings: expected JSON: {error}") from None
    profile = profiles.read(given.profile)
    simulator = TurtlebotExit(convert(parsed, TurtlebotExitSettings, "--settings"))
    reach = {name: getattr(given, name) for name in ("link", "master", "domain", "local")}
    graph = RosGraph(**reach, connect=list(given.connect), listen=list(given.listen))
    published = tuple(
        each for each in PUBLISHED if each in names and each in profile.channels
    )
    used = {*published, "clock", "velocity", "reset"}
    options = NodeOptions(
        given.mode == "lock-step", given.rate, given.deadline_s, published
    )
    robots = simulator.settings.robots
    channels = [channel for channel in profile.channels if channel in used]
    with Link(
        graph, profile, robots=robots, side="simulation", channels=channels
    ) as link:
        node = SimulationNode(simulator, link, profile, options)
        if given.child:
            _end_with_parent()
        if given.seed is None:
            node.serve(forgiving=not given.child)
            return
        wait_for_listeners(link, max(given.deadline_s, START_S), (*published, "velocity"))
        node.play(given.seed)
        if given.poses is not None:
            np.save(given.poses, np.stack(node.poses))
        steps = len(node.poses) - 1
        click.echo(
            json.dumps({"seed": given.seed, **_outcome(simulator), "steps": steps})
        )


def _outcome(simulator: TurtlebotExit) -> dict[str, Any]:
    outcome = simulator.outcome()
    metrics = dict(zip(simulator.metrics, map(float, outcome.metrics), strict=True))
    return {"fitness": outcome.fitness[0], "metrics": metrics}


if __name__ == "__main__":
    main()
