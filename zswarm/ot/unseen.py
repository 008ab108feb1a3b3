"""A champion on trials whose seeds evolution never uses."""

from typing import NamedTuple

import numpy as np

from zswarm import evaluate
from zswarm.draws import derive_seed
from zswarm.errors import ConfigError
from zswarm.ot.controller import Controller

CHUNK = 500  # trials
UNSEEN = "unseen"  # purpose of the seeds


class Played(NamedTuple):
    """What a champion did."""

    fitness: np.ndarray  # (trials,) float64
    metrics: np.ndarray  # (trials, metrics) float64
    metric_names: tuple[str, ...]

    def all_the_same(self) -> bool:
        """Whether several trials had the same fitness and metrics, as where nothing depends on the seed."""
        numbers = np.column_stack([self.fitness, self.metrics])
        return len(numbers) > 1 and np.array_equal(numbers, np.broadcast_to(numbers[0], numbers.shape), equal_nan=True)

    def fitness_summary(self) -> dict[str, float]:
        """Mean and quartiles."""
        low, median, high = np.percentile(self.fitness, (25, 50, 75)).tolist()
        return {"mean": float(self.fitness.mean()), "q25": low, "median": median, "q75": high}

    def metric_means(self) -> dict[str, float]:
        """The mean of each metric."""
        return dict(zip(self.metric_names, self.metrics.mean(axis=0).tolist(), strict=True))


def play(controller: Controller, trials: int, seed: int) -> Played:
    """Play a champion on this machine; it drives all participants.

    Raises:
        ConfigError: it does not fit what it names, or its simulator raises.
    """
    simulator, network = evaluate.build(
        controller.simulator,
        controller.simulator_settings,
        controller.representation,
        controller.representation_settings,
    )
    seeds = np.array([trial_seed(seed, trial) for trial in range(trials)], np.uint64)
    participants = np.zeros((trials, simulator.participants), np.int64)
    parts = []
    for begin in range(0, trials, CHUNK):  # Ctrl-C is heard between two
        part = slice(begin, begin + CHUNK)
        try:
            parts.append(evaluate.evaluate(simulator, network, [controller.genome], participants[part], seeds[part]))
        except ValueError as error:
            raise ConfigError(f"the champion does not fit its network: {error}") from None
        if parts[-1].error:
            raise ConfigError(f"the simulator raised: {parts[-1].error}")
    fitness = np.concatenate([outcomes.fitness[:, 0] for outcomes in parts])
    return Played(fitness, np.concatenate([outcomes.metrics for outcomes in parts]), tuple(simulator.metrics))


def trial_seed(seed: int, trial: int) -> int:
    """The seed of an unseen trial."""
    return derive_seed(seed, UNSEEN, trial)
