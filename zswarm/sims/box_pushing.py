"""Robots push a box that is too heavy for one of them."""

from typing import Annotated

import numpy as np

from zswarm.config.meta import about, within
from zswarm.errors import ConfigError
from zswarm.kernels.portable import PI
from zswarm.kernels.random import Stream
from zswarm.sims.physics import Metres, Movable, Robots
from zswarm.sims.physics_kernels import SCAN
from zswarm.sims.physics_picture import picture
from zswarm.sims.placing import Area
from zswarm.sims.simulator import Frame, Outcome, Rectangle, Steps, Turn
from zswarm.sims.transport import Transport, TransportSettings

DIAGONAL = 1.4142135623730951


class BoxPushingSettings(TransportSettings, frozen=True):
    """Settings of ``[problem.settings]``."""

    steps: Steps = 150
    robots: Robots = 6
    goal: Annotated[Metres, about("m, width of the goal along the right wall")] = 1.0
    box: Annotated[Metres, about("m, side of the box")] = 0.6
    box_mass: Annotated[float, within(1e-3, 1e5, "kg, mass of the box")] = 10.0
    box_grip: Annotated[
        float,
        within(
            0,
            10,
            "coefficient of friction between box and ground: a force of 9.81 mass grip N moves it",
        ),
    ] = 0.25


class BoxPushing(Transport):
    """Robots push a box into a goal together; the box is too heavy for one of them.

    The room is square, x to the right and y up from the lower left corner, in m, angles in radians,
    counter-clockwise. Robots are discs with a mass; their wheels drive and brake with ``force`` at
    most, 15 N. Friction with the ground holds the box with 9.81 ``box_mass`` ``box_grip``, 24.5 N,
    and a turn of it likewise; pymunk does the contacts.

    Observation: (13,) float32. 0-7: how near something is in each eighth of the laser's view, from
        the right to the left: 1 - shortest range / ``range``. 8-9: direction of the box's middle, a
        unit vector: ahead, to the left; 10: how near it is: 1 - distance / ``range``; zeros beyond.
        11-12: the direction of x, where the goal is, ahead and to the left.
    Action: (2,) float32 drive, turn: ``speed`` (2 drive - 1) m/s ahead and ``turn`` (2 turn - 1)
        rad/s to the left, each cut to 0..1.
    Turns: all robots at once, every ``step_s``.
    Start: from the trial's seed: the box's middle between .3 and .45 of the way to the right and in
        the middle half of the other, at any angle; robots anywhere beside it, at rest.
    End: after ``steps`` steps, or when the middle of the box is in the goal, ``goal`` from the
    right wall.
    Fitness: the share of the way to the goal that the box was pushed, below 0 where it was pushed
        away; when it is there, 1 + the share of the steps not needed.
    Metrics: ``reached``: 1 or 0; ``way``: m that the box came nearer; ``seconds``: until it was
    there, or the end.
    """

    settings_type = BoxPushingSettings
    name = "box-pushing"
    towards = np.array([1.0, -1.0])
    metrics = ("reached", "way", "seconds")
    sensors = (*SCAN, "box_ahead", "box_left", "box_near", "goal_ahead", "goal_left")
    inputs = len(sensors)
    settings: BoxPushingSettings

    def __init__(self, settings: BoxPushingSettings) -> None:
        side = settings.side
        half = settings.box / 2
        self._box_area: Area = (0.3 * side, 0.25 * side, 0.45 * side, 0.75 * side)
        if half * DIAGONAL > 0.25 * side:
            raise ConfigError(
                f"box-pushing: a box of side {settings.box:g} does not turn freely in a room of "
                f"side {side:g}"
            )
        if not half < settings.goal < 0.55 * side:
            raise ConfigError(
                f"box-pushing: goal {settings.goal:g} must be between half of the box and .55 "
                f"side, {half:g} and {0.55 * side:g}: the box gets there, and starts outside"
            )
        covered = DIAGONAL * DIAGONAL * half * half / settings.radius / settings.radius
        box = Movable("box", half, settings.box_mass, settings.box_grip, is_box=True)
        super().__init__(settings, [box], "box", covered)
        self._goal = side - settings.goal

    def reset(self, seed: int) -> Turn:
        """Put the box somewhere on the left, and the robots around it."""
        stream = Stream(seed)
        left, low, right, high = self._box_area
        x = float(stream.uniform(left, right, 1)[0])
        y = float(stream.uniform(low, high, 1)[0])
        angle = float(stream.uniform(-PI, PI, 1)[0])
        return self._start(stream, [(x, y, angle)], self.settings.box / 2 * DIAGONAL)

    def step(self, actions: np.ndarray) -> Turn | None:
        """Drive and push."""
        self._step(actions)
        return (
            None
            if self._reached() or self._steps == self.settings.steps
            else self._turn()
        )

    def outcome(self) -> Outcome:
        """Return fitness and metrics of the trial that ended."""
        start = float(self._from[0])
        reached = self._reached()
        way = float(self._world.things[0, 0]) - start
        return self._ended(
            float(reached), way / (self._goal - start), way, all_arrived=reached
        )

    def frame(self) -> Frame:
        """Return the room with the goal, the robots and the box."""
        side = self.settings.side
        goal = self.settings.goal
        places = [Rectangle("goal", side - goal, 0.0, goal, side)]
        return picture(self._world, places, ["robot"] * self.settings.robots, ["box"])

    def _reached(self) -> bool:
        return bool(self._world.things[0, 0] >= self._goal)
