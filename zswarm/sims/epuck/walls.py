"""Find the walls near e-pucks, and where rays enter them."""

# mypy: disable-error-code=no-untyped-def
# because numba infers the types of kernels.

from zswarm.kernels.jit import inline
from zswarm.sims.epuck.world import (
    CENTRE_X,
    CENTRE_Y,
    HALF_LENGTH,
    HALF_WIDTH,
    WALL_COSINE,
    WALL_SINE,
)


@inline(counts=False, inner=True)
def first_near(world, x, y, reach):
    """Return the index of the first wall that may be within reach of a point."""
    free = world.free - reach
    if free > 0.0 and x * x + y * y < free * free:
        return world.outer_walls
    return 0


@inline(counts=False, inner=True)
def is_near(box, x, y, reach):
    """Return whether the box, each side moved outwards by a reach, contains a point."""
    dx = x - box[CENTRE_X]
    dy = y - box[CENTRE_Y]
    along = abs(dx * box[WALL_COSINE] + dy * box[WALL_SINE]) - box[HALF_LENGTH]
    across = abs(dy * box[WALL_COSINE] - dx * box[WALL_SINE]) - box[HALF_WIDTH]
    return max(along, across) < reach


@inline(counts=False, inner=True)
def square_to(box, x, y):
    """Return the square of the distance of a point to a box; 0 inside."""
    dx = x - box[CENTRE_X]
    dy = y - box[CENTRE_Y]
    along = abs(dx * box[WALL_COSINE] + dy * box[WALL_SINE]) - box[HALF_LENGTH]
    across = abs(dy * box[WALL_COSINE] - dx * box[WALL_SINE]) - box[HALF_WIDTH]
    along = max(along, 0.0)
    across = max(across, 0.0)
    return along * along + across * across


@inline(counts=False, inner=True)
def to_box(box, x, y, dx, dy):
    """Return the part of a way after which it enters a box; 2 if it does not."""
    from_x = x - box[CENTRE_X]
    from_y = y - box[CENTRE_Y]
    along = from_x * box[WALL_COSINE] + from_y * box[WALL_SINE]
    across = from_y * box[WALL_COSINE] - from_x * box[WALL_SINE]
    to_along = dx * box[WALL_COSINE] + dy * box[WALL_SINE]
    to_across = dy * box[WALL_COSINE] - dx * box[WALL_SINE]
    if along < 0.0:
        along, to_along = -along, -to_along
    if across < 0.0:
        across, to_across = -across, -to_across
    # From the first quadrant two faces are visible.
    if along > box[HALF_LENGTH] and to_along < 0.0:
        part = (box[HALF_LENGTH] - along) / to_along
        if part < 1.0 and abs(across + part * to_across) <= box[HALF_WIDTH]:
            return part
    if across > box[HALF_WIDTH] and to_across < 0.0:
        part = (box[HALF_WIDTH] - across) / to_across
        if part < 1.0 and abs(along + part * to_along) <= box[HALF_LENGTH]:
            return part
    return 2.0
