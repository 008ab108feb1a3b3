"""Check SplitMix64, drawn one by one and in bulk, and the separate stream of each purpose."""

import hashlib
from statistics import NormalDist

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from zswarm.kernels import random as draws
from zswarm.kernels.random import AHEAD, Stream, derive_seed, draw_integer

KNOWN = [
    6457827717110365317,
    3203168211198807973,
    9817491932198370423,
    4593380528125082431,
    16408922859458223821,
]
MASK = 2**64 - 1


def reference(seed: int, count: int) -> list[int]:
    """SplitMix64 as its authors wrote it, with a state that is added to."""
    words = []
    for _ in range(count):
        seed = (seed + 0x9E3779B97F4A7C15) & MASK
        word = seed
        word = ((word ^ (word >> 30)) * 0xBF58476D1CE4E5B9) & MASK
        word = ((word ^ (word >> 27)) * 0x94D049BB133111EB) & MASK
        words.append(word ^ (word >> 31))
    return words


def test_the_words_equal_the_published_ones() -> None:
    assert Stream(1234567).words(5).tolist() == KNOWN


@given(st.integers(0, MASK), st.integers(0, 50))
def test_the_words_equal_those_of_the_reference(seed: int, count: int) -> None:
    assert Stream(seed).words(count).tolist() == reference(seed, count)


@given(st.integers(0, MASK), st.lists(st.integers(0, 9)))
def test_a_stream_gives_the_same_words_whole_or_in_parts(
    seed: int, parts: list[int]
) -> None:
    stream = Stream(seed)
    drawn = [word for part in parts for word in stream.words(part).tolist()]
    assert drawn == Stream(seed).words(sum(parts)).tolist()
    assert stream.position == sum(parts)


def test_seed_and_position_are_the_whole_state() -> None:
    stream = Stream(99)
    stream.uniform(0, 1, 7)
    assert (
        Stream(stream.seed, stream.position).words(5).tolist() == stream.words(5).tolist()
    )


def test_a_seed_beyond_64_bits_is_truncated() -> None:
    assert Stream(2**64 + 5).words(3).tolist() == Stream(5).words(3).tolist()
    assert Stream(-1).words(3).tolist() == Stream(MASK).words(3).tolist()


def test_uniform_uses_the_upper_53_bits() -> None:
    expected = [-3.0 + 5.0 * ((word >> 11) * 2.0**-53) for word in reference(7, 1000)]
    assert Stream(7).uniform(-3.0, 2.0, 1000).tolist() == expected


def test_uniform_fills_its_range_evenly() -> None:
    numbers = Stream(1).uniform(-3.0, 2.0, 100_000)
    assert numbers.dtype == np.float64
    assert -3.0 <= numbers.min() < -2.999
    assert 1.999 < numbers.max() < 2.0
    shares = np.histogram(numbers, 10, (-3.0, 2.0))[0] / numbers.size
    assert np.allclose(shares, 0.1, atol=0.005)


def test_normal_numbers_are_the_quantiles_of_the_upper_52_bits() -> None:
    """Agree within 1e-15 with the standard library.

    It implements the same algorithm, but takes the logarithm from the C library.
    """
    drawn = Stream(7).normal(0.0, 1.0, 20_000)
    expected = [
        NormalDist().inv_cdf(((word >> 12) + 0.5) * 2.0**-52)
        for word in reference(7, 20_000)
    ]
    assert np.abs(drawn / expected - 1.0).max() < 1e-15
    assert Stream(7).normal(3.0, 2.0, 100).tolist() == (3.0 + 2.0 * drawn[:100]).tolist()


def test_normal_numbers_are_finite_and_symmetric_to_the_last_word() -> None:
    """The quantiles of the outermost parts, and of some just inside."""
    low = 2.0 ** -np.arange(2.0, 54.0)
    quantiles = draws._quantiles(low)
    assert quantiles[-1] == pytest.approx(NormalDist().inv_cdf(2.0**-53), rel=1e-15)
    assert (-draws._quantiles(1.0 - low)).tolist() == quantiles.tolist()
    assert draws._quantiles(np.array([0.5])).tolist() == [0.0]


def test_normal_numbers_have_the_moments_of_their_distribution() -> None:
    numbers = Stream(1).normal(-3.0, 2.0, 400_000)
    standard = (numbers + 3.0) / 2.0
    assert numbers.dtype == np.float64
    assert [(standard**power).mean() for power in (1, 2, 3, 4)] == pytest.approx(
        [0.0, 1.0, 0.0, 3.0], abs=0.03
    )


def test_normal_numbers_are_the_same_on_every_machine() -> None:
    """Made once: the bits are of + - * / and the square root, and of a logarithm of these."""
    numbers = Stream(9).normal(0.0, 1.0, 10_000)
    assert (
        hashlib.blake2b(numbers.astype("<f8").tobytes(), digest_size=8).hexdigest()
        == "6f6d69b51671b072"
    )


@given(st.integers(1, 2**32 - 1), st.integers(0, MASK))
def test_integers_stay_below_their_bound(bound: int, seed: int) -> None:
    drawn = Stream(seed).integers(bound, 20)
    assert drawn.dtype == np.int64
    assert drawn.tolist() == [(word >> 32) * bound >> 32 for word in reference(seed, 20)]
    assert 0 <= drawn.min() <= drawn.max() < bound


def test_integers_are_drawn_evenly_and_reach_both_ends() -> None:
    drawn = Stream(2).integers(6, 60_000)
    assert np.allclose(np.bincount(drawn, minlength=6) / drawn.size, 1 / 6, atol=0.01)


def test_an_integer_drawn_alone_equals_one_drawn_in_bulk() -> None:
    one_by_one, at_once = Stream(3), Stream(3)
    assert [one_by_one.integer(100) for _ in range(2 * AHEAD + 1)] == at_once.integers(
        100, 2 * AHEAD + 1
    ).tolist()
    assert one_by_one.position == at_once.position


@given(
    st.integers(0, MASK),
    st.lists(st.tuples(st.booleans(), st.integers(0, 2 * AHEAD)), max_size=6),
)
def test_integers_drawn_one_by_one_and_words_share_their_stream(
    seed: int, parts: list[tuple[bool, int]]
) -> None:
    stream, expected = (
        Stream(seed),
        Stream(seed).words(sum(count for _, count in parts)).tolist(),
    )
    for one_by_one, count in parts:
        words, expected = expected[:count], expected[count:]
        if one_by_one:
            assert [stream.integer(1000) for _ in range(count)] == [
                (word >> 32) * 1000 >> 32 for word in words
            ]
        else:
            assert stream.words(count).tolist() == words


@given(st.integers(0, MASK), st.lists(st.integers(1, 2**32 - 1), max_size=10))
def test_a_kernel_draws_the_integers_of_a_stream(seed: int, bounds: list[int]) -> None:
    state, plain_state = np.array([seed], np.uint64), np.array([seed], np.uint64)
    plain = getattr(draw_integer, "py_func", draw_integer)
    stream = Stream(seed)
    for bound in bounds:
        expected = stream.integer(bound)
        assert draw_integer(state, bound) == expected
        with np.errstate(over="ignore"):
            assert plain(plain_state, bound) == expected


def test_uniform_numbers_drawn_ahead_are_those_of_the_stream() -> None:
    """Column by column, also those that are skipped."""
    state, numbers = np.array([5], np.uint64), np.zeros((3, 4))
    with np.errstate(over="ignore"):
        draws.draw_uniforms(state, numbers, 3, numbers.shape[1])
        assert state[0] == 5
        draws.skip(state, 12)
        following = draws.draw_uniform(state)
    expected = Stream(5).uniform(0.0, 1.0, 13)
    assert np.array_equal(numbers.T.reshape(-1), expected[:12])
    assert following == expected[12]


def test_a_derived_seed_depends_on_every_argument() -> None:
    variants = [
        *(
            derive_seed(1, "trial"),
            derive_seed(2, "trial"),
            derive_seed(1, "trials"),
            derive_seed(1, "trial", 0),
        ),
        *(
            derive_seed(1, "trial", 1),
            derive_seed(1, "trial", 0, 0),
            derive_seed(1, "trial", 0, 1),
        ),
        *(
            derive_seed(1, "trial", 1, 0),
            derive_seed(0, "trial", 1),
            derive_seed(1, "nnga", 1),
        ),
    ]
    assert len(set(variants)) == len(variants)
    assert all(0 <= seed <= MASK for seed in variants)
    assert derive_seed(1, "trial", 0, 1) == derive_seed(1, "trial", 0, 1)


def test_derived_seeds_are_the_same_on_every_machine() -> None:
    """Made once: a run of yesterday must find its seeds tomorrow."""
    assert [derive_seed(1, "trial", index) for index in range(3)] == [
        16415958390713302037,
        6108741149737805610,
        18241644707714420726,
    ]


def test_a_seed_can_be_derived_from_any_64_bit_seed() -> None:
    assert derive_seed(MASK, "trial", MASK) != derive_seed(MASK - 1, "trial", MASK)


@pytest.mark.parametrize("neighbour", range(1, 4))
def test_streams_of_neighbouring_derived_seeds_share_nothing(neighbour: int) -> None:
    one, other = (
        Stream(derive_seed(1, "nnga", index)).words(1000) for index in (0, neighbour)
    )
    assert not set(one.tolist()) & set(other.tolist())
