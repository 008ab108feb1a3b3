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
                "arena-consensus generations=20",
                "arena-dispersion",
                "arena-foraging generations=20",
            )
        ),
        *(
            pytest.param(name, marks=pytest.mark.thorough)
            for name in ("arena-consensus", "arena-foraging")
        ),
    ],
)
def test_the_example_evolves_the_recorded_champion_bit_for_bit(example: str) -> None:
    """Other tests show what the recorded champions can do."""
    assert champions.evolve(example) == champions.champion(example)
