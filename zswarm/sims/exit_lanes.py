"""Play eight trials of ``emergency-exit`` in parallel, one in each lane."""

# mypy: disable-error-code=no-untyped-def
# because numba infers the types of kernels.

from typing import NamedTuple

import numpy as np

from zswarm.kernels.jit import STEP, inline, int64, kernel, void
from zswarm.kernels.lanes import LANES, any_of, fill, load, scatter, select, store, window
from zswarm.kernels.signatures import Int64s
from zswarm.sims.exit_fields import BLOCKED, FREE, Fields
from zswarm.sims.exit_rules import INPUTS, OUTPUTS, Room, judge, rounded
from zswarm.sims.simulator import KernelBatch

ZERO = np.float32(0)
# Where an observation has the cells around.
NORTH, NORTH_EAST, EAST, SOUTH_EAST, SOUTH, SOUTH_WEST, WEST, NORTH_WEST = range(
    2 * LANES, INPUTS * LANES, LANES
)
LEFT, STILL, RIGHT = np.int32(-1), np.int32(0), np.int32(1)


class Lanes8(NamedTuple):
    """Eight trials; but for ``grid`` and ``exits`` the eight lanes' numbers are adjacent."""

    controllers: np.ndarray  # (8 parameters,) float32
    grid: np.ndarray  # (8 cells + 4,) float32, the lanes' fields one after the other
    exits: np.ndarray  # float32, ``to_exit`` of all fields
    offsets: np.ndarray  # (8,) int32, from a cell in ``grid`` to its numbers in ``exits``
    cells: np.ndarray  # (8 agents,) int32, in ``grid``
    nearest: np.ndarray  # (16 agents,) float32, dx and dy to the nearest exit
    # (8,) int32, filled: the first round after which all agents were out.
    rounds: np.ndarray
    observation: np.ndarray
    action: np.ndarray


@inline(counts=False)
def start(lanes, first, rows, fields, batch):
    """Put eight trials into the lanes, and the last trial of the batch into lanes to spare."""
    cells = fields.free.shape[1]
    agents = fields.starts.shape[1]
    for lane in range(LANES):
        trial = min(first + lane, rows.shape[0] - 1)
        field = rows[trial]
        controller = batch.parameters[batch.participants[trial, 0]]
        for number in range(controller.shape[0]):
            lanes.controllers[number * LANES + lane] = controller[number]
        for cell in range(cells):
            lanes.grid[lane * cells + cell] = fields.free[field, cell]
        lanes.offsets[lane] = field * fields.to_exit.shape[1] - 2 * lane * cells
        for agent in range(agents):
            cell = fields.starts[field, agent]
            lanes.grid[lane * cells + cell] = BLOCKED
            lanes.cells[agent * LANES + lane] = lane * cells + cell
            lanes.nearest[2 * agent * LANES + lane] = fields.to_exit[field, 2 * cell]
            lanes.nearest[(2 * agent + 1) * LANES + lane] = fields.to_exit[
                field, 2 * cell + 1
            ]


@inline(counts=False)
def observe(here, exits, grid, stride, observation):
    """Write what agents observe: the way to the exit, and the cells around from the north on."""
    north = window(grid, here, -stride - 1)
    middle = window(grid, here, -1)
    south = window(grid, here, stride - 1)
    around = (
        north[1],
        north[2],
        middle[2],
        south[2],
        south[1],
        south[0],
        middle[0],
        north[0],
    )
    store(observation, 0, exits[0])
    store(observation, LANES, exits[1])
    for sensor, numbers in enumerate(around):
        store(observation, (2 + sensor) * LANES, numbers)


@inline(counts=False)
def ahead(action, observation):
    """Return the agents' directions, and whether the cells there are free.

    The cells are read from the observation: no register need keep them while the agents decide.
    """
    west, east = rounded(load(action, 0))
    up, down = rounded(load(action, LANES))
    left = select(
        up,
        load(observation, NORTH_WEST),
        select(down, load(observation, SOUTH_WEST), load(observation, WEST)),
    )
    same = select(
        up,
        load(observation, NORTH),
        select(down, load(observation, SOUTH), BLOCKED),
    )
    right = select(
        up,
        load(observation, NORTH_EAST),
        select(down, load(observation, SOUTH_EAST), load(observation, EAST)),
    )
    x = select(east, RIGHT, select(west, LEFT, STILL))
    y = select(down, RIGHT, select(up, LEFT, STILL))
    return x, y, select(east, right, select(west, left, same)) != BLOCKED


@inline(counts=False)
def play_rounds(step, states, lanes, stride, steps):
    """Play until all agents are out in every lane.

    No branch depends on one lane: an agent that is out takes part, and stays where it is.
    """
    remaining = fill(np.int32(states.shape[0]))
    offset = load(lanes.offsets, 0)
    first_out = fill(np.int32(steps))
    for round_ in range(steps):
        for agent in range(states.shape[0]):
            at_x = 2 * agent * LANES
            at_y = (2 * agent + 1) * LANES
            exits = load(lanes.nearest, at_x), load(lanes.nearest, at_y)
            is_inside = (exits[0] != ZERO) | (exits[1] != ZERO)
            if any_of(is_inside):
                here = load(lanes.cells, agent * LANES)
                observe(here, exits, lanes.grid, stride, lanes.observation)
                step(lanes.controllers, states[agent], lanes.observation, lanes.action)
                x, y, is_free = ahead(lanes.action, lanes.observation)
                there = select(is_inside & is_free, here + y * np.int32(stride) + x, here)
                there_x, there_y, _, _ = window(lanes.exits, there + there + offset, 0)
                stays = (there_x != ZERO) | (there_y != ZERO)
                scatter(lanes.grid, here, fill(FREE))
                scatter(lanes.grid, there, select(stays, BLOCKED, FREE))
                store(lanes.cells, agent * LANES, there)
                store(lanes.nearest, at_x, there_x)
                store(lanes.nearest, at_y, there_y)
                left = select(is_inside, RIGHT, STILL) - select(stays, RIGHT, STILL)
                remaining = remaining - left
        all_out = (remaining == STILL) & (first_out == np.int32(steps))
        first_out = select(all_out, np.int32(round_), first_out)
        if not any_of(remaining != STILL):
            break
    store(lanes.rounds, 0, first_out)


@kernel(void(STEP, Fields, Int64s, KernelBatch, int64, int64))
def play_lanes(step, fields, rows, batch, stride, steps):
    """Play the trials of a batch; ``rows`` are their fields."""
    size = fields.free.shape[1]
    agents = fields.starts.shape[1]
    states = np.zeros((agents, LANES * batch.state_size), np.float32)
    lanes = Lanes8(
        np.empty(batch.parameters.shape[1] * LANES, np.float32),
        # Windows of the last cells reach behind them.
        np.empty(size * LANES + 4, np.float32),
        fields.to_exit.reshape(fields.to_exit.size),
        np.empty(LANES, np.int32),
        np.empty(agents * LANES, np.int32),
        np.empty(2 * agents * LANES, np.float32),
        np.empty(LANES, np.int32),
        np.empty(INPUTS * LANES, np.float32),
        np.empty(OUTPUTS * LANES, np.float32),
    )
    cells = np.empty(agents, np.int32)
    inside = np.empty(agents, np.uint8)
    for first in range(0, rows.shape[0], LANES):
        batch.progress[0] = first
        if batch.progress[1] != 0:
            return
        start(lanes, first, rows, fields, batch)
        states[:] = 0
        play_rounds(step, states, lanes, stride, steps)
        for trial in range(first, min(first + LANES, rows.shape[0])):
            lane = trial - first
            for agent in range(agents):
                cells[agent] = lanes.cells[agent * LANES + lane] - lane * size
                dx = lanes.nearest[2 * agent * LANES + lane]
                dy = lanes.nearest[(2 * agent + 1) * LANES + lane]
                inside[agent] = dx != ZERO or dy != ZERO
            room = Room(lanes.grid, fields.to_exit[rows[trial]], cells, inside, stride)
            rounds = np.int64(lanes.rounds[lane])
            judge(room, rounds, steps, batch.fitness[trial], batch.metrics[trial])
