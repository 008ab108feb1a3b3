"""Draw a mission from the published distribution of missions.

Source: configurationParametersMG1 of MissionGeneratorMG1, of the demiurge project. docs/epuck.md
has the distribution.
"""

from collections.abc import Sequence
from typing import TypeVar

from zswarm.kernels.portable import PI
from zswarm.kernels.random import Stream, derive_seed
from zswarm.sims.epuck.arenas import (
    HEXAGON,
    IN_RADIUS,
    OFF_SPOTS,
    SQUARE,
    TRIANGLE,
    Shape,
    Spot,
    disc,
)
from zswarm.sims.epuck.missions import Mission
from zswarm.sims.epuck.world import BLACK, WHITE

T = TypeVar("T")

HEARING = 0.5  # m
INTENSITY = 5.0
OBSTACLES = {
    "homing": (0.2, 0.4, 0.3, 0.1),
    "one-spot": (0.4, 0.3, 0.2, 0.1),
    "deliveries": (0.2, 0.4, 0.3, 0.1),
}
LIT = {"homing": 0.3, "one-spot": 0.3, "deliveries": 0.85}


class _Draws:
    """Draws from one stream."""

    def __init__(self, seed: int) -> None:
        self._stream = Stream(derive_seed(seed, "epuck mission"))

    def weighted(self, choices: Sequence[T], weights: Sequence[float]) -> T:
        """Return a choice by its weight."""
        left = float(self._stream.uniform(0.0, 1.0, 1)[0])
        for choice, weight in zip(choices, weights, strict=True):
            if left < weight:
                return choice
            left -= weight
        return choices[-1]

    def one(self, choices: Sequence[T]) -> T:
        """Return any of the choices."""
        return choices[self._stream.integer(len(choices))]

    def some(self, choices: Sequence[T], count: int) -> list[T]:
        """Return so many different choices."""
        rest = list(choices)
        return [rest.pop(self._stream.integer(len(rest))) for _ in range(count)]

    def apart(self, taken: list[Spot], choices: Sequence[Spot], count: int) -> None:
        """Add so many spots that overlap none that are taken."""
        for _ in range(count):
            free = [
                spot for spot in choices if not any(_overlap(spot, one) for one in taken)
            ]
            if not free:
                return
            taken.append(self.one(free))


def mission(seed: int) -> Mission:
    """Return the mission of a seed."""
    draws = _Draws(seed)
    score = draws.weighted(("deliveries", "homing", "one-spot"), (0.2, 0.4, 0.4))
    seconds = draws.weighted((60.0, 120.0, 180.0), (0.25, 0.375, 0.375))
    robots = draws.one((15, 20))
    shape = draws.one((TRIANGLE, SQUARE, HEXAGON))
    start = draws.one(("anywhere", "off spots", "one side"))
    at_end = score != "deliveries" and draws.one((False, True))
    lit = draws.weighted((True, False), (LIT[score], 1.0 - LIT[score]))
    first, second = draws.one(((BLACK, WHITE), (WHITE, BLACK)))
    obstacles = draws.weighted((0, 1, 2, 3), OBSTACLES[score])
    sector = (0.0, 2.0 * PI)
    if start == "one side":
        begin = shape.first_half + draws.one((0.0, PI))
        sector = (begin, begin + PI)
    spots, others = _spots(draws, score, shape)
    floor = [disc(*spot, first) for spot in spots] + [
        disc(*spot, second) for spot in others
    ]
    return Mission(
        seconds,
        (*shape.lamp, INTENSITY if lit else 0.0),
        HEARING,
        tuple(floor),
        tuple(draws.some(shape.obstacles, obstacles)),
        robots=robots,
        arena=shape.arena,
        start=OFF_SPOTS if start == "off spots" else IN_RADIUS,
        sector=sector,
        score=score,
        spots=len(spots),
        at_end=at_end,
    )


def _spots(draws: _Draws, score: str, shape: Shape) -> tuple[list[Spot], list[Spot]]:
    """Return homes or nests, and the spots of the other colour."""
    spots: list[Spot] = []
    if score == "deliveries":
        wanted, others = shape.nests, shape.sources
        first = draws.weighted((1, 2), (0.95, 0.05))
        second = draws.weighted((1, 2, 3), (0.5, 0.4, 0.1))
    else:
        wanted, others = shape.homes, (*shape.nests, *shape.sources, *shape.homes)
        if score == "homing":
            first = 1
            second = draws.weighted((0, 1, 2), (0.55, 0.3, 0.15))
        else:
            first = draws.weighted((2, 3), (0.8, 0.2))
            second = draws.weighted((0, 1), (0.6, 0.4)) if first == 2 else 0
    draws.apart(spots, wanted, first)
    homes = len(spots)
    draws.apart(spots, others, second)
    return spots[:homes], spots[homes:]


def _overlap(one: Spot, other: Spot) -> bool:
    dx, dy, apart = one[0] - other[0], one[1] - other[1], one[2] + other[2]
    return dx * dx + dy * dy < apart * apart
