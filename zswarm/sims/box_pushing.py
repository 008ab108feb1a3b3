"""Robots push a box that is too heavy for one of them; the world stands in ``robot_world``."""

from typing import Annotated

import numpy as np
from msgspec import Meta

from zswarm.draws import Stream
from zswarm.errors import ConfigError
from zswarm.portable import PI
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

DIAGONAL = 1.4142135623730951


class Settings(RobotSettings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of ``[problem.settings]``."""

    steps: Annotated[int, Meta(ge=1, le=1_000_000, description="steps of a trial")] = 150
    robots: Annotated[int, Meta(ge=1, le=200, description="robots")] = 6
    side: Annotated[Metres, Meta(description="m, of the square room")] = 5.0
    goal: Annotated[Metres, Meta(description="m, how wide the goal along the right wall is")] = 1.0
    box: Annotated[Metres, Meta(description="m, side of the box")] = 0.6
    box_mass: Annotated[float, Meta(ge=1e-3, le=1e5, description="kg, of the box")] = 10.0
    box_grip: Annotated[
        float,
        Meta(ge=0, le=10, description="coefficient of friction of the box with the ground: it moves from 9.81 mass grip N on"),
    ] = 0.25


class BoxPushing(Simulator):
    """Robots push a box into a goal together; the box is too heavy for one of them.

    The room is square, x to the right and y up from the lower left corner, in m, angles in radians, counter-clockwise. Robots are
    discs with a mass; their wheels drive and brake with ``force`` at most, 15 N. Friction with the ground holds the box with 9.81
    ``box_mass`` ``box_grip``, 24.5 N, and a turn of it likewise; pymunk does the contacts.

    Observation: (13,) float32. 0-7: how near something is in each eighth of the laser's view, from the right to the left: 1 -
        shortest range / ``range``. 8-9: direction of the box's middle, a unit vector: ahead, to the left; 10: how near it is: 1 -
        distance / ``range``; zeros beyond. 11-12: the direction of x, where the goal is, ahead and to the left.
    Action: (2,) float32 drive, turn: ``speed`` (2 drive - 1) m/s ahead and ``turn`` (2 turn - 1) rad/s to the left, each cut to
        0..1.
    Turns: all robots at once, every ``step_s``.
    Start: from the trial's seed: the box's middle between .3 and .45 of the way to the right and in the middle half of the other,
        at any angle; robots anywhere beside it, at rest.
    End: after ``steps`` steps, or when the middle of the box is in the goal, ``goal`` from the right wall.
    Fitness: the share of the way to the goal that the box was pushed, below 0 where it was pushed away; when it is there, 1 + the
        share of the steps not needed.
    Metrics: ``reached``: 1 or 0; ``way``: m that the box came nearer; ``seconds``: until it was there, or the end.
    """

    settings_type = Settings
    metrics = ("reached", "way", "seconds")
    sensors = (*SCAN, "box_ahead", "box_left", "box_near", "goal_ahead", "goal_left")
    actuators = ("drive", "turn")
    inputs, outputs = len(sensors), len(actuators)
    settings: Settings

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings)
        side, half = settings.side, settings.box / 2
        room: Area = (0.0, 0.0, side, side)
        self._area = shrunk(room, settings.radius)
        self._box_area: Area = (0.3 * side, 0.25 * side, 0.45 * side, 0.75 * side)
        if half * DIAGONAL > 0.25 * side:
            raise ConfigError(f"box-pushing: a box of side {settings.box:g} does not turn freely in a room of side {side:g}")
        if not half < settings.goal < 0.55 * side:
            raise ConfigError(
                f"box-pushing: goal {settings.goal:g} must be between half of the box and .55 side, {half:g} and "
                f"{0.55 * side:g}: the box gets there, and starts outside"
            )
        covered = DIAGONAL * DIAGONAL * half * half / settings.radius / settings.radius  # by the box, counted in robots
        require_room("box-pushing", "robots beside the box", settings.robots + int(covered) + 1, settings.radius, self._area)
        self.owners = (0,) * settings.robots
        box = Thing("box", half, settings.box_mass, settings.box_grip, is_box=True)
        self._world = RobotWorld(settings, room, [], [box])
        self._goal = side - settings.goal
        self._agents, self._none_gone = np.arange(settings.robots), np.zeros(1, np.int64)
        self._distances, self._nearest = np.zeros(settings.robots), np.zeros(settings.robots, np.int64)

    def reset(self, seed: int) -> Turn:
        """Put the box somewhere on the left, and the robots around it."""
        stream, settings = Stream(seed), self.settings
        left, low, right, high = self._box_area
        x, y = float(stream.uniform(left, right, 1)[0]), float(stream.uniform(low, high, 1)[0])
        angle = float(stream.uniform(-PI, PI, 1)[0])
        places = strew(stream, settings.robots, settings.radius, self._area, [(x, y, settings.box / 2 * DIAGONAL)])
        self._world.start(np.array(places), np.array([(x, y, angle)]))
        self._from, self._steps = x, 0
        return self._turn()

    def step(self, actions: np.ndarray) -> Turn | None:
        """Drive and push."""
        self._world.obey(actions, self._agents)
        self._steps += 1
        return None if self._reached() or self._steps == self.settings.steps else self._turn()

    def outcome(self) -> Outcome:
        """Fitness and metrics of the trial that ended."""
        way = float(self._world.things[0, 0]) - self._from
        reached = self._reached()
        unused = (self.settings.steps - self._steps) / self.settings.steps
        fitness = 1.0 + unused if reached else way / (self._goal - self._from)
        return Outcome([fitness], [float(reached), way, self._steps * self.settings.step_s])

    def frame(self) -> Frame:
        """The room with the goal, the robots and the box."""
        side, goal = self.settings.side, self.settings.goal
        return self._world.frame([Place("goal", side - goal, 0.0, goal, side)], ["robot"] * self.settings.robots, ["box"])

    def _reached(self) -> bool:
        return bool(self._world.things[0, 0] >= self._goal)

    def _turn(self) -> Turn:
        robots, reach, world = self.settings.robots, self.settings.range, self._world
        observations = np.empty((robots, self.inputs), np.float32)
        sectors(world.ranges, np.float32(reach), observations)
        bearings(
            world.poses, world.headings, world.things, self._none_gone, reach, SECTORS, observations, self._distances,
            self._nearest,
        )  # fmt: skip
        observations[:, SECTORS + 3], observations[:, SECTORS + 4] = world.headings[:, 0], -world.headings[:, 1]
        return Turn(range(robots), observations)
