"""What both games of minisim have in common: the settings' places in ``rules``, distances, steps."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from zswarm.jit import inline

OUTPUTS = 2
BACK, FORTH = np.float32(0.25), np.float32(0.75)  # an output below the first steps back, above the second forth
ZERO, ONE = np.float32(0), np.float32(1)
NOBODY = -1
STEPS, WIDTH, HEIGHT, ROBOTS, DEFENDERS, ROBOT_SIGHT, DEFENDER_SIGHT, REACH, REST = range(9)  # ``rules``: the settings


class Game(NamedTuple):
    """The functions of a game; all take its state, a table after another, and then ``rules``."""

    inputs: int
    tables: Callable[[int, int], tuple[np.ndarray, ...]]  # of robots and defenders: the state, for ``start`` to fill
    start: Callable[..., Any]
    observe: Callable[..., Any]
    act: Callable[..., Any]
    judge: Callable[..., Any]
    play_trials: Callable[..., Any]


@inline
def distance(dx, dy):  # type: ignore[no-untyped-def]  # compiled
    """King moves."""
    return max(abs(dx), abs(dy))


@inline
def velocity(output):  # type: ignore[no-untyped-def]  # compiled
    """-1, 0 or 1; NaN means no move."""
    return int(output > FORTH) - int(output < BACK)


@inline
def move(robots, actions, rules):  # type: ignore[no-untyped-def]  # compiled
    """Move all robots by one cell at most; their first two columns are x and y."""
    for robot in range(robots.shape[0]):
        robots[robot, 0] = min(max(robots[robot, 0] + velocity(actions[robot, 0]), 0), rules[WIDTH] - 1)
        robots[robot, 1] = min(max(robots[robot, 1] + velocity(actions[robot, 1]), 0), rules[HEIGHT] - 1)


@inline
def arrow(dx, dy, away, sight, observation, at, stride):  # type: ignore[no-untyped-def]  # compiled
    """Write where something is, if nearer than ``sight``; the nearer, the longer the arrow."""
    nearness = np.float32(sight - away) / np.float32(sight)
    observation[at * stride] = np.float32(dx) / np.float32(max(away, 1)) * nearness
    observation[(at + 1) * stride] = np.float32(dy) / np.float32(max(away, 1)) * nearness


@inline
def bearing(dx, dy, rules, observation, at, stride):  # type: ignore[no-untyped-def]  # compiled
    """Write where something is that is always known: its direction, and how near it is."""
    away = distance(dx, dy)
    observation[at * stride] = np.float32(dx) / np.float32(max(away, 1))
    observation[(at + 1) * stride] = np.float32(dy) / np.float32(max(away, 1))
    observation[(at + 2) * stride] = ONE - np.float32(away) / np.float32(max(rules[WIDTH], rules[HEIGHT]))
