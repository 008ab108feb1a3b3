"""The examples of the arena evolve the champions that are recorded of them."""

import pytest

from tests.sims import champions


@pytest.mark.long
@pytest.mark.parametrize("task", ["aggregation", "consensus", "dispersion", "foraging"])
def test_the_example_evolves_the_recorded_champion_bit_for_bit(task: str) -> None:
    """Other tests show what the recorded champions can do."""
    example = f"arena-{task}"
    assert champions.evolve(example) == champions.champion(example)
