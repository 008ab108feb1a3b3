"""TurtleBots leave a room: EmergencyExit as the paper's robots play it in ROS, with motors, lasers and contacts.

The world (``robot_world``) takes what ``cmd_vel`` carries and gives what ``base_scan`` and ``base_pose_ground_truth`` do; all
else is the task, in this file.
"""

from collections.abc import Sequence
from typing import Annotated, Literal

import numpy as np
from msgspec import Meta

from zswarm.draws import Stream
from zswarm.sims.robot_world import (
    SCAN,
    SECTORS,
    Area,
    Metres,
    RobotSettings,
    RobotWorld,
    bearings,
    require_room,
    sectors,
    shrunk,
    strew,
)
from zswarm.sims.simulator import Frame, Outcome, Place, Simulator, Turn

ROOM: Area = (-2.5, -2.5, 2.5, 2.5)
EXITS = ((-2.0, 1.0), (2.0, 1.0))
START: Area = (-1.2, -2.5, 1.2, 0.0)  # around (0, -1); robots stand within it at first
WALLS: dict[str, list[Area]] = {
    "open": [],
    # A cup over the start: who drives straight to an exit ends in a corner of it.
    "small-maze": [(-1.3, 0.0, 1.3, 0.1), (-1.3, -0.8, -1.2, 0.0), (1.2, -0.8, 1.3, 0.0)],
}
LOG_S = 2.0  # the paper's robots write a line of their log so often
FARTHEST, LONGEST, ARRIVED = 50.0, 90, 0.2  # m, lines and m of the fitness cpswarm-log


class Settings(RobotSettings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of ``[problem.settings]``."""

    map: Annotated[
        Literal["small-maze", "open"],
        Meta(description="small-maze: walls on the way, straight to an exit is a dead end; open: none"),
    ] = "small-maze"
    epsilon: Annotated[Metres, Meta(description="m from an exit at which a robot is out")] = 0.15
    fitness: Annotated[
        Literal["last-distance", "cpswarm-log"],
        Meta(description="last-distance: minus the sum of the last distances; cpswarm-log: by distance and time, 0 to 200"),
    ] = "last-distance"


class TurtlebotExit(Simulator):
    """TurtleBots with laser scanners leave a room by two exits; walls, and each other, are in their way.

    The room is 5 m by 5 m, the origin in its middle, x to the right, y up, angles in radians, counter-clockwise; exits are at
    (-2, 1) and (2, 1). Robots are discs with a mass; their wheels drive and brake with ``force`` at most, pymunk does the
    contacts.

    Observation: (10,) float32. 0-7: how near something is in each eighth of the laser's view, from the right to the left: 1 -
        shortest range / ``range``. 8-9: direction of the nearest exit, a unit vector: ahead, to the left.
    Action: (2,) float32 drive, turn: ``speed`` (2 drive - 1) m/s ahead and ``turn`` (2 turn - 1) rad/s to the left, each cut to
        0..1.
    Turns: all robots that are still inside, at once, every ``step_s``.
    Start: places around (0, -1) and headings from the trial's seed, at rest.
    End: after ``steps`` steps, or when all are out. A robot is out when its centre is nearer than ``epsilon`` to an exit; it is
        taken out of the room.
    Fitness: last-distance: minus the sum over robots of the last distance to the nearest exit, m; at most 0. cpswarm-log: the
        mean over robots of 100 (50 - d) / 50 + (if d < .2) 100 (90 - t) / 90, d the last distance, at most 50, and t the lines of
        its log, one each 2 s, at most 90.
    Metrics: ``escaped``: robots; ``distance``: mean last distance, m; ``seconds``: until all were out, or the end.
    """

    settings_type = Settings
    metrics = ("escaped", "distance", "seconds")
    sensors = (*SCAN, "exit_ahead", "exit_left")
    actuators = ("drive", "turn")
    inputs, outputs = len(sensors), len(actuators)
    settings: Settings

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings)
        self.owners = (0,) * settings.robots
        self._start = shrunk(START, settings.radius)
        require_room("turtlebot-exit", "robots", settings.robots, settings.radius, self._start)
        self._world = RobotWorld(settings, ROOM, WALLS[settings.map])
        self._exits, self._none_gone = np.array(EXITS), np.zeros(len(EXITS), np.int64)
        self._distances, self._nearest = np.zeros(settings.robots), np.zeros(settings.robots, np.int64)
        self._left = np.zeros(settings.robots, np.int64)  # steps until each was out

    def reset(self, seed: int) -> Turn:
        """Put the robots around (0, -1)."""
        places = strew(Stream(seed), self.settings.robots, self.settings.radius, self._start)
        self._world.start(np.array(places), np.zeros((0, 3)))
        self._steps = 0
        self._left[:] = self.settings.steps
        self._agents = np.arange(self.settings.robots)
        return self._turn(self._observe())

    def step(self, actions: np.ndarray) -> Turn | None:
        """Drive; who is at an exit then is out."""
        self._world.obey(actions, self._agents)
        self._steps += 1
        observations = self._observe()
        out = [robot for robot in self._agents.tolist() if self._distances[robot] < self.settings.epsilon]
        for robot in out:
            self._world.take_out(robot)
            self._left[robot] = self._steps
        if out:
            self._agents = np.flatnonzero(self._world.inside)
        over = self._steps == self.settings.steps or not self._agents.size
        return None if over else self._turn(observations)

    def outcome(self) -> Outcome:
        """Fitness and metrics of the trial that ended."""
        distances, out = self._distances.tolist(), self._world.inside.tolist().count(0)
        seconds = [steps * self.settings.step_s for steps in self._left.tolist()]
        if self.settings.fitness == "last-distance":
            fitness = -sum(distances)
        else:
            fitness = cpswarm_log(distances, [int(time_s / LOG_S) + 1 for time_s in seconds])
        return Outcome([fitness], [out, sum(distances) / len(distances), max(seconds)])

    def frame(self) -> Frame:
        """The room; robots that are out are shown at the exit."""
        size = self.settings.epsilon
        exits = [Place("exit", x - size, y - size, 2 * size, 2 * size) for x, y in EXITS]
        kinds = ["robot" if inside else "robot that is out" for inside in self._world.inside.tolist()]
        return self._world.frame(exits, kinds, [])

    def _observe(self) -> np.ndarray:
        """(robots, inputs + 1) float32, the last not to be seen; and how far each robot is from its nearest exit."""
        observations = np.empty((self.settings.robots, self.inputs + 1), np.float32)
        sectors(self._world.ranges, np.float32(self.settings.range), observations)
        bearings(
            self._world.poses, self._world.headings, self._exits, self._none_gone, np.inf, SECTORS, observations, self._distances,
            self._nearest,
        )  # fmt: skip
        return observations

    def _turn(self, observations: np.ndarray) -> Turn:
        return Turn(self._agents.tolist(), observations[self._agents, : self.inputs])


def cpswarm_log(distances: Sequence[float], lines: Sequence[int]) -> float:
    """The fitness that the paper's authors computed from their robots' logs.

    Args: distances: m, in the last line of each log. lines: of each log.
    """
    total = 0.0
    for distance, count in zip(distances, lines, strict=True):
        far, long = min(distance, FARTHEST), min(count, LONGEST)
        total += (FARTHEST - far) / FARTHEST * 100
        if far < ARRIVED:
            total += (LONGEST - long) / LONGEST * 100
    return total / len(distances)
