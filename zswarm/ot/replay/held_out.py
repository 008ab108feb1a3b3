"""Play a champion on held-out seeds, which evolution never uses, alone or against another one."""

from typing import NamedTuple

import numpy as np

from zswarm import evaluate
from zswarm.champion.controller import Controller
from zswarm.errors import ConfigError
from zswarm.kernels.random import derive_seed
from zswarm.ot.record.reader import Run
from zswarm.plugins.version_hash import version_hash
from zswarm.system.text import clean

CHUNK = 500  # trials
PURPOSE = "unseen"  # of the seeds


class HeldOutResult(NamedTuple):
    """The trials of a champion."""

    # (trials, participants) float64 fitness: the champion's, then the others'.
    results: np.ndarray
    metrics: np.ndarray  # (trials, metrics) float64
    metric_names: tuple[str, ...]

    @property
    def fitness(self) -> np.ndarray:
        """(trials,) float64, the champion's."""
        return self.results[:, 0]

    def all_the_same(self) -> bool:
        """Return whether all trials are equal, as if nothing depends on the seed."""
        numbers = np.column_stack([self.results, self.metrics])
        first = np.broadcast_to(numbers[0], numbers.shape)
        return len(numbers) > 1 and np.array_equal(numbers, first, equal_nan=True)

    def fitness_summary(self) -> dict[str, float]:
        """Return mean and quartiles."""
        low, median, high = np.percentile(self.fitness, (25, 50, 75)).tolist()
        return {
            "mean": float(self.fitness.mean()),
            "q25": low,
            "median": median,
            "q75": high,
        }

    def metric_means(self) -> dict[str, float]:
        """Return the mean of each metric."""
        return dict(
            zip(self.metric_names, self.metrics.mean(axis=0).tolist(), strict=True)
        )

    def score(self) -> dict[str, int]:
        """Count trials won, tied and lost against the best of the others; NaN loses."""
        own = np.nan_to_num(self.fitness, nan=-np.inf)
        others = np.nan_to_num(self.results[:, 1:].max(axis=1), nan=-np.inf)
        won, tied = int((own > others).sum()), int((own == others).sum())
        return {"won": won, "tied": tied, "lost": len(own) - won - tied}


def play(
    controller: Controller, trials: int, seed: int, against: Controller | None = None
) -> HeldOutResult:
    """Play a champion on this machine.

    In a game it takes each side in turn; all others are ``against``, by default the champion too.

    Raises:
        ConfigError: it does not fit what it names, its simulator raises, or the two cannot play
            each other.
    """
    simulator, network = evaluate.build(
        controller.simulator,
        controller.simulator_settings,
        controller.representation,
        controller.representation_settings,
    )
    count = simulator.participants
    if against is not None:
        _check_match(controller, against, count)
    genomes = [controller.genome, (against or controller).genome]
    seeds = np.array([trial_seed(seed, trial) for trial in range(trials)], np.uint64)
    places = (np.arange(count) - np.arange(trials)[:, None]) % count  # 0: the champion's
    parts = []
    for begin in range(0, trials, CHUNK):  # Ctrl-C works between two chunks
        part = slice(begin, begin + CHUNK)
        players = np.minimum(places[part], 1)
        try:
            outcomes = evaluate.evaluate(
                simulator, network, genomes, players, seeds[part]
            )
        except ValueError as error:
            raise ConfigError(f"the champion does not fit its network: {error}") from None
        if outcomes.error:
            raise ConfigError(f"the simulator failed: {outcomes.error}")
        parts.append(outcomes)
    fitness = np.concatenate([outcomes.fitness for outcomes in parts])
    metrics = np.concatenate([outcomes.metrics for outcomes in parts])
    results = np.empty_like(fitness)
    results[np.arange(trials)[:, None], places] = fitness
    return HeldOutResult(results, metrics, tuple(simulator.metrics))


def other_code(run: Run) -> str:
    """Return a sentence if the code has changed since a run, else ""."""
    complete, theirs = run.experiment, run.meta.get("version_hash")
    try:
        ours = version_hash(complete.problem.simulator, complete.representation.kind)
    except ConfigError:  # it is not installed
        return ""
    if theirs in (None, "", ours):
        return ""
    return (
        f"The code has changed since this run (version hash {theirs}, here {ours}): its champion "
        "may do other things now than it did then."
    )


def trial_seed(seed: int, trial: int) -> int:
    """Return the seed of a held-out trial."""
    return derive_seed(seed, PURPOSE, trial)


def _check_match(one: Controller, other: Controller, participants: int) -> None:
    if participants == 1:
        raise ConfigError(
            f"{clean(one.simulator)} is played by one participant: --against is for games"
        )
    for key in (
        "simulator",
        "simulator_settings",
        "representation",
        "representation_settings",
    ):
        if getattr(one, key) != getattr(other, key):
            raise ConfigError(
                f"the two champions cannot play each other: not the same {key.replace('_', ' ')}"
            )
