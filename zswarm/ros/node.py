"""The room of turtlebot-exit as a ROS simulation, with the topics of a profile: ``python -m zswarm.ros.node`` (docs/ros.md).

It speaks of each robot that is inside, and at last of one that got out: odometry, ground truth and scan, with one stamp, after
the clock. In lock-step it then waits for a velocity of each; free-running it goes on by the wall's clock, as Stage does, with the
velocity that came last, and stops a robot that nobody told anything for the profile's ``watchdog_s`` of its time. Odometry is
exact and in the room's frame. The clock begins anew with each trial.
"""

import json
import os
import sys
import threading
import time
from pathlib import Path
from typing import Any, NamedTuple, get_args

import click
import msgspec
import numpy as np

from zswarm.errors import ConfigError, EvaluationError
from zswarm.ros import profiles
from zswarm.ros.bridges import frames
from zswarm.ros.child import START_S
from zswarm.ros.graph import Graph, LinkKind
from zswarm.ros.link import Link
from zswarm.ros.lock_step import LockStep, Overdue, Step
from zswarm.ros.messages import Clock, Message, Odometry, Reset, Scan, Velocity
from zswarm.ros.profiles import Channel, Profile
from zswarm.sims.turtlebot_exit import Settings, TurtlebotExit
from zswarm.strict import convert

POSES: tuple[Channel, ...] = ("odometry", "ground_truth")
TOLD: tuple[Channel, ...] = ("scan", *POSES)  # of each robot
IDLE_S = 60.0  # between two looks at nothing
NS = 1_000_000_000
NEAREST_M = 0.0  # that the scanner measures


class Options(NamedTuple):
    """How the node behaves."""

    lock_step: bool
    rate: float  # free-running: s of the simulation in one of the wall's clock
    deadline_s: float
    told: tuple[Channel, ...]  # of ``TOLD``


class Node:
    """A simulation on a link."""

    def __init__(self, simulator: TurtlebotExit, link: Link, profile: Profile, options: Options) -> None:
        self._simulator, self._link, self._options = simulator, link, options
        self._watchdog_ns = round(profile.watchdog_s * NS)
        self._clock = profile.clock is not None
        self._step_ns = round(simulator.settings.step_s * NS)
        self._lock = LockStep(options.deadline_s)
        robots = simulator.settings.robots
        self._linear, self._angular = np.zeros(robots), np.zeros(robots)
        self._heard_ns = np.zeros(robots, np.int64)
        self._agents: list[int] = []  # of the trial under way
        self._stamp_ns = 0
        self.poses: list[np.ndarray] = []  # of the trial, (robots, 4) float64 at its start and after each step

    def play(self, seed: int) -> None:
        """One trial, to its end.

        Raises:
            EvaluationError: a robot told nothing in time.
        """
        self._begin(seed)
        while self._agents:
            self._go_on(self._next_message())

    def serve(self, *, forgiving: bool) -> None:
        """Trial after trial, as resets come; does not return.

        Args:
            forgiving: a robot that tells nothing ends its trial only.

        Raises:
            EvaluationError: the link broke, or somebody was not there or told nothing in time.
        """
        while True:
            message = self._next_message()
            try:
                if isinstance(message, Reset):
                    self._begin(message.seed)
                else:
                    self._go_on(message)
            except EvaluationError as error:  # where it is the link's, the next message says so again
                if not forgiving:
                    raise
                self._agents = []
                click.echo(f"zswarm.ros.node: {error}", err=True)

    def _next_message(self) -> Message | None:
        now = time.monotonic()
        if self._options.lock_step:
            return self._link.receive(self._lock.left_s(now, IDLE_S))
        return self._link.receive(max(0.0, self._next_step - now) if self._stamp_ns else IDLE_S)

    def _begin(self, seed: int) -> None:
        wait_for_listeners(self._link, self._options.deadline_s, self._options.told)
        turn = self._simulator.reset(seed)
        self._linear[:] = self._angular[:] = 0
        self._heard_ns[:] = 0
        self._agents, self._stamp_ns = list(turn.agents), self._step_ns
        self.poses = [self._simulator.poses.copy()]
        self._next_step = time.monotonic() + self._simulator.settings.step_s / self._options.rate
        self._tell(self._agents)
        self._lock.ask(self._agents, self._stamp_ns, time.monotonic())

    def _go_on(self, message: Message | None) -> None:
        velocity = message if isinstance(message, Velocity) else None
        now = time.monotonic()
        if self._options.lock_step:
            match self._lock.handle(velocity, now):
                case Step(velocities):
                    for told in velocities.values():
                        self._take(told)
                    self._step()
                case Overdue(robots, stamp_ns):
                    silent = ", ".join(map(str, robots))
                    raise EvaluationError(
                        f"no velocity of robot {silent} at {stamp_ns / NS:g} s within {self._options.deadline_s:g} s (deadline_s)"
                    )
            return
        if velocity is not None:
            self._take(velocity)
        if self._stamp_ns and now >= self._next_step:
            self._next_step += self._simulator.settings.step_s / self._options.rate
            silent_robots = self._heard_ns + self._watchdog_ns < self._stamp_ns
            self._linear[silent_robots] = self._angular[silent_robots] = 0
            self._step()

    def _take(self, velocity: Velocity) -> None:
        if 0 <= velocity.robot < len(self._linear):
            self._linear[velocity.robot], self._angular[velocity.robot] = velocity.linear, velocity.angular
            self._heard_ns[velocity.robot] = self._stamp_ns

    def _step(self) -> None:
        """Let a step pass and tell of it; after the end of a free-running trial time goes on and nothing moves."""
        self._stamp_ns += self._step_ns
        acted = self._agents or list(range(len(self._linear)))
        if self._agents:
            turn = self._simulator.drive(self._linear, self._angular)
            self._agents = [] if turn is None else list(turn.agents)
            self.poses.append(self._simulator.poses.copy())
        self._tell(acted)
        if self._options.lock_step:
            self._lock.ask(self._agents, self._stamp_ns, time.monotonic())

    def _tell(self, robots: list[int]) -> None:
        simulator, told = self._simulator, self._options.told
        messages: list[Message] = [Clock(stamp_ns=self._stamp_ns)] if self._clock else []
        interface = simulator.task.interface
        first, spread = float(np.float32(-interface.view / 2)), float(np.float32(interface.view / (interface.rays - 1)))
        for robot in robots:
            x, y, z, w = simulator.poses[robot].tolist()
            linear, angular = float(self._linear[robot]), float(self._angular[robot])
            odometry = Odometry(robot=robot, stamp_ns=self._stamp_ns, x=x, y=y, z=z, w=w, linear=linear, angular=angular)
            if "odometry" in told:
                messages.append(odometry)
            if "ground_truth" in told:
                messages.append(msgspec.structs.replace(odometry, truth=True))
            if "scan" in told:
                messages.append(
                    Scan(
                        robot=robot, stamp_ns=self._stamp_ns, ranges=simulator.scans[robot].copy(), angle_min=first,
                        angle_max=-first, angle_increment=spread, range_min=NEAREST_M, range_max=interface.range,
                    )
                )  # fmt: skip
        self._link.send(messages)


def wait_for_listeners(link: Link, timeout_s: float, channels: tuple[Channel, ...]) -> None:
    """Wait until channels are connected; of poses one source is enough, for controllers hear one.

    Raises:
        EvaluationError: not in time.
    """
    poses = [channel for channel in channels if channel in POSES]
    link.ready(timeout_s, [channel for channel in channels if channel not in POSES], either=poses)


def _belong_to_parent() -> None:
    """Say that the node is there, and end with whoever holds the other end of standard input; see ``child.Child``."""

    def wait() -> None:
        while os.read(0, frames.CHUNK):
            pass
        os._exit(0)  # the link's child ends when its own input closes

    os.write(1, frames.frame(frames.CONTROL, b""))
    threading.Thread(target=wait, daemon=True).start()


@click.command()
@click.option("--link", type=click.Choice(get_args(LinkKind)), required=True, help="how ROS is reached")
@click.option("--profile", required=True, help="names of topics: a bundled profile, or FILE.toml")
@click.option("--master", default="", help="rospy: URI of the master")
@click.option("--domain", default=0, help="rclpy, zenoh: ROS domain")
@click.option("--connect", multiple=True, help="zenoh: endpoint to dial")
@click.option("--listen", multiple=True, help="zenoh: endpoint to listen on")
@click.option("--local/--not-local", default=True, help="whether nothing leaves this machine")
@click.option("--settings", default="{}", help="of turtlebot-exit, as JSON")
@click.option("--channels", default=",".join(TOLD), help="what is told of each robot, with commas")
@click.option("--mode", type=click.Choice(["lock-step", "free-running"]), default="lock-step")
@click.option("--rate", type=click.FloatRange(1e-3, 1e3), default=1.0, help="free-running: times as fast as the wall's clock")
@click.option("--deadline-s", type=click.FloatRange(1e-3, 1e6), default=10.0, help="a robot must answer in")
@click.option("--seed", type=click.IntRange(0, 2**64 - 1), default=None, help="play one trial, tell its outcome and end")
@click.option("--poses", type=click.Path(dir_okay=False, path_type=Path), default=None, help="with --seed: FILE.npy of all poses")
@click.option("--child", is_flag=True, hidden=True, help="a slot's own")
def main(**options: Any) -> None:
    """Simulate the room of turtlebot-exit for ROS."""
    try:
        run(**options)
    except (ConfigError, EvaluationError) as error:
        click.echo(f"zswarm.ros.node: {error}", err=True)
        sys.exit(2 if isinstance(error, ConfigError) else 1)


def run(
    *, link: LinkKind, profile: str, settings: str, channels: str, mode: str, rate: float, deadline_s: float, seed: int | None,
    poses: Path | None, child: bool, **reach: Any,
) -> None:  # fmt: skip
    """Set up and go on.

    Raises:
        ConfigError: something in what was asked for is impossible.
        EvaluationError: the link broke, or in the one trial a robot told nothing in time.
    """
    found = profiles.read(profile)
    told = tuple(channel for channel in TOLD if channel in channels.split(",") and channel in found.channels)
    if unknown := set(channels.split(",")) - {*TOLD}:
        raise ConfigError(f"--channels: expected some of {', '.join(TOLD)}, not {sorted(unknown)[0]!r}")
    try:
        parsed = json.loads(settings)
    except ValueError as error:
        raise ConfigError(f"--settings: expected JSON: {error}") from None
    simulator = TurtlebotExit(convert(parsed, Settings, "--settings"))
    graph = Graph(
        link=link, master=reach["master"], domain=reach["domain"], connect=list(reach["connect"]), listen=list(reach["listen"]),
        local=reach["local"],
    )  # fmt: skip
    robots = simulator.settings.robots
    used = [channel for channel in found.channels if channel in (*told, "clock", "velocity", "reset")]
    options = Options(mode == "lock-step", rate, deadline_s, told)
    with Link(graph, found, robots=robots, side="simulation", channels=used) as opened:
        node = Node(simulator, opened, found, options)
        if child:
            _belong_to_parent()
        if seed is None:
            node.serve(forgiving=not child)
            return
        wait_for_listeners(opened, max(deadline_s, START_S), (*told, "velocity"))
        node.play(seed)
        if poses is not None:
            np.save(poses, np.stack(node.poses))
        outcome = simulator.outcome()
        metrics = dict(zip(simulator.metrics, map(float, outcome.metrics), strict=True))
        line = {"seed": seed, "fitness": outcome.fitness[0], "metrics": metrics, "steps": len(node.poses) - 1}
        click.echo(json.dumps(line))


if __name__ == "__main__":
    main()
