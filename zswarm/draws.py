"""Random numbers of our own specification, so that a run means the same with every version of every library.

The generator is SplitMix64 (G. Steele, D. Lea, C. Flood, "Fast Splittable Pseudorandom Number Generators", OOPSLA 2014):
word *i* of a stream is ``mix(seed + (i + 1) * GAMMA)``. It counts, so a whole array is drawn at once and a stream's
state is two integers. Nothing draws from a shared generator: every purpose has a stream with a seed of its own.
"""

import hashlib
import struct

import numpy as np

from zswarm.jit import inline

GAMMA = 0x9E3779B97F4A7C15
MIX_1, MIX_2 = 0xBF58476D1CE4E5B9, 0x94D049BB133111EB
MASK_64 = (1 << 64) - 1
UNIT = 2.0**-53
JAVA_FACTOR, JAVA_TERM, JAVA_MASK = 0x5DEECE66D, 0xB, (1 << 48) - 1
AHEAD = 128  # words made at once for integers that are drawn one by one


def derive_seed(run_seed: int, purpose: str, *indices: int) -> int:
    """A 64-bit seed from a run's seed, what it is for, and indices such as generation and trial; all in 0..2**64-1."""
    text = struct.pack(f"<Q{len(indices)}Q", run_seed, *indices) + purpose.encode()
    return int.from_bytes(hashlib.blake2b(text, digest_size=8).digest(), "little")


class Stream:
    """One stream of random numbers; ``seed`` and ``position`` are its whole state."""

    __slots__ = ("_ahead", "_ahead_from", "position", "seed")

    def __init__(self, seed: int, position: int = 0) -> None:
        self.seed = seed & MASK_64
        self.position = position
        self._ahead: list[int] = []  # upper halves of the words from the position ``_ahead_from`` on
        self._ahead_from = 0

    def words(self, count: int) -> np.ndarray:
        """(count,) uint64."""
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
        """(count,) float64 in [low, high), from the upper 53 bits of a word."""
        return low + (high - low) * ((self.words(count) >> np.uint64(11)) * UNIT)

    def integers(self, bound: int, count: int) -> np.ndarray:
        """(count,) int64 in 0..bound-1 (bound < 2**32), the upper 32 bits of a word times bound, shifted back."""
        return (((self.words(count) >> np.uint64(32)) * np.uint64(bound)) >> np.uint64(32)).astype(np.int64)

    def integer(self, bound: int) -> int:
        """One integer in 0..bound-1: what ``integers`` draws, many times faster for one."""
        index = self.position - self._ahead_from
        if not 0 <= index < len(self._ahead):
            self._ahead = (Stream(self.seed, self.position).words(AHEAD) >> np.uint64(32)).tolist()
            self._ahead_from, index = self.position, 0
        self.position += 1
        return (self._ahead[index] * bound) >> 32


@inline
def draw_integer(state, bound):  # type: ignore[no-untyped-def]  # compiled
    """``Stream.integer`` inside a kernel; ``state`` is (1,) uint64, a stream's seed at first."""
    state[0] += np.uint64(GAMMA)
    word = state[0]
    word = (word ^ (word >> np.uint64(30))) * np.uint64(MIX_1)
    word = (word ^ (word >> np.uint64(27))) * np.uint64(MIX_2)
    word = word ^ (word >> np.uint64(31))
    return np.int64(((word >> np.uint64(32)) * np.uint64(bound)) >> np.uint64(32))


# ---- Java's ``Random``, a 48-bit linear congruential generator: problems of FREVO's are laid out by it ----


@inline
def start_java(state, seed):  # type: ignore[no-untyped-def]  # compiled
    """``new Random(seed)``; ``state`` is (1,) uint64, ``seed`` uint64."""
    state[0] = (seed ^ np.uint64(JAVA_FACTOR)) & np.uint64(JAVA_MASK)


@inline
def skip_java(state, words):  # type: ignore[no-untyped-def]  # compiled
    """Go on by so many words, uint64: the generator's step, x -> factor x + term, is squared again and again."""
    factor, term = np.uint64(JAVA_FACTOR), np.uint64(JAVA_TERM)
    for _ in range(48):
        if words & np.uint64(1):
            state[0] = (state[0] * factor + term) & np.uint64(JAVA_MASK)
        term = (factor + np.uint64(1)) * term
        factor = factor * factor
        words = words >> np.uint64(1)


@inline
def draw_java(state, bound):  # type: ignore[no-untyped-def]  # compiled
    """``nextInt(bound)``: the upper 31 bits of a word, or of more of them."""
    while True:
        state[0] = (state[0] * np.uint64(JAVA_FACTOR) + np.uint64(JAVA_TERM)) & np.uint64(JAVA_MASK)
        bits = np.int64(state[0] >> np.uint64(17))
        if bound & (bound - 1) == 0:
            return (bound * bits) >> 31
        value = bits % bound
        if bits - value + (bound - 1) < 2147483648:
            return value
