"""Compute transcendental functions with the same bits in Python, in numba on any CPU, and in C.

``exp`` and its like differ between numpy, numba, CPUs and C libraries in 10-40 % of float32 values.
Here they are made of ``+ - * /`` in a fixed order, which IEEE 754 rounds the same everywhere, and
of remainders, which are exact. Simulators, networks and exported controllers take transcendental
functions from this file and ``angles.py`` only. ``ordered_sum`` and the functions after it replace
numpy's reductions, which promise no order of additions.
"""

# mypy: disable-error-code=no-untyped-def
# because numba infers the types of kernels.

from typing import Any

import numpy as np

from zswarm.kernels.jit import inline
from zswarm.kernels.lanes import select, sqrt

# exp: x = k ln 2 + r, |r| <= ln 2 / 2, and a rational approximation of exp(r) (W. J. Cody, W.
# Waite, "Software Manual for the Elementary Functions", 1980; constants as in the public fdlibm,
# e_exp). Error below 1 unit in the last place.
LN2_HIGH = 6.93147180369123816490e-01
LN2_LOW = 1.90821492927058770002e-10
INVERSE_LN2 = 1.44269504088896338700e00
P1 = 1.66666666666666019037e-01
P2 = -2.77777777770155933842e-03
P3 = 6.61375632143793436117e-05
P4 = -1.65339022054652515390e-06
P5 = 4.13813679705723846039e-08
LARGEST, SMALLEST = 709.782712893383973096, -745.13321910194110842

# A float64's bits: 52 of the fraction, then 11 of the exponent plus 1023, which is 0 in what is
# smaller than 2^-1022.
BIAS, LOWEST_EXPONENT, FRACTION_BITS = 1023, -1022, np.uint64(52)
LIFT, LOWERED = 54, 2.0**-54

# log: x = 2^k (1 + f), 1 + f within a factor of sqrt 2 of 1, and a polynomial in s = f / (2 + f)
# (constants as in the public fdlibm, e_log). Error below 1 unit in the last place.
L1 = 6.666666666666735130e-01
L2 = 3.999999999940941908e-01
L3 = 2.857142874366239149e-01
L4 = 2.222219843214978396e-01
L5 = 1.818357216161805012e-01
L6 = 1.531383769920937332e-01
L7 = 1.479819860511658591e-01
ROOT_HALF = 7.07106781186547524401e-01

# tanh: 1 - 2 / (e^2x + 1), where e^2x is the fourth power of a polynomial close to e^(x/2);
# coefficients fitted by us to the least greatest error, 3.6e-5. All are positive, so every step
# grows with x and no rounding makes the whole fall.
T1 = np.float32(0.49962949)
T2 = np.float32(0.12714170)
T3 = np.float32(0.01738343)
T4 = np.float32(0.00450478)
ZERO, ONE, TWO = np.float32(0), np.float32(1), np.float32(2)
FLAT = np.float32(20)  # from here on tanh is 1

# sin, cos: |x| = k pi/2 + r, |r| <= pi/4, with pi/2 in three parts, of which the first two have 33
# bits, so that k times each is exact; then polynomials (W. J. Cody, W. Waite, as above; constants
# as in the public fdlibm, e_rem_pio2, k_sin and k_cos).
LARGEST_FLOAT = 1.7976931348623157e308
PI = 3.14159265358979311600e00
FAR = 1e6  # from here on |x| is first divided by 2 pi as float64 has it
PER_QUARTER = 6.36619772367581382433e-01  # 2 / pi
QUARTER_1 = 1.57079632673412561417e00
QUARTER_2 = 6.07710050630396597660e-11
QUARTER_3 = 2.02226624879595063154e-21
S1 = -1.66666666666666324348e-01
S2 = 8.33333333332248946124e-03
S3 = -1.98412698298579493134e-04
S4 = 2.75573137070700676789e-06
S5 = -2.50507602534068634195e-08
S6 = 1.58969099521155010221e-10
C1 = 4.16666666666666019037e-02
C2 = -1.38888888888741095749e-03
C3 = 2.48015872894767294178e-05
C4 = -2.75573143513906633035e-07
C5 = 2.08757232129817482790e-09
C6 = -1.13596475577881948265e-11

# atan2: atan(s) = atan(c) + atan(t), t = (s - c) / (1 + c s), for c in 0, 1/2, 1, 3/2 and infinity,
# so that |t| <= 7/16; then a polynomial (constants as in the public fdlibm, s_atan).
ATAN_HIGH = np.array(
    [
        0.0,
        4.63647609000806093515e-01,
        7.85398163397448278999e-01,
        9.82793723247329054082e-01,
        1.57079632679489655800e00,
    ]
)
ATAN_LOW = np.array(
    [
        0.0,
        2.26987774529616870924e-17,
        3.06161699786838301793e-17,
        1.39033110312309984516e-17,
        6.12323399573676603587e-17,
    ]
)
A1 = 3.33333333333329318027e-01
A2 = -1.99999999998764832476e-01
A3 = 1.42857142725034663711e-01
A4 = -1.11111104054623557880e-01
A5 = 9.09088713343650656196e-02
A6 = -7.69187620504482999495e-02
A7 = 6.66107313738753120669e-02
A8 = -5.83357013379057348645e-02
A9 = 4.97687799461593236017e-02
A10, A11 = -3.65315727442169155270e-02, 1.62858201153657823623e-02
PI_LOW = 1.2246467991473531772e-16  # what float64's pi lacks
STEEP = 2.0**-60  # a slope of more than its inverse is straight up

INT_MAX, INT_MIN = 2147483647, -2147483648


@inline
def exp(x):
    """Return e to the power x, float64; 0 on underflow, infinity on overflow, NaN for NaN."""
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
        return y * 2.0 * power_of_two(k - 1)
    return y * power_of_two(k)


@inline
def power_of_two(k):
    """Return 2 to the power of an integer from -1075 to 1023, float64; 0 for -1075."""
    if k < LOWEST_EXPONENT:
        return (
            np.uint64(np.uint64(k + LIFT + BIAS) << FRACTION_BITS).view(np.float64)
            * LOWERED
        )
    return np.uint64(np.uint64(k + BIAS) << FRACTION_BITS).view(np.float64)


def log(x: np.ndarray) -> np.ndarray:
    """Return the natural logarithms of an array of positive float64 numbers."""
    mantissa, k = np.frexp(x)  # exact, mantissa in [1/2, 1)
    small = mantissa < ROOT_HALF
    mantissa = np.where(small, 2.0 * mantissa, mantissa)
    found: np.ndarray = log_of_parts(mantissa - 1.0, (k - small).astype(np.float64))
    return found


def log_of_parts(f: Any, k: Any) -> Any:
    """Return the logarithm of (1 + f) 2^k, with 1 + f near 1."""
    s = f / (2.0 + f)
    z = s * s
    w = z * z
    r = w * (L2 + w * (L4 + w * L6)) + z * (L1 + w * (L3 + w * (L5 + w * L7)))
    half = 0.5 * f * f
    return k * LN2_HIGH - ((half - (s * (half + r) + k * LN2_LOW)) - f)


compiled_log_of_parts = inline(counts=False)(
    log_of_parts
)  # for kernels; arrays do not need the compiler


@inline
def log_of(x):
    """Return the natural logarithm of a normal positive number, float64."""
    bits = np.float64(x).view(np.uint64)
    exponent = np.int64(bits >> FRACTION_BITS) - (BIAS - 1)
    fraction = bits & ((np.uint64(1) << FRACTION_BITS) - np.uint64(1))
    half = np.uint64(BIAS - 1) << FRACTION_BITS
    mantissa = np.uint64(fraction | half).view(np.float64)  # in [1/2, 1)
    if mantissa < ROOT_HALF:
        mantissa = 2.0 * mantissa
        exponent -= 1
    return compiled_log_of_parts(mantissa - 1.0, np.float64(exponent))


@inline
def sigmoid(x):
    """Return 1 / (1 + exp(-x)), float64."""
    return 1.0 / (1.0 + exp(-x))


@inline
def tanh(x):
    """Return the hyperbolic tangent of a float32, or of lanes; NaN for NaN.

    The error is at most 3.7e-5. Values are within -1..1, odd in x, and monotonic.
    """
    negative = x < ZERO
    size = select(negative, ZERO - x, x)
    size = select(size > FLAT, FLAT, size)
    root = ONE + size * (T1 + size * (T2 + size * (T3 + size * T4)))
    square = root * root
    y = ONE - TWO / (square * square + ONE)
    return select(negative, ZERO - y, y)


@inline
def sin(x):
    """Return the sine of an angle in radians, float64; NaN for infinite angles and NaN.

    The error is below .8 units in the last place up to |x| = 10^6. Larger angles are first reduced
    modulo float64's 2 pi, so that their error is that of an angle off by |x| 4e-17; the bits are
    still the same everywhere.
    """
    if not abs(x) <= LARGEST_FLOAT:
        return np.nan
    k, r, tail = split_quarters(abs(x))
    y = cos_near(r, tail) if k & 1 else sin_near(r, tail)
    return -y if (k & 2 != 0) != (x < 0.0) else y


@inline
def cos(x):
    """Return the cosine of an angle in radians, float64; range and error are as in ``sin``."""
    if not abs(x) <= LARGEST_FLOAT:
        return np.nan
    k, r, tail = split_quarters(abs(x))
    y = sin_near(r, tail) if k & 1 else cos_near(r, tail)
    return -y if (k + 1) & 2 else y


@inline
def split_quarters(size):
    """Split a nonnegative angle into quarter turns and a remainder, the sum of two numbers.

    An angle above ``FAR`` is first reduced modulo 2 pi.
    """
    if size > FAR:
        size = size % (2.0 * PI)
    k = int(size * PER_QUARTER + 0.5)
    most = size - k * QUARTER_1
    second = k * QUARTER_2
    rest = most - second
    lost = k * QUARTER_3 - ((most - rest) - second)
    r = rest - lost
    return k, r, (rest - r) - lost


@inline
def sin_near(r, tail):
    """Return the sine of r + tail, which is within pi/4 of 0."""
    z = r * r
    v = z * r
    p = S2 + z * (S3 + z * (S4 + z * (S5 + z * S6)))
    return r - ((z * (0.5 * tail - v * p) - tail) - v * S1)


@inline
def cos_near(r, tail):
    """Return the cosine of r + tail, which is within pi/4 of 0."""
    z = r * r
    p = z * (C1 + z * (C2 + z * (C3 + z * (C4 + z * (C5 + z * C6)))))
    half = 0.5 * z
    w = 1.0 - half
    return w + (((1.0 - w) - half) + (z * p - r * tail))


@inline
def atan2(y, x):
    """Return the angle of the vector (x, y) in radians, -pi to pi, float64.

    The error is below 1.3 units in the last place. Signs of zeros are ignored: the angle of (0, 0)
    is 0, and angles are negative only where y < 0. The result is NaN for NaN, and where both are
    infinite.
    """
    size_x, size_y = abs(x), abs(y)
    if size_x > LARGEST_FLOAT and size_y > LARGEST_FLOAT:
        return np.nan
    if size_x == 0.0 and size_y == 0.0:
        return 0.0
    if size_y * STEEP > size_x:
        angle = PI / 2.0
    else:
        angle = atan_of_size(size_y / size_x)
        if x < 0.0:
            angle = PI - (angle - PI_LOW)
    return -angle if y < 0.0 else angle


@inline
def atan_of_size(s):
    """Return the arc tangent of a nonnegative number."""
    if s < 0.4375:
        which, t = 0, s
    elif s < 0.6875:
        which, t = 1, (2.0 * s - 1.0) / (2.0 + s)
    elif s < 1.1875:
        which, t = 2, (s - 1.0) / (s + 1.0)
    elif s < 2.4375:
        which, t = 3, (s - 1.5) / (1.0 + 1.5 * s)
    else:
        which, t = 4, -1.0 / s
    z = t * t
    w = z * z
    odd = z * (A1 + w * (A3 + w * (A5 + w * (A7 + w * (A9 + w * A11)))))
    even = w * (A2 + w * (A4 + w * (A6 + w * (A8 + w * A10))))
    return ATAN_HIGH[which] - ((t * (odd + even) - ATAN_LOW[which]) - t)


@inline
def remainder(x, divisor):
    """Return the exact remainder of x / divisor with the sign of x, as Java does.

    float64; ``divisor`` must be positive. NaN if x is not finite.
    """
    if not abs(x) <= LARGEST_FLOAT:
        return np.nan
    rest = abs(x) % divisor
    return -rest if x < 0.0 else rest


@inline
def to_int(x):
    """Convert a number to a 32-bit integer as Java does: truncate and saturate; NaN becomes 0."""
    if x != x:
        return 0
    if x >= 2147483647.0:
        return INT_MAX
    if x <= -2147483648.0:
        return INT_MIN
    return int(x)


@inline
def ordered_sum(numbers):
    """Return the sum of a (n,) array, added from the first to the last, float64; 0.0 if empty."""
    added = np.float64(0.0)
    for index in range(numbers.shape[0]):
        added += np.float64(numbers[index])
    return added


@inline
def mean(numbers):
    """Return the mean of a (n,) array, added in order, float64; NaN if empty."""
    count = numbers.shape[0]
    return ordered_sum(numbers) / count if count > 0 else np.nan


@inline
def norm(vector):
    """Return the Euclidean length of a (n,) array, squares added in order, float64."""
    squares = np.float64(0.0)
    for index in range(vector.shape[0]):
        squares += np.float64(vector[index]) * np.float64(vector[index])
    return sqrt(squares)


@inline
def distances(points, others):
    """Return the distance of each point of the plane to each of the others.

    Args:
        points: (n, 2): x and y, in any unit.
        others: (m, 2), in the same unit.

    Returns:
        a new (n, m) float64 array, in that unit.
    """
    found = np.empty((points.shape[0], others.shape[0]))
    for point in range(points.shape[0]):
        for other in range(others.shape[0]):
            dx = np.float64(others[other, 0]) - np.float64(points[point, 0])
            dy = np.float64(others[other, 1]) - np.float64(points[point, 1])
            found[point, other] = sqrt(dx * dx + dy * dy)
    return found
