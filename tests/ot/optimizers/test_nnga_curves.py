"""NNGA learns as fast as FREVO: compared with its recorded learning curves."""

import json

import numpy as np
import pytest

from tests.repository import REPOSITORY
from zswarm.evaluate import evaluate
from zswarm.nets.fully_meshed import FullyMeshed, FullyMeshedSettings
from zswarm.ot.optimizers.nnga import NNGA, NNGASettings
from zswarm.sims.emergency_exit import EmergencyExit, EmergencyExitSettings

CURVES = json.loads((REPOSITORY / "tests" / "golden" / "nnga_curves.json").read_text())


def learning_curve(
    simulator: EmergencyExit, trials: int, seed: int, generations: int
) -> list[float]:
    network = FullyMeshed(FullyMeshedSettings(), simulator.inputs, simulator.outputs)
    optimizer = NNGA(NNGASettings(), network, seed)
    curve = []
    for _ in range(generations + 1):
        genomes = optimizer.ask()
        participants = np.repeat(np.arange(len(genomes)), trials).reshape(-1, 1)
        seeds = np.tile(np.array(simulator.fixed_seeds(trials), np.uint64), len(genomes))
        outcomes = evaluate(simulator, network, genomes, participants, seeds)
        optimizer.tell(
            np.cumsum(outcomes.fitness.reshape(len(genomes), trials), axis=1)[:, -1]
        )
        curve.append(optimizer.best()[1])
    return curve


@pytest.mark.long
@pytest.mark.parametrize(
    ("field", "trials", "golden"),
    [
        ("stadium", 1, "stadium"),
        ("random", 10, "random_fields_10"),
    ],
)
def test_the_median_of_runs_is_not_below_frevos_lower_quartile(
    field: str, trials: int, golden: str
) -> None:
    """This holds for ten runs, and in the first 100 generations for five of them."""
    simulator = EmergencyExit(EmergencyExitSettings(field=field))
    curves = np.array(
        [learning_curve(simulator, trials, seed, 199) for seed in range(10)]
    )
    for seeds, generation in ((5, 50), (5, 100), (10, 50), (10, 100), (10, 199)):
        median = float(np.median(curves[:seeds, generation]))
        assert median >= CURVES[golden]["q25"][generation], (
            f"generation {generation}: median of {seeds} seeds {median}"
        )
