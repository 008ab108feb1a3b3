"""Simulate robots on two wheels in a square room, for the classic tasks of swarm robotics.

``arena_world`` computes the world, ``arena_tasks`` the tasks.
"""

from typing import Annotated, Literal

import numpy as np
from msgspec import Meta

from zswarm.config.meta import PartSettings, about, above, only_with, within
from zswarm.errors import ConfigError
from zswarm.kernels.lanes import LANES
from zswarm.kernels.portable import PI, atan2
from zswarm.sims import arena_tasks
from zswarm.sims.arena_tasks import TASKS
from zswarm.sims.arena_world import (
    CARRIES,
    HEADING_X,
    HEADING_Y,
    PLACE_ROWS,
    QUEUE_ROWS,
    ROBOT_ROWS,
    SAID,
    TALLIES,
    TRUTH,
    ArenaWorld,
    X,
    Y,
    cells_per_side,
)
from zswarm.sims.simulator import Body, Frame, Label, Ray, Rectangle, Steps
from zswarm.sims.trial import Teams, play_many, problem

ITEM_RADIUS = 0.05  # m, in pictures
ABOUT = 0.1  # of the truth: an opinion within this range counts as right

Metres = Annotated[float, Meta(ge=1e-3, le=1e4)]

FORAGING = only_with(task="foraging")


class ArenaSettings(PartSettings, frozen=True):
    """Settings of ``[problem.settings]``."""

    task: Annotated[
        Literal["aggregation", "dispersion", "foraging", "consensus"],
        about("task of the robots"),
    ] = "aggregation"
    steps: Steps = 500
    step_s: Annotated[float, above(0, 10, "s, duration of a step")] = 0.1
    robots: Annotated[int, within(1, 1_000, "robots")] = 16
    side: Annotated[Metres, about("m, side of the square room")] = 4.0
    sight: Annotated[Metres, about("m, sensing range for others, walls and items")] = 1.2
    radius: Annotated[
        Metres, about("m, radius of a robot; its wheels are 2 `radius` apart")
    ] = 0.1
    speed: Annotated[float, within(0, 1e3, "m/s, maximum of a wheel")] = 0.3
    items: Annotated[int, within(1, 1_000, "items in the room (foraging)"), FORAGING] = 8
    nest: Annotated[
        Metres, about("m, width of the nest along the left wall (foraging)"), FORAGING
    ] = 0.5
    noise: Annotated[
        float,
        within(0, 1e3, "maximum error of a reading (consensus)"),
        only_with(task="consensus"),
    ] = 0.5


class Arena(Teams):
    """Simulate round robots in a square room; the setting ``task`` chooses their task.

    Lengths are in m, x to the right, y downwards. Numbers are float32 and each operation is rounded
    to it, unless float64 is mentioned. "Operations of arena" in docs/simulators.md has the formulas
    and their order. (h, k) is a robot's heading, a unit vector. cut(o) is o limited to 0..1 (NaN:
    0), r is ``radius``. Neighbours of a robot have their centre nearer than ``sight``.

    Observation: 0-7: 1 - d / ``sight``, d the reach of rays from the centre at 0, 45, ... degrees
        from the heading, to a wall or a neighbour, at most ``sight``. 8-9: mean offset of the
        neighbours in the robot's frame / ``sight``; zeros without any.
        foraging: 10-11: offset of the nearest item in sight (the first of equals) in the frame /
        max(its distance, r), zeros without any; 12-13: the direction of the nest, (-h, k); 14: 1 if
        it carries an item, else 0.
        consensus: 10: its reading; 11: the mean of what its neighbours said in the previous step;
        without neighbours, what it said itself.
    Action: 0-1: left and right wheel, each 2 cut(o) - 1 of ``speed``. consensus: 2: it says cut(o).
    Turns: all robots at once, seeing the state before the step. A step (they count from 1):
        1. If 2 step > ``steps``, measure the state that was observed for the fitness.
        2. Robots turn, drive, are pushed apart where they overlapped, and stay r away from walls.
        3. foraging, robot after robot: in the nest (x < ``nest``) one that carries delivers; one
        that does not and has an item nearer than r finds it (the first), and another appears as at
        the start. consensus: they say what they say.
    Start: from ``Stream(seed)`` of zswarm.kernels.random: per robot place and heading; consensus:
        the truth and readings that differ from it by at most ``noise``; foraging: places of items
        outside the nest.
    End: after ``steps`` steps.
    Fitness (float64 but for means over robots; other means are over the measured steps):
        aggregation: 1 - spread / (.3826 ``side``): 0 for many placed uniformly, 1 in one point.
        spread: mean distance to the mean place. dispersion: nearest / ``sight``. nearest: mean
        distance to the nearest neighbour, ``sight`` without any.
        foraging: (delivered + found) / 2. consensus: 1 - 4 error: 0 on average if all say .5.
        error: mean distance of what is said from the truth.
    Metrics: those, and aggregation, dispersion: ``neighbours``, their mean number; consensus:
        ``disagreement``, the mean distance of what is said from its mean. All: ``contacts``, the
        mean number of pairs that overlap, over all steps.
    """

    settings_type = ArenaSettings
    settings: ArenaSettings

    def __init__(self, settings: ArenaSettings) -> None:
        super().__init__(settings)
        radius = settings.radius
        side = settings.side
        sight = settings.sight
        nest = settings.nest
        room = side - 2 * radius
        if room <= 0:
            raise ConfigError(
                f"arena: a robot of radius {radius:g} does not fit in a room of side {side:g}"
            )
        if sight < 2 * radius:
            text = f"sight {sight:g} must be at least 2 radius, {2 * radius:g}"
            raise ConfigError(f"arena: {text}: robots that touch see each other")
        if settings.task == "foraging" and not radius < nest < side - radius:
            text = f"nest {nest:g} must be between radius {radius:g} and side - radius"
            raise ConfigError(
                f"arena: {text}, {side - radius:g}: robots come in, and items lie outside"
            )
        task = TASKS[settings.task]
        rays = (f"ray_{45 * ray}" for ray in range(8))
        self.sensors = (*rays, "others_ahead", "others_aside", *task.sensors)
        self.actuators = ("left", "right", *task.actuators)
        self.inputs = len(self.sensors)
        self.outputs = len(self.actuators)
        self.metrics = task.metrics
        self.owners = (0,) * settings.robots
        per_side = cells_per_side(side, sight, settings.robots)
        half_stride = settings.speed * settings.step_s / 2
        columns = settings.robots + LANES
        self.world = ArenaWorld(
            task=list(TASKS).index(settings.task),
            steps=settings.steps,
            number=settings.robots,
            per_side=per_side,
            side=np.float32(side),
            sight=np.float32(sight),
            radius=np.float32(radius),
            half_stride=np.float32(half_stride),
            half_turn=np.float32(half_stride / (2 * radius)),
            cells_per_metre=np.float32(per_side / side),
            nest=np.float32(nest),
            noise=np.float32(settings.noise),
            robots=np.zeros((ROBOT_ROWS, columns), np.float32),
            queue=np.zeros((QUEUE_ROWS, columns), np.float32),
            places=np.zeros((PLACE_ROWS, columns), np.int32),
            cells=np.zeros(per_side**2 + 2, np.int32),
            items=np.zeros(
                (2, settings.items if settings.task == "foraging" else 0), np.float32
            ),
            tally=np.zeros(TALLIES),
            stream=np.zeros(1, np.uint64),
        )

    def frame(self) -> Frame:
        """Return the room; the kinds of robots show who carries an item and who estimates well."""
        s = self.settings
        robots = self.world.robots[:, : s.robots].tolist()
        items = self.world.items.tolist()
        headings = [
            float(atan2(y, x))
            for x, y in zip(robots[HEADING_X], robots[HEADING_Y], strict=True)
        ]
        places = []
        labels = []
        kinds = [
            "robot with an item" if carries else "robot" for carries in robots[CARRIES]
        ]
        if s.task == "foraging":
            places = [Rectangle("nest", 0, 0, s.nest, s.side)]
        elif s.task == "consensus":
            truth = float(self.world.tally[TRUTH])
            kinds = [_says(said - truth) for said in robots[SAID]]
            labels = [
                Label(
                    f"the truth is {truth:.2f}", s.side / 2, 0.05 * s.side, 0.04 * s.side
                )
            ]
        bodies = [
            Body(kind, x, y, s.radius, heading)
            for kind, x, y, heading in zip(
                kinds, robots[X], robots[Y], headings, strict=True
            )
        ]
        bodies += [
            Body("item", x, y, ITEM_RADIUS, shape="square")
            for x, y in zip(items[X], items[Y], strict=True)
        ]
        rays = [Ray(number, number * PI / 4, s.sight, 0.0) for number in range(8)]
        return Frame(s.side, s.side, places, bodies, labels=labels, rays=rays)


def _says(off: float) -> str:
    """Return the name of a robot by the error of its estimate, for pictures."""
    if abs(off) <= ABOUT:
        return "robot, says it about right"
    return "robot, says too much" if off > 0 else "robot, says too little"


Arena.problem = problem(
    "play_arena",
    arena_tasks.start,
    arena_tasks.observe,
    arena_tasks.act,
    arena_tasks.is_over,
    arena_tasks.judge,
    world=ArenaWorld,
    loop=play_many,
)
