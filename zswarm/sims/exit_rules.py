"""The rules of ``emergency-exit`` that both of its kernels share."""

from typing import NamedTuple

import numpy as np

from zswarm.kernels.jit import inline

INPUTS, OUTPUTS = 10, 2
HALF, ONE, TWO = np.float32(0.5), np.float32(1), np.float32(2)


class Room(NamedTuple):
    """The field and the agents of a trial."""

    free: np.ndarray  # (cells,) float32, FREE or BLOCKED
    to_exit: np.ndarray  # (2 cells + 2,) float32
    cells: np.ndarray  # (agents,) int32
    inside: np.ndarray  # (agents,) uint8
    stride: int


@inline
def rounded(output):  # type: ignore[no-untyped-def]  # compiled
    """Return whether 2 o - 1, rounded as in Java, is -1, and whether it is 1; also of lanes."""
    moved = TWO * output - ONE
    return (moved < -HALF) & (moved >= -ONE - HALF), (moved >= HALF) & (
        moved < ONE + HALF
    )


@inline(counts=False)
def judge(room, first_all_out, steps, fitness, metrics):  # type: ignore[no-untyped-def]  # compiled
    """Write fitness and metrics of a trial that ended."""
    total = 0.0
    escaped = 0
    for agent in range(room.cells.shape[0]):
        cell = room.cells[agent]
        dx = np.float64(room.to_exit[2 * cell])
        dy = np.float64(room.to_exit[2 * cell + 1])
        total += np.sqrt(dx * dx + dy * dy)
        escaped += 1 - room.inside[agent]
    fitness[0] = (steps - first_all_out) / steps - total
    metrics[0] = escaped
    metrics[1] = min(first_all_out + 1, steps)
