"""The examples of the arena evolve the champions that are recorded of them."""

import pytest

from tests.sims import champions


@pytest.mark.parametrize(
    "example",
    [
        *(
            pytest.param(name, marks=pytest.mark.long)
            for name in (
                "arena-aggregation",
                "arena-consensus",
                "arena-dispersion",
                "arena-foraging generations=60",  # as many as the others
            )
        ),
        pytest.param("arena-foraging", marks=pytest.mark.thorough),
    ],
)
def test_the_example_evolves_the_recorded_champion_bit_for_bit(example: str) -> None:
    """Other tests show what the recorded champions can do."""
    assert champions.evolve(example) == champions.champion(example)
