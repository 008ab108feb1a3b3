"""Robots push or carry pucks into a nest."""

from typing import Annotated, Literal

import numpy as np

from zswarm.config.meta import about, within
from zswarm.errors import ConfigError
from zswarm.kernels.random import Stream
from zswarm.kernels.sums import total
from zswarm.sims.physics import Metres, Movable, Robots, Side
from zswarm.sims.physics_kernels import SCAN, SECTORS
from zswarm.sims.physics_picture import picture
from zswarm.sims.placing import Area, require_room, strew
from zswarm.sims.simulator import Frame, Outcome, Rectangle, Steps, Turn
from zswarm.sims.transport import Transport, TransportSettings

# m between a puck's rim and a wall at the start, at least: room for a robot behind it
FROM_WALLS = 0.3
NEAR = 0.02  # m between a robot and a puck that it can take
FREE, HELD, DELIVERED = range(3)
BEFORE = 0.8  # of a unit vector's length: a puck is before a robot


class ForagingPhysicalSettings(TransportSettings, frozen=True):
    """Settings of ``[problem.settings]``."""

    steps: Steps = 200
    robots: Robots = 5
    side: Side = 4.0
    nest: Annotated[Metres, about("m, width of the nest along the left wall")] = 0.8
    pucks: Annotated[int, within(1, 200, "pucks")] = 6
    puck: Annotated[Metres, about("m, radius of a puck")] = 0.1
    puck_mass: Annotated[float, within(1e-3, 1e4, "kg, mass of a puck")] = 0.5
    puck_grip: Annotated[
        float, within(0, 10, "coefficient of friction between a puck and the ground")
    ] = 0.4
    transport: Annotated[
        Literal["push", "carry"],
        about(
            "push: robots push pucks; carry: a robot that touches a puck with its front holds "
            "it until it is in the nest"
        ),
    ] = "push"


class ForagingPhysical(Transport):
    """Robots bring pucks into a nest by pushing or by holding them, and are in each other's way.

    The room is square, x to the right and y up from the lower left corner, in m, angles in radians,
    counter-clockwise; the nest is along the left wall. Robots are discs with a mass; their wheels
    drive and brake with ``force`` at most. Pucks are smaller discs, which friction with the ground
    holds with 9.81 ``puck_mass`` ``puck_grip``, 2 N; pymunk does the contacts.

    Observation: (13,) float32. 0-7: how near a wall or a robot is in each eighth of the laser's
        view, which goes over pucks, from the right to the left: 1 - shortest range / ``range``.
        8-9: direction of the nearest puck that lies outside the nest and is not held, a unit
        vector: ahead, to the left; 10: how near it is: 1 - distance / ``range``; zeros where none
        is so near.
        11-12: the direction of the left wall, ahead and to the left. With transport = "carry" 13: 1
        for who holds a puck, else 0.
    Action: (2,) float32 drive, turn: ``speed`` (2 drive - 1) m/s ahead and ``turn`` (2 turn - 1)
        rad/s to the left, each cut to 0..1.
    Turns: all robots at once, every ``step_s``. Then a puck whose centre is in the nest is
        delivered and taken out of the room. With transport = "carry" a robot that holds none then
        takes the nearest puck, if that is within .02 m of it and before it: the puck stays at its
        front until it is delivered.
    Start: pucks outside the nest, .3 m from walls, and robots anywhere beside them, at rest, from
    the trial's seed.
    End: after ``steps`` steps, or when all pucks are delivered.
    Fitness: the mean over pucks of the share of the way to the nest that each was brought, 1 for
        those delivered, below 0 for those that were taken away from it; when all are delivered, 1 +
        the share of the steps not needed.
    Metrics: ``delivered``: pucks; ``way``: the mean share; ``seconds``: until all were delivered,
    or the end.
    """

    settings_type = ForagingPhysicalSettings
    name = "foraging-physical"
    towards = np.array([-1.0, 1.0])
    metrics = ("delivered", "way", "seconds")
    settings: ForagingPhysicalSettings

    def __init__(self, settings: ForagingPhysicalSettings) -> None:
        number = settings.pucks
        radius = settings.puck
        robot = settings.radius
        inset = radius + FROM_WALLS
        far = settings.side - inset
        self._pucks_area: Area = (settings.nest + inset, inset, far, far)
        if settings.nest < 2 * radius:
            raise ConfigError(
                f"foraging-physical: a puck of radius {radius:g} does not fit in a nest "
                f"{settings.nest:g} wide"
            )
        require_room(self.name, "pucks", number, radius, self._pucks_area)
        puck = Movable(
            "puck", radius, settings.puck_mass, settings.puck_grip, is_box=False
        )
        covered = number * radius * radius / robot / robot
        super().__init__(settings, [puck] * number, "pucks", covered)
        self._carry = settings.transport == "carry"
        carries = ("carries",) if self._carry else ()
        bearings = ("puck_ahead", "puck_left", "puck_near", "nest_ahead", "nest_left")
        self.sensors = (*SCAN, *bearings, *carries)
        self.inputs = len(self.sensors)
        self._holds = np.full(settings.robots, -1, np.int64)  # which puck

    def reset(self, seed: int) -> Turn:
        """Strew pucks and robots."""
        stream = Stream(seed)
        settings = self.settings
        pucks = strew(stream, settings.pucks, settings.puck, self._pucks_area)
        self._holds[:] = -1
        return self._start(stream, pucks, settings.puck)

    def step(self, actions: np.ndarray) -> Turn | None:
        """Drive; then pucks are delivered."""
        self._step(actions)
        for puck, (x, gone) in enumerate(
            zip(self._world.things[:, 0].tolist(), self._gone.tolist(), strict=True)
        ):
            if x < self.settings.nest and gone != DELIVERED:
                for robot in np.flatnonzero(self._holds == puck).tolist():
                    self._world.let_go(robot)
                    self._holds[robot] = -1
                self._world.take_out_thing(puck)
                self._gone[puck] = DELIVERED
        if self._count() == self.settings.pucks or self._steps == self.settings.steps:
            return None
        turn = self._turn()
        return self._turn() if self._carry and self._take(turn.observations) else turn

    def outcome(self) -> Outcome:
        """Return fitness and metrics of the trial that ended."""
        share = (self._from - self._world.things[:, 0]) / (
            self._from - self.settings.nest
        )
        way = float(total(np.where(self._gone == DELIVERED, 1.0, share)))
        way /= self.settings.pucks
        delivered = self._count()
        return self._ended(
            delivered, way, way, all_arrived=delivered == self.settings.pucks
        )

    def frame(self) -> Frame:
        """Return the room with nest, robots and pucks; delivered pucks stay where they came in."""
        nest = Rectangle("nest", 0.0, 0.0, self.settings.nest, self.settings.side)
        robots = [
            "robot" if puck < 0 else "robot with a puck" for puck in self._holds.tolist()
        ]
        pucks = [
            "puck in the nest" if delivered else "puck"
            for delivered in (self._gone == DELIVERED).tolist()
        ]
        return picture(self._world, [nest], robots, pucks)

    def _count(self) -> int:
        """Return how many pucks were delivered."""
        return self._gone.tolist().count(DELIVERED)

    def _take(self, observations: np.ndarray) -> bool:
        """Let robots with a puck at their front hold it; return whether any took one."""
        touching = self._distances < self.settings.radius + self.settings.puck + NEAR
        takes = np.flatnonzero(
            touching & (self._holds < 0) & (observations[:, SECTORS] > BEFORE)
        ).tolist()
        for robot in takes:
            puck = int(self._nearest[robot])
            if self._gone[puck] == FREE:  # else one before took it in this step
                self._world.hold(robot, puck)
                self._holds[robot] = puck
                self._gone[puck] = HELD
        return bool(takes)

    def _turn(self) -> Turn:
        turn = super()._turn()
        if self._carry:
            turn.observations[:, SECTORS + 5] = self._holds >= 0
        return turn
