"""Sensor noise: how readings differ from what is there."""

# mypy: disable-error-code=no-untyped-def
# because numba infers the types of kernels.

from zswarm.kernels.jit import inline
from zswarm.kernels.random import draw_normal, draw_uniform


@inline(counts=False)
def disturbed(reading, most, stream):
    """Return a reading of 0 to 1 with uniform noise of up to ``most``, limited to 0 to 1.

    Args:
        stream: (1,) uint64, as for ``zswarm.kernels.random.draw_uniform``.
    """
    noisy = reading + most * (2.0 * draw_uniform(stream) - 1.0)
    return min(max(noisy, 0.0), 1.0)


@inline(counts=False)
def blurred(reading, deviation, stream):
    """Return a reading with normally distributed noise of this deviation.

    Args:
        stream: (1,) uint64, as for ``zswarm.kernels.random.draw_normal``.
    """
    return reading + deviation * draw_normal(stream)
