"""Draw random numbers by zswarm's own specification, so that no library version changes a run.

The generator is SplitMix64 (G. Steele, D. Lea, C. Flood, "Fast Splittable Pseudorandom Number
Generators", OOPSLA 2014): word *i* of a stream is ``mix(seed + (i + 1) * GAMMA)``. It counts, so a
whole array is drawn at once and a stream's state is two integers. Nothing draws from a shared
generator: every purpose has a stream with a separate seed.
"""

# mypy: disable-error-code=no-untyped-def
# because numba infers the types of kernels.

import hashlib
import struct
from typing import Any

import numpy as np

from zswarm.kernels.jit import inline, sqrt
from zswarm.kernels.portable import log, log_of

GAMMA = 0x9E3779B97F4A7C15
MIX_1, MIX_2 = 0xBF58476D1CE4E5B9, 0x94D049BB133111EB
MASK_64 = (1 << 64) - 1
UNIT = 2.0**-53
JAVA_FACTOR, JAVA_TERM, JAVA_MASK = 0x5DEECE66D, 0xB, (1 << 48) - 1
HALF_UNIT = 2.0**-52
AHEAD = 128  # words made at once for integers that are drawn one by one

# The normal distribution's quantile function by quotients of polynomials (M. J. Wichura, "Algorithm
# AS 241", Applied Statistics 37(3), 1988, PPND16), within 1e-15 of its value: lowest power first.
CENTRE = (
    (
        3.3871328727963666080e0,
        1.3314166789178437745e2,
        1.9715909503065514427e3,
        1.3731693765509461125e4,
        4.5921953931549871457e4,
        6.7265770927008700853e4,
        3.3430575583588128105e4,
        2.5090809287301226727e3,
    ),
    (
        1.0,
        4.2313330701600911252e1,
        6.8718700749205790830e2,
        5.3941960214247511077e3,
        2.1213794301586595867e4,
        3.9307895800092710610e4,
        2.8729085735721942674e4,
        5.2264952788528545610e3,
    ),
)
TAIL = (
    (
        1.42343711074968357734e0,
        4.63033784615654529590e0,
        5.76949722146069140550e0,
        3.64784832476320460504e0,
        1.27045825245236838258e0,
        2.41780725177450611770e-1,
        2.27238449892691845833e-2,
        7.74545014278341407640e-4,
    ),
    (
        1.0,
        2.05319162663775882187e0,
        1.67638483018380384940e0,
        6.89767334985100004550e-1,
        1.48103976427480074590e-1,
        1.51986665636164571966e-2,
        5.47593808499534494600e-4,
        1.05075007164441684324e-9,
    ),
)
FAR_TAIL = (
    (
        6.65790464350110377720e0,
        5.46378491116411436990e0,
        1.78482653991729133580e0,
        2.96560571828504891230e-1,
        2.65321895265761230930e-2,
        1.24266094738807843860e-3,
        2.71155556874348757815e-5,
        2.01033439929228813265e-7,
    ),
    (
        1.0,
        5.99832206555887937690e-1,
        1.36929880922735805310e-1,
        1.48753612908506148525e-2,
        7.86869131145613259100e-4,
        1.84631831751005468180e-5,
        1.42151175831644588870e-7,
        2.04426310338993978564e-15,
    ),
)


def derive_seed(run_seed: int, purpose: str, *indices: int) -> int:
    """Return a 64-bit seed for a purpose within a run.

    Args:
        run_seed: in 0..2**64-1, as are the indices.
        purpose: what the seed is for.
        indices: for example generation and trial.
    """
    text = struct.pack(f"<Q{len(indices)}Q", run_seed, *indices) + purpose.encode()
    return int.from_bytes(hashlib.blake2b(text, digest_size=8).digest(), "little")


class Stream:
    """One stream of random numbers; ``seed`` and ``position`` are its whole state."""

    __slots__ = ("_ahead", "_ahead_from", "position", "seed")

    def __init__(self, seed: int, position: int = 0) -> None:
        self.seed = seed & MASK_64
        self.position = position
        # Upper halves of the words from the position ``_ahead_from`` on.
        self._ahead: list[int] = []
        self._ahead_from = 0

    def words(self, count: int) -> np.ndarray:
        """Draw (count,) uint64."""
        x = np.arange(self.position + 1, self.position + count + 1, dtype=np.uint64)
        self.position += count
        x *= np.uint64(GAMMA)
        x += np.uint64(self.seed)
        x ^= x >> np.uint64(30)
        x *= np.uint64(MIX_1)
        x ^= x >> np.uint64(27)
        x *= np.uint64(MIX_2)
        x ^= x >> np.uint64(31)
        return x

    def uniform(self, low: float, high: float, count: int) -> np.ndarray:
        """Draw (count,) float64 in [low, high), each from the upper 53 bits of a word."""
        return low + (high - low) * ((self.words(count) >> np.uint64(11)) * UNIT)

    def normal(self, mean: float, deviation: float, count: int) -> np.ndarray:
        """Draw (count,) float64, normally distributed.

        The upper 52 bits of a word choose one of 2^52 equal parts of 0..1; the number is the
        quantile of its middle.
        """
        return mean + deviation * _quantiles(
            ((self.words(count) >> np.uint64(12)) + 0.5) * HALF_UNIT
        )

    def integers(self, bound: int, count: int) -> np.ndarray:
        """Draw (count,) int64 in 0..bound-1, bound < 2**32.

        The upper 32 bits of a word are multiplied by bound and shifted right by 32 bits.
        """
        return (
            ((self.words(count) >> np.uint64(32)) * np.uint64(bound)) >> np.uint64(32)
        ).astype(np.int64)

    def integer(self, bound: int) -> int:
        """Draw one integer in 0..bound-1, the same as ``integers`` but many times faster."""
        index = self.position - self._ahead_from
        if not 0 <= index < len(self._ahead):
            self._ahead = (
                Stream(self.seed, self.position).words(AHEAD) >> np.uint64(32)
            ).tolist()
            self._ahead_from, index = self.position, 0
        self.position += 1
        return (self._ahead[index] * bound) >> 32


def _quantiles(p: np.ndarray) -> np.ndarray:
    """Return quantiles of the standard normal distribution; p is in 2^-53..1 - 2^-53."""
    q = p - 0.5
    values: np.ndarray = q * quotient(CENTRE, 0.180625 - q * q)
    outer = np.flatnonzero(np.abs(q) > 0.425)
    r: np.ndarray = np.sqrt(-log(0.5 - np.abs(q[outer])))
    tails = np.where(r <= 5.0, quotient(TAIL, r - 1.6), quotient(FAR_TAIL, r - 5.0))
    values[outer] = np.where(q[outer] < 0.0, -tails, tails)
    return values


def quotient(polynomials: Any, x: Any) -> Any:
    """Return the quotient of two polynomials, evaluated at x, also of arrays."""
    a, b = polynomials
    above = ((a[7] * x + a[6]) * x + a[5]) * x + a[4]
    above = (((above * x + a[3]) * x + a[2]) * x + a[1]) * x + a[0]
    below = ((b[7] * x + b[6]) * x + b[5]) * x + b[4]
    below = (((below * x + b[3]) * x + b[2]) * x + b[1]) * x + b[0]
    return above / below


compiled_quotient = inline(counts=False)(
    quotient
)  # for kernels; arrays do not need the compiler


@inline
def draw_word(state):
    """Draw as ``Stream.words``; ``state`` is (1,) uint64, initially the seed of the stream."""
    state[0] += np.uint64(GAMMA)
    return scrambled(state[0])


@inline
def scrambled(word):
    """Return the word of a state."""
    word = (word ^ (word >> np.uint64(30))) * np.uint64(MIX_1)
    word = (word ^ (word >> np.uint64(27))) * np.uint64(MIX_2)
    return word ^ (word >> np.uint64(31))


@inline
def draw_integer(state, bound):
    """Draw as ``Stream.integer``."""
    word = draw_word(state)
    return np.int64(((word >> np.uint64(32)) * np.uint64(bound)) >> np.uint64(32))


@inline
def draw_uniform(state):
    """Draw as ``Stream.uniform`` from 0 to 1."""
    return np.float64(draw_word(state) >> np.uint64(11)) * UNIT


@inline
def draw_uniforms(state, numbers, stride, columns):
    """Draw as ``draw_uniform``: row ``r`` and column ``c`` is number ``stride c + r``.

    Args:
        numbers: (stride, at least columns) float64.
        columns: to be drawn.
    """
    for row in range(stride):
        for column in range(columns):
            ahead = np.uint64(stride * column + row + 1) * np.uint64(GAMMA)
            word = scrambled(state[0] + ahead) >> np.uint64(11)
            numbers[row, column] = np.float64(word) * UNIT


@inline
def skip(state, words):
    """Skip a number of words."""
    state[0] += np.uint64(words) * np.uint64(GAMMA)


@inline
def draw_normal(state):
    """Draw as ``Stream.normal`` with mean 0 and deviation 1."""
    p = (np.float64(draw_word(state) >> np.uint64(12)) + 0.5) * HALF_UNIT
    q = p - 0.5
    if abs(q) <= 0.425:
        return q * compiled_quotient(CENTRE, 0.180625 - q * q)
    r = sqrt(-log_of(0.5 - abs(q)))
    if r <= 5.0:
        tail = compiled_quotient(TAIL, r - 1.6)
    else:
        tail = compiled_quotient(FAR_TAIL, r - 5.0)
    return -tail if q < 0.0 else tail


# ---- Java's ``Random``, a 48-bit linear congruential generator, which FREVO's problems use ----


@inline
def start_java(state, seed):
    """Seed as ``new Random(seed)`` does; ``state`` is (1,) uint64, ``seed`` uint64."""
    state[0] = (seed ^ np.uint64(JAVA_FACTOR)) & np.uint64(JAVA_MASK)


@inline
def skip_java(state, words):
    """Advance by a number of words, uint64, by repeated squaring of x -> factor x + term."""
    factor, term = np.uint64(JAVA_FACTOR), np.uint64(JAVA_TERM)
    for _ in range(48):
        if words & np.uint64(1):
            state[0] = (state[0] * factor + term) & np.uint64(JAVA_MASK)
        term = (factor + np.uint64(1)) * term
        factor = factor * factor
        words = words >> np.uint64(1)


@inline
def draw_java(state, bound):
    """Draw as ``nextInt(bound)``: from the upper 31 bits of a word, by rejection."""
    while True:
        state[0] = (state[0] * np.uint64(JAVA_FACTOR) + np.uint64(JAVA_TERM)) & np.uint64(
            JAVA_MASK
        )
        bits = np.int64(state[0] >> np.uint64(17))
        if bound & (bound - 1) == 0:
            return (bound * bits) >> 31
        value = bits % bound
        if bits - value + (bound - 1) < 2147483648:
            return value
