"""Tasks in which robots of ``physics`` move things through a square room."""

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np

from zswarm.kernels.random import Stream
from zswarm.sims.physics import Movable, RobotSettings, RobotWorld, Side
from zswarm.sims.physics_kernels import SECTORS, bearings, sectors
from zswarm.sims.placing import Area, Pose, require_room, shrunk, strew
from zswarm.sims.simulator import Outcome, Simulator, Turn


class TransportSettings(RobotSettings, frozen=True):
    """Settings that these tasks share."""

    side: Side = 5.0


class Transport(Simulator):
    """Robots and things in a room with x to the right and y up from the lower left corner.

    Observations 0-7 are the scan's sectors, 8-10 the bearing of the nearest thing that is free,
    11-12 the direction in which things are to be moved.

    Attributes:
        name: of the simulator, for errors.
        towards: (2,), factors that turn a heading into that direction, ahead and to the left.
        metrics: how much arrived, how far it came, and the seconds until all arrived or the end.
    """

    name: ClassVar[str]
    towards: ClassVar[np.ndarray]
    actuators = ("drive", "turn")
    outputs = len(actuators)
    settings: Any

    def __init__(
        self,
        settings: TransportSettings,
        things: Sequence[Movable],
        what: str,
        covered: float,
    ) -> None:
        """Build the room.

        Args:
            settings: of the task.
            things: what robots move.
            what: their name, for errors.
            covered: area that they take at the start, in areas of a robot.
        """
        super().__init__(settings)
        room: Area = (0.0, 0.0, settings.side, settings.side)
        robots = settings.robots
        radius = settings.radius
        self._area = shrunk(room, radius)
        number = robots + int(covered) + 1
        require_room(self.name, f"robots beside the {what}", number, radius, self._area)
        self.owners = (0,) * robots
        self._world = RobotWorld(settings, room, [], things)
        self._agents = np.arange(robots)
        self._gone = np.zeros(len(things), np.int64)  # 0: free
        self._distances = np.zeros(robots)
        self._nearest = np.zeros(robots, np.int64)

    def _start(self, stream: Stream, things: Sequence[Pose], radius: float) -> Turn:
        """Start a trial with robots anywhere beside the things, which have a radius."""
        taken = [(x, y, radius) for x, y, _ in things]
        robots = strew(
            stream, self.settings.robots, self.settings.radius, self._area, taken
        )
        self._world.start(np.array(robots), np.array(things))
        self._from = self._world.things[:, 0].copy()
        self._gone[:] = 0
        self._steps = 0
        return self._turn()

    def _step(self, actions: np.ndarray) -> None:
        """Let robots drive."""
        self._world.obey(actions, self._agents)
        self._steps += 1

    def _ended(
        self, arrived: float, share: float, way: float, *, all_arrived: bool
    ) -> Outcome:
        """Return the outcome: the share, or 1 + the share of the steps not needed."""
        steps = self.settings.steps
        fitness = 1.0 + (steps - self._steps) / steps if all_arrived else share
        return Outcome([fitness], [arrived, way, self._steps * self.settings.step_s])

    def _turn(self) -> Turn:
        robots = self.settings.robots
        reach = self.settings.range
        world = self._world
        observations = np.empty((robots, self.inputs), np.float32)
        sectors(world.ranges, np.float32(reach), observations)
        bearings(
            world.poses,
            world.headings,
            world.things,
            self._gone,
            reach,
            SECTORS,
            self.towards,
            observations,
            self._distances,
            self._nearest,
        )
        return Turn(range(robots), observations)
