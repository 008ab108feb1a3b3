"""A network with memory finds the light where one without drives in an arc."""

import numpy as np
import pytest

from zswarm import evaluate, experiment
from zswarm.experiment import Experiment
from zswarm.ot.build import build

FORGETFUL = 'representation={kind = "feed-forward", hidden = [4], activation = "tanh"}'


def best_per_trial(complete: Experiment) -> float:
    """Return the best fitness per trial of a run that is played here."""
    parts = build(complete)
    problem, optimizer = parts.problem, parts.optimizer
    for generation in range(complete.generations):
        work = problem.workload(optimizer.ask(), generation)
        outcomes = evaluate.evaluate(
            problem.simulator,
            problem.representation,
            work.genomes,
            work.participants,
            work.seeds,
        )
        optimizer.tell(
            np.cumsum(
                outcomes.fitness[:, 0].reshape(-1, complete.problem.trials), axis=1
            )[:, -1]
        )
    return optimizer.best()[1] / complete.problem.trials


def found(seed: int, *overrides: str) -> float:
    loaded = experiment.load(
        experiment.find("light-memory"), [f"seed={seed}", *overrides]
    )
    return best_per_trial(experiment.complete(loaded, "light-memory"))


@pytest.mark.long
@pytest.mark.parametrize(
    ("seed", "remembering", "forgetful"),
    [(1, 0.82, 0.75), (2, 0.89, 0.74), (3, 0.88, 0.74), (4, 0.72, 0.73)],
)
def test_a_network_with_memory_finds_more_lights_with_most_seeds(
    seed: int, remembering: float, forgetful: float
) -> None:
    """The numbers are those of the example's comment."""
    assert found(seed) == pytest.approx(remembering, abs=0.006)
    assert found(seed, FORGETFUL) == pytest.approx(forgetful, abs=0.006)
