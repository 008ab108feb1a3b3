"""Bodies: how robots move."""

# mypy: disable-error-code=no-untyped-def
# because numba infers the types of kernels.

from zswarm.kernels.jit import inline
from zswarm.kernels.portable import cos, sin


@inline(counts=False)
def drive(x, y, heading, left, right, wheels, seconds):
    """Move a robot with two wheels for a step; return its new x, y and heading.

    It moves as far as its middle does, in the direction that it has in the middle of its arc.

    Args:
        left, right: speeds of the wheels, in lengths per second.
        wheels: their distance.
        seconds: of the step.
    """
    turned = (right - left) / wheels * seconds
    middle = heading + 0.5 * turned
    way = 0.5 * (left + right) * seconds
    return x + way * cos(middle), y + way * sin(middle), heading + turned
