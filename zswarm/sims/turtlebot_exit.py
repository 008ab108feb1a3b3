"""Simulate TurtleBots that leave a room: EmergencyExit with motors, lasers and contacts.

The paper's robots play it in ROS. The world (``physics``) takes what ``cmd_vel`` carries and
returns what ``base_scan`` and ``base_pose_ground_truth`` carry. The task uses nothing else, so it
is the same in this process and in ROS (``zswarm/ros``).
"""

from typing import Annotated, Literal

import numpy as np

from zswarm.config.meta import about
from zswarm.kernels.jit import float32, int64, kernel, void
from zswarm.kernels.portable import PI, cos, sin
from zswarm.kernels.random import Stream
from zswarm.kernels.signatures import Float32Rows, Float64Rows, Float64s
from zswarm.sims.exit_fitness import cpswarm_log, last_distance
from zswarm.sims.physics import Metres, RobotSettings, RobotWorld
from zswarm.sims.physics_kernels import SCAN, SECTORS, command
from zswarm.sims.physics_picture import picture
from zswarm.sims.physics_stall import StallWorld
from zswarm.sims.placing import Area, require_room, shrunk, strew
from zswarm.sims.robot_interface import observe
from zswarm.sims.simulator import (
    Frame,
    Outcome,
    Rectangle,
    RobotInterface,
    Simulator,
    Turn,
)

ROOM: Area = (-2.5, -2.5, 2.5, 2.5)
EXITS = ((-2.0, 1.0), (2.0, 1.0))
START: Area = (-1.2, -2.5, 1.2, 0.0)  # around (0, -1); robots stand within it at first
WALLS: dict[str, list[Area]] = {
    "open": [],
    # A cup over the start: who drives straight to an exit ends in a corner of it.
    "small-maze": [(-1.3, 0.0, 1.3, 0.1), (-1.3, -0.8, -1.2, 0.0), (1.2, -0.8, 1.3, 0.0)],
}
LOG_S = 2.0  # the paper's robots write a line of their log so often


class TurtlebotExitSettings(RobotSettings, frozen=True):
    """Settings of ``[problem.settings]``."""

    map: Annotated[
        Literal["small-maze", "open"],
        about(
            "small-maze: walls make the straight way to an exit a dead end; open: no walls"
        ),
    ] = "small-maze"
    epsilon: Annotated[Metres, about("m from an exit at which a robot leaves")] = 0.15
    contact: Annotated[
        Literal["slide", "stall"],
        about(
            "slide: robots push and slide along what they touch; stall: a move that would touch "
            "something is undone, its turn included, as in Stage; then mass, force, friction and "
            "restitution have no effect"
        ),
    ] = "slide"
    after_exit: Annotated[
        Literal["remove", "stay"],
        about("robots that are out are removed, or stay in the way of others, as in ROS"),
    ] = "remove"
    fitness: Annotated[
        Literal["last-distance", "cpswarm-log"],
        about(
            "last-distance: minus the sum of the last distances; cpswarm-log: by "
            "distance and time, 0 to 200"
        ),
    ] = "last-distance"


class ExitTask:
    """Track a trial by robots' messages: which robots act, their observations, and the outcome.

    Attributes:
        interface: the conversion of messages to observations.
        agents: (k,) int64, the robots that are still inside.
        distances: (robots,) float64, m of each to its nearest exit, as last measured.
    """

    def __init__(self, settings: TurtlebotExitSettings) -> None:
        self.settings = settings
        self.interface = RobotInterface(
            rays=settings.rays,
            view=settings.view * PI / 180,
            range=settings.range,
            sectors=SECTORS,
            targets=EXITS,
            arrived=settings.epsilon,
            speed=settings.speed,
            turn=settings.turn,
            step_s=settings.step_s,
            radius=settings.radius,
        )
        self._exits = np.array(EXITS).ravel()
        self.distances = np.zeros(settings.robots)
        self._left = np.zeros(settings.robots, np.int64)  # steps until each was out
        self.linear = np.zeros(settings.robots)
        self.angular = np.zeros(settings.robots)

    def begin(self, scans: np.ndarray, poses: np.ndarray) -> Turn:
        """Start a trial; see ``go_on``."""
        self._steps = 0
        self._left[:] = self.settings.steps
        self.agents = np.arange(self.settings.robots)
        self.linear[:] = self.angular[:] = 0
        return self._turn(self._observe(scans, poses))

    def decide(self, actions: np.ndarray) -> None:
        """Set ``linear`` and ``angular``, (robots,) float64 in m/s and rad/s, of those that act.

        Args:
            actions: (agents, 2) float32.
        """
        command(
            np.ascontiguousarray(actions),
            self.agents,
            self.settings.speed,
            self.settings.turn,
            self.linear,
            self.angular,
        )

    def go_on(
        self, scans: np.ndarray, poses: np.ndarray, passed: int = 1
    ) -> tuple[Turn | None, list[int]]:
        """Return the turn after a step, None at the end, and the robots that are out since then.

        Args:
            scans: (robots, rays) float32, m.
            poses: (robots, 4) float64: x, y, and z, w of the quaternion.
            passed: steps, where the world does not wait for its robots.
        """
        self._steps = min(self._steps + passed, self.settings.steps)
        observations = self._observe(scans, poses)
        out = [
            robot
            for robot in self.agents.tolist()
            if self.distances[robot] < self.settings.epsilon
        ]
        self._left[out] = self._steps
        self.agents = self.agents[~np.isin(self.agents, out)]
        over = self._steps == self.settings.steps or not self.agents.size
        return None if over else self._turn(observations), out

    def outcome(self) -> Outcome:
        """Return fitness and metrics of the trial that ended."""
        distances = self.distances.tolist()
        seconds = [steps * self.settings.step_s for steps in self._left.tolist()]
        total = last_distance(distances)
        if self.settings.fitness == "last-distance":
            fitness = total
        else:
            fitness = cpswarm_log(
                distances, [int(time_s / LOG_S) + 1 for time_s in seconds]
            )
        return Outcome(
            [fitness],
            [len(distances) - self.agents.size, -total / len(distances), max(seconds)],
        )

    def _observe(self, scans: np.ndarray, poses: np.ndarray) -> np.ndarray:
        """Return observations, (robots, inputs) float32, after updating ``distances``."""
        observations = np.empty((self.settings.robots, SECTORS + 2), np.float32)
        observe_each(
            scans,
            poses,
            np.float32(self.settings.range),
            SECTORS,
            self._exits,
            observations,
            self.distances,
        )
        return observations

    def _turn(self, observations: np.ndarray) -> Turn:
        return Turn(self.agents.tolist(), observations[self.agents])


class TurtlebotExit(Simulator):
    """Simulate TurtleBots with laser scanners that leave a room by two exits.

    Walls, and other robots, are in their way.

    The room is 5 m by 5 m, the origin in its middle, x to the right, y up, angles in radians,
    counter-clockwise; exits are at (-2, 1) and (2, 1). Robots are discs with a mass; their wheels
    drive and brake with ``force`` at most, pymunk does the contacts.

    Observation: (10,) float32. 0-7: how near something is in each eighth of the laser's view, from
        the right to the left: 1 - shortest range / ``range``. 8-9: direction of the nearest exit, a
        unit vector: ahead, to the left.
    Action: (2,) float32 drive, turn: ``speed`` (2 drive - 1) m/s ahead and ``turn`` (2 turn - 1)
        rad/s to the left, each cut to 0..1.
    Turns: all robots that are still inside, at once, every ``step_s``.
    Start: places around (0, -1) and headings from the trial's seed, at rest.
    End: after ``steps`` steps, or when all are out. A robot is out when its centre is nearer than
        ``epsilon`` to an exit; it is taken out of the room, or stands there (``after_exit``).
    Fitness: last-distance: minus the sum over robots of the last distance to the nearest exit, m;
        at most 0. cpswarm-log: the mean over robots of 100 (50 - d) / 50 + (if d < .2) 100 (90 - t)
        / 90, d the last distance, at most 50, and t the lines of its log, one each 2 s, at most 90.
    Metrics: ``escaped``: robots; ``distance``: mean last distance, m; ``seconds``: until all were
    out, or the end.
    """

    settings_type = TurtlebotExitSettings
    metrics = ("escaped", "distance", "seconds")
    sensors = (*SCAN, "exit_ahead", "exit_left")
    actuators = ("drive", "turn")
    inputs, outputs = len(sensors), len(actuators)
    settings: TurtlebotExitSettings

    def __init__(self, settings: TurtlebotExitSettings) -> None:
        super().__init__(settings)
        self.owners = (0,) * settings.robots
        self._start = shrunk(START, settings.radius)
        require_room(
            "turtlebot-exit", "robots", settings.robots, settings.radius, self._start
        )
        self.task = ExitTask(settings)
        self.robot = self.task.interface
        kind = StallWorld if settings.contact == "stall" else RobotWorld
        self._world = kind(settings, ROOM, WALLS[settings.map])
        # (robots, rays) float32, m; of one that is out the last.
        self.scans = self._world.ranges
        # x, y, and z, w of the quaternion, likewise.
        self.poses = np.zeros((settings.robots, 4))

    def reset(self, seed: int) -> Turn:
        """Put the robots around (0, -1)."""
        places = strew(
            Stream(seed), self.settings.robots, self.settings.radius, self._start
        )
        self._world.start(np.array(places), np.zeros((0, 3)))
        as_messages(self._world.poses, self.poses)
        return self.task.begin(self.scans, self.poses)

    def step(self, actions: np.ndarray) -> Turn | None:
        """Drive as decided; robots that are then at an exit are out."""
        self.task.decide(actions)
        return self.drive(self.task.linear, self.task.angular)

    def drive(self, linear: np.ndarray, angular: np.ndarray) -> Turn | None:
        """Do as ``step``, with velocities: (robots,) float64, m/s and rad/s counter-clockwise."""
        stay = self.settings.after_exit == "stay"
        if stay:
            acts = np.isin(np.arange(self.settings.robots), self.task.agents)
            linear, angular = np.where(acts, linear, 0.0), np.where(acts, angular, 0.0)
            left = self.poses[~acts]
        self._world.drive(linear, angular)
        as_messages(self._world.poses, self.poses)
        if stay:  # what they have reached is theirs, though others may push them
            self.poses[~acts] = left
        turn, out = self.task.go_on(self.scans, self.poses)
        for robot in () if stay else out:
            self._world.take_out(robot)
        return turn

    def outcome(self) -> Outcome:
        """Return fitness and metrics of the trial that ended."""
        return self.task.outcome()

    def frame(self) -> Frame:
        """Return the room; robots that are out are shown at the exit."""
        return self.picture(self._world.poses, self.task.agents)

    def picture(self, poses: np.ndarray, agents: np.ndarray) -> Frame:
        """Return the room with robots at such places.

        Args:
            poses: (robots, 3) float64: x, y, angle.
            agents: those that are inside.
        """
        self._world.poses[:] = poses
        size = self.settings.epsilon
        exits = [
            Rectangle("exit", x - size, y - size, 2 * size, 2 * size) for x, y in EXITS
        ]
        kinds = [
            "robot" if robot in agents else "robot that is out"
            for robot in range(self.settings.robots)
        ]
        return picture(self._world, exits, kinds, [])


@kernel(void(Float64Rows, Float64Rows))
def as_messages(poses, odometry):  # type: ignore[no-untyped-def]  # compiled
    """Convert poses to those of odometry messages.

    Args:
        poses: (robots, 3) float64: x, y, angle.
        odometry: (robots, 4) float64, filled: x, y, z, w; the last two are of a quaternion, of
        which x and y are 0 on a floor.
    """
    for robot in range(poses.shape[0]):
        half = 0.5 * poses[robot, 2]
        odometry[robot, 0] = poses[robot, 0]
        odometry[robot, 1] = poses[robot, 1]
        odometry[robot, 2] = sin(half)
        odometry[robot, 3] = cos(half)


@kernel(void(Float32Rows, Float64Rows, float32, int64, Float64s, Float32Rows, Float64s))
def observe_each(scans, poses, reach, sectors, targets, observations, distances):  # type: ignore[no-untyped-def]  # compiled
    """Write each robot's observation and distance, see ``robot_interface.observe``."""
    for robot in range(scans.shape[0]):
        distances[robot] = observe(
            scans[robot],
            scans.shape[1],
            reach,
            sectors,
            poses[robot, 0],
            poses[robot, 1],
            poses[robot, 2],
            poses[robot, 3],
            targets,
            targets.shape[0] // 2,
            observations[robot],
        )
