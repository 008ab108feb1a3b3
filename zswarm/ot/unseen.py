"""A champion on trials whose seeds evolution never uses, by itself or against another one."""

from typing import NamedTuple

import numpy as np

from zswarm import evaluate
from zswarm.controller import Controller
from zswarm.draws import derive_seed
from zswarm.errors import ConfigError
from zswarm.protocol.codec import clean

CHUNK = 500  # trials
UNSEEN = "unseen"  # purpose of the seeds


class Played(NamedTuple):
    """What a champion did."""

    results: np.ndarray  # (trials, participants) float64: fitness of the champion, then of those that it played against
    metrics: np.ndarray  # (trials, metrics) float64
    metric_names: tuple[str, ...]

    @property
    def fitness(self) -> np.ndarray:
        """(trials,) float64, the champion's."""
        return self.results[:, 0]

    def all_the_same(self) -> bool:
        """Whether several trials had the same fitness and metrics, as where nothing depends on the seed."""
        numbers = np.column_stack([self.results, self.metrics])
        return len(numbers) > 1 and np.array_equal(numbers, np.broadcast_to(numbers[0], numbers.shape), equal_nan=True)

    def fitness_summary(self) -> dict[str, float]:
        """Mean and quartiles."""
        low, median, high = np.percentile(self.fitness, (25, 50, 75)).tolist()
        return {"mean": float(self.fitness.mean()), "q25": low, "median": median, "q75": high}

    def metric_means(self) -> dict[str, float]:
        """The mean of each metric."""
        return dict(zip(self.metric_names, self.metrics.mean(axis=0).tolist(), strict=True))

    def score(self) -> dict[str, int]:
        """Trials that it won, tied and lost against the best of the others; whoever failed lost."""
        own, others = (np.nan_to_num(part, nan=-np.inf) for part in (self.fitness, self.results[:, 1:].max(axis=1)))
        won, tied = int((own > others).sum()), int((own == others).sum())
        return {"won": won, "tied": tied, "lost": len(own) - won - tied}


def play(controller: Controller, trials: int, seed: int, against: Controller | None = None) -> Played:
    """Play a champion on this machine.

    Where several participants play, it has each side in turn, and ``against``, or it itself, has all the others.

    Raises:
        ConfigError: it does not fit what it names, its simulator raises, or the two cannot play each other.
    """
    simulator, network = evaluate.build(
        controller.simulator,
        controller.simulator_settings,
        controller.representation,
        controller.representation_settings,
    )
    if against is not None:
        _check_match(controller, against, simulator.participants)
    genomes = [controller.genome, (against or controller).genome]
    seeds = np.array([trial_seed(seed, trial) for trial in range(trials)], np.uint64)
    sides = np.arange(trials) % simulator.participants  # of the champion
    places = (np.arange(simulator.participants) - sides[:, None]) % simulator.participants  # 0 where it is
    participants = np.minimum(places, 1)
    parts = []
    for begin in range(0, trials, CHUNK):  # Ctrl-C is heard between two
        part = slice(begin, begin + CHUNK)
        try:
            parts.append(evaluate.evaluate(simulator, network, genomes, participants[part], seeds[part]))
        except ValueError as error:
            raise ConfigError(f"the champion does not fit its network: {error}") from None
        if parts[-1].error:
            raise ConfigError(f"the simulator failed: {parts[-1].error}")
    told = np.concatenate([outcomes.fitness for outcomes in parts])
    results = np.empty_like(told)
    results[np.arange(trials)[:, None], places] = told
    return Played(results, np.concatenate([outcomes.metrics for outcomes in parts]), tuple(simulator.metrics))


def _check_match(one: Controller, other: Controller, participants: int) -> None:
    """Whether two play the same game with the same kind of network."""
    if participants == 1:
        raise ConfigError(f"{clean(one.simulator)} is played by one participant: --against is for games")
    for what in ("simulator", "simulator_settings", "representation", "representation_settings"):
        if getattr(one, what) != getattr(other, what):
            raise ConfigError(f"the two champions cannot play each other: not the same {what.replace('_', ' ')}")


def trial_seed(seed: int, trial: int) -> int:
    """The seed of an unseen trial."""
    return derive_seed(seed, UNSEEN, trial)
