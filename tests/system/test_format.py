"""Counts, sizes and durations for people."""

import pytest

from zswarm.system.format import duration, plural, size


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0, "0 s"),
        (3e-5, "30 us"),
        (0.00123, "1.2 ms"),
        (1, "1 s"),
        (119, "119 s"),
        (300, "5 min"),
        (7300, "2 h"),
        (864_000, "10 days"),
    ],
)
def test_durations_have_two_figures_and_a_familiar_unit(value: float, text: str) -> None:
    assert duration(value) == text


@pytest.mark.parametrize(
    ("value", "text"),
    [(12, "12 bytes"), (1234, "1.23 kB"), (2_780_000, "2.78 MB"), (5e12, "5 TB")],
)
def test_sizes_have_three_figures_and_a_familiar_unit(value: float, text: str) -> None:
    assert size(value) == text


@pytest.mark.parametrize(
    ("count", "text"), [(0, "0 slots"), (1, "1 slot"), (1234, "1,234 slots")]
)
def test_nouns_follow_their_count(count: int, text: str) -> None:
    assert plural(count, "slot") == text
