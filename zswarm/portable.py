"""Functions with the same bits everywhere: Python, numba on any CPU, C.

``exp`` and its like differ between numpy, numba, CPUs and C libraries in 10-40 % of float32 values. Here they are made of
``+ - * /`` in a fixed order, which IEEE 754 rounds the same everywhere. Simulators, networks and exported controllers
take transcendental functions from this file only.
"""

import numpy as np

from zswarm.jit import inline
from zswarm.lanes import select

# exp: x = k ln 2 + r, |r| <= ln 2 / 2, and a rational approximation of exp(r) (W. J. Cody, W. Waite, "Software Manual for
# the Elementary Functions", 1980; constants as in the public fdlibm, e_exp). Error below 1 unit in the last place.
LN2_HIGH = 6.93147180369123816490e-01
LN2_LOW = 1.90821492927058770002e-10
INVERSE_LN2 = 1.44269504088896338700e00
P1 = 1.66666666666666019037e-01
P2 = -2.77777777770155933842e-03
P3 = 6.61375632143793436117e-05
P4 = -1.65339022054652515390e-06
P5 = 4.13813679705723846039e-08
LARGEST, SMALLEST = 709.782712893383973096, -745.13321910194110842
LOWEST_POWER = -1075
POWERS_OF_TWO = np.array([2.0**k for k in range(LOWEST_POWER, 1024)])

# log: x = 2^k (1 + f), 1 + f within a factor of sqrt 2 of 1, and a polynomial in s = f / (2 + f) (constants as in the public
# fdlibm, e_log). Error below 1 unit in the last place.
L1 = 6.666666666666735130e-01
L2 = 3.999999999940941908e-01
L3 = 2.857142874366239149e-01
L4 = 2.222219843214978396e-01
L5 = 1.818357216161805012e-01
L6 = 1.531383769920937332e-01
L7 = 1.479819860511658591e-01
ROOT_HALF = 7.07106781186547524401e-01

# tanh: 1 - 2 / (e^2x + 1), where e^2x is the fourth power of a polynomial close to e^(x/2); coefficients fitted by us to the
# least greatest error, 3.6e-5. All are positive, so every step grows with x and no rounding makes the whole fall.
T1 = np.float32(0.49962949)
T2 = np.float32(0.12714170)
T3 = np.float32(0.01738343)
T4 = np.float32(0.00450478)
ZERO, ONE, TWO = np.float32(0), np.float32(1), np.float32(2)
FLAT = np.float32(20)  # from here on tanh is 1

INT_MAX, INT_MIN = 2147483647, -2147483648


@inline
def exp(x):  # type: ignore[no-untyped-def]  # compiled
    """e to the power x, float64; 0 below the smallest number, infinity above the largest, NaN for NaN."""
    if x != x:
        return x
    if x > LARGEST:
        return np.inf
    if x < SMALLEST:
        return 0.0
    k = int(x * INVERSE_LN2 + (0.5 if x >= 0.0 else -0.5))
    high = x - k * LN2_HIGH
    low = k * LN2_LOW
    r = high - low
    t = r * r
    c = r - t * (P1 + t * (P2 + t * (P3 + t * (P4 + t * P5))))
    y = 1.0 - ((low - (r * c) / (2.0 - c)) - high)
    if k == 1024:  # 2 ** 1024 is no number, twice 2 ** 1023 times y < 1 is
        return y * 2.0 * POWERS_OF_TWO[1023 - LOWEST_POWER]
    return y * POWERS_OF_TWO[k - LOWEST_POWER]


def log(x: np.ndarray) -> np.ndarray:
    """The natural logarithm of positive float64 numbers, an array of them: numpy's, for kernels need none."""
    mantissa, k = np.frexp(x)  # exact, mantissa in [1/2, 1)
    small = mantissa < ROOT_HALF
    f = np.where(small, 2.0 * mantissa, mantissa) - 1.0
    k = (k - small).astype(np.float64)
    s = f / (2.0 + f)
    z = s * s
    w = z * z
    r = w * (L2 + w * (L4 + w * L6)) + z * (L1 + w * (L3 + w * (L5 + w * L7)))
    half = 0.5 * f * f
    y: np.ndarray = k * LN2_HIGH - ((half - (s * (half + r) + k * LN2_LOW)) - f)
    return y


@inline
def sigmoid(x):  # type: ignore[no-untyped-def]  # compiled
    """1 / (1 + exp(-x)), float64."""
    return 1.0 / (1.0 + exp(-x))


@inline
def tanh(x):  # type: ignore[no-untyped-def]  # compiled
    """The hyperbolic tangent of a float32, or of lanes, within 3.7e-5 and at most 1; odd, never falls as x grows; NaN for NaN."""
    negative = x < ZERO
    size = select(negative, ZERO - x, x)
    size = select(size > FLAT, FLAT, size)
    root = ONE + size * (T1 + size * (T2 + size * (T3 + size * T4)))
    square = root * root
    y = ONE - TWO / (square * square + ONE)
    return select(negative, ZERO - y, y)


@inline
def to_int(x):  # type: ignore[no-untyped-def]  # compiled
    """A number cut to a 32-bit integer as Java does: NaN is 0, beyond the range its nearest end."""
    if x != x:
        return 0
    if x >= 2147483647.0:
        return INT_MAX
    if x <= -2147483648.0:
        return INT_MIN
    return int(x)
