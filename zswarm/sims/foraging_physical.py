"""Robots push or carry pucks into a nest; the world stands in ``robot_world``."""

from typing import Annotated, Literal

import numpy as np
from msgspec import Meta

from zswarm.draws import Stream
from zswarm.errors import ConfigError
from zswarm.sims.robot_world import (
    SCAN,
    SECTORS,
    Area,
    Metres,
    RobotSettings,
    RobotWorld,
    Thing,
    bearings,
    require_room,
    sectors,
    shrunk,
    strew,
)
from zswarm.sims.simulator import Frame, Outcome, Place, Simulator, Turn

FROM_WALLS = 0.3  # m at least, between a puck's rim and a wall at the start: room for a robot behind it
NEAR = 0.02  # m between a robot and a puck that it can take
FREE, HELD, DELIVERED = range(3)
BEFORE = 0.8  # of a unit vector's length: a puck is before a robot


class Settings(RobotSettings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of ``[problem.settings]``."""

    steps: Annotated[int, Meta(ge=1, le=1_000_000, description="steps of a trial")] = 200
    robots: Annotated[int, Meta(ge=1, le=200, description="robots")] = 5
    side: Annotated[Metres, Meta(description="m, of the square room")] = 4.0
    nest: Annotated[Metres, Meta(description="m, how wide the nest along the left wall is")] = 0.8
    pucks: Annotated[int, Meta(ge=1, le=200, description="pucks")] = 6
    puck: Annotated[Metres, Meta(description="m, radius of a puck")] = 0.1
    puck_mass: Annotated[float, Meta(ge=1e-3, le=1e4, description="kg, of a puck")] = 0.5
    puck_grip: Annotated[float, Meta(ge=0, le=10, description="coefficient of friction of a puck with the ground")] = 0.4
    transport: Annotated[
        Literal["push", "carry"],
        Meta(description="push: robots push pucks; carry: who touches a puck with its front holds it until it is in the nest"),
    ] = "push"


class ForagingPhysical(Simulator):
    """Robots bring pucks into a nest by pushing or by holding them, and are in each other's way.

    The room is square, x to the right and y up from the lower left corner, in m, angles in radians, counter-clockwise; the nest
    is along the left wall. Robots are discs with a mass; their wheels drive and brake with ``force`` at most. Pucks are smaller
    discs, which friction with the ground holds with 9.81 ``puck_mass`` ``puck_grip``, 2 N; pymunk does the contacts.

    Observation: (13,) float32. 0-7: how near a wall or a robot is in each eighth of the laser's view, which goes over pucks, from
        the right to the left: 1 - shortest range / ``range``. 8-9: direction of the nearest puck that lies outside the nest and
        is not held, a unit vector: ahead, to the left; 10: how near it is: 1 - distance / ``range``; zeros where none is so near.
        11-12: the direction of the left wall, ahead and to the left. With transport = "carry" 13: 1 for who holds a puck, else 0.
    Action: (2,) float32 drive, turn: ``speed`` (2 drive - 1) m/s ahead and ``turn`` (2 turn - 1) rad/s to the left, each cut to
        0..1.
    Turns: all robots at once, every ``step_s``. Then a puck whose centre is in the nest is delivered and taken out of the room.
        With transport = "carry" a robot that holds none then takes the nearest puck, if that is within .02 m of it and before it:
        the puck stays at its front until it is delivered.
    Start: pucks outside the nest, .3 m from walls, and robots anywhere beside them, at rest, from the trial's seed.
    End: after ``steps`` steps, or when all pucks are delivered.
    Fitness: the mean over pucks of the share of the way to the nest that each was brought, 1 for those delivered, below 0 for
        those that were taken away from it; when all are delivered, 1 + the share of the steps not needed.
    Metrics: ``delivered``: pucks; ``way``: the mean share; ``seconds``: until all were delivered, or the end.
    """

    settings_type = Settings
    metrics = ("delivered", "way", "seconds")
    actuators = ("drive", "turn")
    outputs = len(actuators)
    settings: Settings

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings)
        side, inset = settings.side, settings.puck + FROM_WALLS
        room: Area = (0.0, 0.0, side, side)
        self._area = shrunk(room, settings.radius)
        self._pucks_area: Area = (settings.nest + inset, inset, side - inset, side - inset)
        if settings.nest < 2 * settings.puck:
            raise ConfigError(
                f"foraging-physical: a puck of radius {settings.puck:g} does not fit in a nest {settings.nest:g} wide"
            )
        require_room("foraging-physical", "pucks", settings.pucks, settings.puck, self._pucks_area)
        covered = settings.pucks * settings.puck * settings.puck / settings.radius / settings.radius  # counted in robots
        robots = settings.robots + int(covered) + 1
        require_room("foraging-physical", "robots beside the pucks", robots, settings.radius, self._area)
        self.owners = (0,) * settings.robots
        self._carry = settings.transport == "carry"
        self.sensors = (
            *(*SCAN, "puck_ahead", "puck_left", "puck_near", "nest_ahead", "nest_left"),
            *(("carries",) if self._carry else ()),
        )
        self.inputs = len(self.sensors)
        puck = Thing("puck", settings.puck, settings.puck_mass, settings.puck_grip, is_box=False)
        self._world = RobotWorld(settings, room, [], [puck] * settings.pucks)
        self._agents = np.arange(settings.robots)
        self._distances, self._nearest = np.zeros(settings.robots), np.zeros(settings.robots, np.int64)
        self._gone = np.zeros(settings.pucks, np.int64)
        self._holds = np.full(settings.robots, -1, np.int64)  # which puck

    def reset(self, seed: int) -> Turn:
        """Strew pucks and robots."""
        stream, settings = Stream(seed), self.settings
        pucks = strew(stream, settings.pucks, settings.puck, self._pucks_area)
        taken = [(x, y, settings.puck) for x, y, _ in pucks]
        robots = strew(stream, settings.robots, settings.radius, self._area, taken)
        self._world.start(np.array(robots), np.array(pucks))
        self._from, self._steps = self._world.things[:, 0].copy(), 0
        self._gone[:], self._holds[:] = FREE, -1
        return self._turn()

    def step(self, actions: np.ndarray) -> Turn | None:
        """Drive; then pucks are delivered."""
        self._world.obey(actions, self._agents)
        self._steps += 1
        for puck, (x, gone) in enumerate(zip(self._world.things[:, 0].tolist(), self._gone.tolist(), strict=True)):
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
        """Fitness and metrics of the trial that ended."""
        share = (self._from - self._world.things[:, 0]) / (self._from - self.settings.nest)
        way = sum(np.where(self._gone == DELIVERED, 1.0, share).tolist()) / self.settings.pucks
        unused = (self.settings.steps - self._steps) / self.settings.steps
        delivered = self._count()
        fitness = 1.0 + unused if delivered == self.settings.pucks else way
        return Outcome([fitness], [delivered, way, self._steps * self.settings.step_s])

    def frame(self) -> Frame:
        """The room with the nest, robots and pucks; those delivered are shown where they came in."""
        robots = ["robot" if puck < 0 else "robot with a puck" for puck in self._holds.tolist()]
        pucks = ["puck in the nest" if delivered else "puck" for delivered in (self._gone == DELIVERED).tolist()]
        return self._world.frame([Place("nest", 0.0, 0.0, self.settings.nest, self.settings.side)], robots, pucks)

    def _count(self) -> int:
        """Pucks that were delivered."""
        return self._gone.tolist().count(DELIVERED)

    def _take(self, observations: np.ndarray) -> bool:
        """Who has a puck at its front holds it from now on; whether anybody took one."""
        touching = self._distances < self.settings.radius + self.settings.puck + NEAR
        takes = np.flatnonzero(touching & (self._holds < 0) & (observations[:, SECTORS] > BEFORE)).tolist()
        for robot in takes:
            puck = int(self._nearest[robot])
            if self._gone[puck] == FREE:  # else one before took it in this step
                self._world.hold(robot, puck)
                self._holds[robot], self._gone[puck] = puck, HELD
        return bool(takes)

    def _turn(self) -> Turn:
        robots, reach, world = self.settings.robots, self.settings.range, self._world
        observations = np.empty((robots, self.inputs), np.float32)
        sectors(world.ranges, np.float32(reach), observations)
        bearings(
            world.poses, world.headings, world.things, self._gone, reach, SECTORS, observations, self._distances, self._nearest
        )  # fmt: skip
        observations[:, SECTORS + 3], observations[:, SECTORS + 4] = -world.headings[:, 0], world.headings[:, 1]
        if self._carry:
            observations[:, SECTORS + 5] = self._holds >= 0
        return Turn(range(robots), observations)
