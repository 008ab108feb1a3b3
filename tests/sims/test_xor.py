"""XOR gives what FREVO recorded."""

from typing import Any

import numpy as np
import pytest

from tests.sims.recorded import PROBLEMS, play
from zswarm.sims.xor import XOR, XORSettings


@pytest.mark.parametrize("net", PROBLEMS["xor"], ids=lambda net: f"{net['fitness']:.4f}")
def test_fitness_is_frevos(net: dict[str, Any]) -> None:
    """Bit for bit; also beside other trials, of which eight cases are decided at once."""
    assert play("xor", {}, net, [1]).fitness[0, 0] == net["fitness"]
    assert play("xor", {}, net, [1, 2, 3]).fitness[:, 0].tolist() == [net["fitness"]] * 3


@pytest.mark.parametrize(
    ("said", "fitness", "correct"),
    [
        ([0, 1, 1, 0], 0.0, 4),
        ([0.25, 0.75, 0.75, 0.25], -0.25, 4),
        ([0.5, 0.5, 0.5, 0.5], -0.5, 0),
        ([0, 1, 1, 1], -0.5, 3),
        ([-1, 1, 1, 0], -0.5, 3),
        ([1, 0, 0, 1], -1.0, 0),
    ],
)
def test_fitness_and_metrics_are_those_of_the_data_sheet(
    said: list[float], fitness: float, correct: int
) -> None:
    simulator = XOR(XORSettings())
    turn = simulator.reset(1)
    assert turn.observations.tolist() == [[0, 0], [0, 1], [1, 0], [1, 1]]
    assert simulator.step(np.array(said, np.float32)[:, None]) is None
    outcome = simulator.outcome()
    assert list(outcome.fitness) == [fitness]
    assert str(outcome.fitness[0]) != "-0.0"
    assert dict(zip(simulator.metrics, outcome.metrics, strict=True)) == {
        "correct": correct,
        **dict(
            zip(("output_00", "output_01", "output_10", "output_11"), said, strict=True)
        ),
    }
