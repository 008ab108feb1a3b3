"""The tasks of ``arena``: how a trial starts, what robots sense beside walls and neighbours, what happens, what counts."""

import numpy as np

from zswarm.draws import draw_integer
from zswarm.jit import inline, sqrt
from zswarm.sims.arena_world import (
    HALF,
    HEADING_X,
    HEADING_Y,
    HEARD,
    NEAREST,
    NEIGHBOURS,
    ONE,
    RADIUS,
    SAID,
    SIDE,
    SIGHT,
    WORLD_INPUTS,
    WORLD_LENGTHS,
    WORLD_ROWS,
    ZERO,
    X,
    Y,
    at_least,
    cut,
)

TASKS = ("aggregation", "dispersion", "foraging", "consensus")
AGGREGATION, DISPERSION, FORAGING, CONSENSUS = range(4)
TASK_SENSORS: dict[str, tuple[str, ...]] = {
    "aggregation": (),
    "dispersion": (),
    "foraging": ("item_ahead", "item_aside", "nest_ahead", "nest_aside", "carries"),
    "consensus": ("reading", "heard"),
}
TASK_ACTUATORS: dict[str, tuple[str, ...]] = {"aggregation": (), "dispersion": (), "foraging": (), "consensus": ("say",)}
METRICS = {
    "aggregation": ("spread", "neighbours", "contacts"),
    "dispersion": ("nearest", "neighbours", "contacts"),
    "foraging": ("delivered", "found", "contacts"),
    "consensus": ("error", "disagreement", "contacts"),
}

# What a robot has beside the rows of ``arena_world``.
CARRIES, READING = WORLD_ROWS, WORLD_ROWS + 1
ROWS = WORLD_ROWS + 2
# ``lengths`` beside those of ``arena_world``.
NEST, NOISE = WORLD_LENGTHS, WORLD_LENGTHS + 1
# ``tally``: float64, of the trial.
STEP_NUMBER, MEASURED, CONTACTS, FOUND, DELIVERED, TRUTH, FIRST, SECOND = range(8)
TALLIES = 8

DRAW = 1 << 24  # a draw below it is exact in float32
UNIT = np.float32(2.0**-24)
SHORTEST = np.float32(0.01)
MIDDLE = 0.3826  # mean distance of a square's points to its centre, in its sides


@inline(counts=False, inner=True)
def draw(stream, low, high):  # type: ignore[no-untyped-def]  # compiled
    """A float32 from low to high: low + u (high - low), u a multiple of 2**-24 below 1."""
    return low + np.float32(draw_integer(stream, DRAW)) * UNIT * (high - low)


@inline(counts=False)
def start(seed, task, robots, items, stream, tally, lengths):  # type: ignore[no-untyped-def]  # compiled
    """Lay out a trial."""
    stream[0] = seed
    tally[:] = 0.0
    robots[:] = ZERO
    low, high = lengths[RADIUS], lengths[SIDE] - lengths[RADIUS]
    if task == DISPERSION:  # the middle half
        low, high = low + (high - low) * HALF * HALF, high - (high - low) * HALF * HALF
    for robot in range(robots.shape[1]):
        robots[X, robot] = draw(stream, low, high)
        robots[Y, robot] = draw(stream, low, high)
        square = ZERO
        while square > ONE or square < SHORTEST:
            heading_x, heading_y = draw(stream, -ONE, ONE), draw(stream, -ONE, ONE)
            square = heading_x * heading_x + heading_y * heading_y
        length = sqrt(square)
        robots[HEADING_X, robot] = heading_x / length
        robots[HEADING_Y, robot] = heading_y / length
    if task == CONSENSUS:
        truth = draw(stream, ZERO, ONE)
        tally[TRUTH] = truth
        for robot in range(robots.shape[1]):
            robots[READING, robot] = truth + draw(stream, -lengths[NOISE], lengths[NOISE])
            robots[SAID, robot] = cut(robots[READING, robot])
    for item in range(items.shape[1]):
        place_item(item, items, stream, lengths)


@inline(counts=False, inner=True)
def place_item(item, items, stream, lengths):  # type: ignore[no-untyped-def]  # compiled
    """Put an item somewhere outside the nest."""
    items[X, item] = draw(stream, lengths[NEST], lengths[SIDE] - lengths[RADIUS])
    items[Y, item] = draw(stream, lengths[RADIUS], lengths[SIDE] - lengths[RADIUS])


@inline(counts=False)
def sense_task(task, robots, items, lengths, observations):  # type: ignore[no-untyped-def]  # compiled
    """Write what each robot senses for its task."""
    inputs = observations.shape[0] // robots.shape[1]
    if task == FORAGING:
        for robot in range(robots.shape[1]):
            at = inputs * robot + WORLD_INPUTS
            x, y, heading_x, heading_y = robots[X, robot], robots[Y, robot], robots[HEADING_X, robot], robots[HEADING_Y, robot]
            least, to_x, to_y = lengths[SIGHT] * lengths[SIGHT], ZERO, ZERO
            for item in range(items.shape[1]):
                dx, dy = items[X, item] - x, items[Y, item] - y
                square = dx * dx + dy * dy
                if square < least:
                    least, to_x, to_y = square, dx, dy
            distance = at_least(sqrt(least), lengths[RADIUS])
            observations[at] = (to_x * heading_x + to_y * heading_y) / distance
            observations[at + 1] = (to_y * heading_x - to_x * heading_y) / distance
            observations[at + 2] = -heading_x
            observations[at + 3] = heading_y
            observations[at + 4] = robots[CARRIES, robot]
    elif task == CONSENSUS:
        for robot in range(robots.shape[1]):
            at = inputs * robot + WORLD_INPUTS
            observations[at] = robots[READING, robot]
            number = robots[NEIGHBOURS, robot]
            observations[at + 1] = robots[HEARD, robot] / number if number > ZERO else robots[SAID, robot]


@inline(counts=False, inner=True)
def happen(task, actions, robots, items, stream, tally, lengths):  # type: ignore[no-untyped-def]  # compiled
    """After the robots have moved: items are found and brought home, words are said."""
    if task == FORAGING:
        reach = lengths[RADIUS] * lengths[RADIUS]
        for robot in range(robots.shape[1]):
            x, y = robots[X, robot], robots[Y, robot]
            if robots[CARRIES, robot] > ZERO:
                if x < lengths[NEST]:
                    robots[CARRIES, robot] = ZERO
                    tally[DELIVERED] += 1.0
            else:
                for item in range(items.shape[1]):
                    dx, dy = items[X, item] - x, items[Y, item] - y
                    if dx * dx + dy * dy < reach:
                        robots[CARRIES, robot] = ONE
                        tally[FOUND] += 1.0
                        place_item(item, items, stream, lengths)
                        break
    elif task == CONSENSUS:
        for robot in range(robots.shape[1]):
            robots[SAID, robot] = cut(actions[2, robot])


@inline(counts=False, inner=True)
def measure(task, robots, tally):  # type: ignore[no-untyped-def]  # compiled
    """Add to the tally what counts of the present state."""
    tally[MEASURED] += 1.0
    number = robots.shape[1]
    total = np.float32(number)
    first, second = ZERO, ZERO
    if task == AGGREGATION:
        middle_x, middle_y = ZERO, ZERO
        for robot in range(number):
            middle_x = middle_x + robots[X, robot]
            middle_y = middle_y + robots[Y, robot]
        middle_x, middle_y = middle_x / total, middle_y / total
        for robot in range(number):
            dx, dy = robots[X, robot] - middle_x, robots[Y, robot] - middle_y
            first = first + sqrt(dx * dx + dy * dy)
            second = second + robots[NEIGHBOURS, robot]
    elif task == DISPERSION:
        for robot in range(number):
            first = first + sqrt(robots[NEAREST, robot])
            second = second + robots[NEIGHBOURS, robot]
    elif task == CONSENSUS:
        truth, middle = np.float32(tally[TRUTH]), ZERO
        for robot in range(number):
            middle = middle + robots[SAID, robot]
        middle = middle / total
        for robot in range(number):
            first = first + abs(robots[SAID, robot] - truth)
            second = second + abs(robots[SAID, robot] - middle)
    tally[FIRST] += np.float64(first / total)
    tally[SECOND] += np.float64(second / total)


@inline(counts=False)
def judge(task, tally, lengths, fitness, metrics):  # type: ignore[no-untyped-def]  # compiled
    """Fitness and metrics of a trial that ended."""
    first, second = tally[FIRST] / tally[MEASURED], tally[SECOND] / tally[MEASURED]
    if task == AGGREGATION:
        fitness[0] = 1.0 - first / (MIDDLE * np.float64(lengths[SIDE]))
    elif task == DISPERSION:
        fitness[0] = first / np.float64(lengths[SIGHT])
    elif task == FORAGING:
        first, second = tally[DELIVERED], tally[FOUND]
        fitness[0] = (first + second) / 2.0
    else:
        fitness[0] = 1.0 - 4.0 * first
    metrics[0], metrics[1], metrics[2] = first, second, tally[CONTACTS] / 2.0 / tally[STEP_NUMBER]
