"""Compute cosines and sines of eight angles at once, with the bits of ``portable``'s."""

# mypy: disable-error-code=no-untyped-def
# because numba infers the types of kernels.

from zswarm.kernels.jit import inline
from zswarm.kernels.lanes import any_of, floor, select
from zswarm.kernels.portable import (
    FAR,
    PER_QUARTER,
    QUARTER_1,
    QUARTER_2,
    QUARTER_3,
    cos_near,
    sin_near,
)


@inline
def are_near(x):
    """Return whether ``turned`` takes these lanes of float64 angles."""
    return not any_of((x > FAR) | (x < -FAR) | (x != x))


@inline
def turned(x):
    """Return the cosines and the sines of lanes of float64 angles, see ``are_near``."""
    negative = x < 0.0
    size = select(negative, 0.0 - x, x)
    k = floor(size * PER_QUARTER + 0.5)
    most = size - k * QUARTER_1
    second = k * QUARTER_2
    rest = most - second
    lost = k * QUARTER_3 - ((most - rest) - second)
    r = rest - lost
    tail = (rest - r) - lost
    quarter = k - 4.0 * floor(k * 0.25)
    odd = (quarter == 1.0) | (quarter == 3.0)
    sine = sin_near(r, tail)
    cosine = cos_near(r, tail)
    x = select(odd, sine, cosine)
    y = select(odd, cosine, sine)
    sign = select(negative, -1.0, 1.0)
    return (
        x * select((quarter == 1.0) | (quarter == 2.0), -1.0, 1.0),
        y * select(quarter >= 2.0, 0.0 - sign, sign),
    )
