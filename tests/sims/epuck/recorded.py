"""Numbers recorded from ARGoS3 with the e-puck plug-in, and worlds to compare with them."""

import json
import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from tests.repository import REPOSITORY
from zswarm.sims.epuck import physics
from zswarm.sims.epuck.simulator import Epuck, EpuckSettings
from zswarm.sims.epuck.world import (
    ANGLE,
    CENTRE_X,
    LEFT,
    RIGHT,
    WALL_COLUMNS,
    EpuckWorld,
    X,
    Y,
)

FOLDER = REPOSITORY / "tests" / "golden" / "epuck"
METRES = float(np.float32(0.01))  # in a centimetre
WALL = (0.5, 0.0, 1.0, 0.0, 0.005, 0.33, 0.08)  # of the cases with a single wall
COLLISIONS: dict[str, Any] = json.loads((FOLDER / "collisions.json").read_text())


class Row(NamedTuple):
    """A line of a file: its case, the parts of its name, step, robot and numbers."""

    case: str
    parts: list[str]
    step: int
    robot: int
    numbers: list[float]


def rows(name: str) -> Iterator[Row]:
    """Yield the lines of a file."""
    for line in (FOLDER / f"{name}.csv").read_text().splitlines():
        if line.startswith("#"):
            continue
        case, step, robot, *numbers = line.split(",")
        yield Row(
            case,
            case.split("_"),
            int(step),
            int(robot.removeprefix("epuck")),
            list(map(float, numbers)),
        )


def world(
    robots: int = 1,
    mission: Any = "aggregation",
    walls: list[tuple[float, ...]] | None = None,
) -> EpuckWorld:
    """Return a world without noise; ``walls`` replace the arena's, and may hide things."""
    settings = EpuckSettings(mission=mission, robots=robots, reality="exact")
    made = Epuck(settings).world
    if walls is not None:
        boxes = np.array(walls, np.float64).reshape(-1, WALL_COLUMNS)
        assert boxes[:, CENTRE_X].size == len(walls) < len(made.walls)
        made = made._replace(walls=boxes, outer_walls=0)
    made.impulses[:] = -1_000.0
    return made


def place(made: EpuckWorld, robot: int, x: float, y: float, angle: float) -> None:
    """Put a robot somewhere."""
    made.robots[[X, Y, ANGLE], robot] = x, y, angle
    physics.turn(made)


def command(made: EpuckWorld, robot: int, left: float, right: float) -> None:
    """Command the wheels of a robot, in cm/s."""
    made.robots[[LEFT, RIGHT], robot] = left * METRES, right * METRES


def error(made: EpuckWorld, row: Row) -> float:
    """Return how far a robot's pose is from the recorded one, in m and radians."""
    x, y, angle = made.robots[[X, Y, ANGLE], row.robot].tolist()
    turned = (angle - row.numbers[2] + math.pi) % (2 * math.pi) - math.pi
    return max(abs(x - row.numbers[0]), abs(y - row.numbers[1]), abs(turned))
