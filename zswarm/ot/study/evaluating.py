"""Play the champions of many runs on held-out seeds, on this machine and on servers."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from zswarm.errors import ConfigError
from zswarm.ot.analysis import measure
from zswarm.ot.analysis.measure import Evaluated
from zswarm.ot.cluster.connection import Connection
from zswarm.ot.problem import Problem
from zswarm.ot.record.reader import Run
from zswarm.ot.replay.held_out import other_code, trial_seed


def evaluate(
    groups: Mapping[str, Sequence[Run]],
    connection: Connection,
    trials: int,
    seed: int,
    say: Callable[[str], None],
) -> dict[str, list[Run]]:
    """Evaluate the champions of all finished runs, all on the same seeds, and keep the results.

    Returns:
        The runs that were evaluated, by group.

    Raises:
        ConfigError: no run is finished, or candidates play each other.
        EvaluationError: trials cannot be evaluated.
    """
    seeds = [trial_seed(seed, trial) for trial in range(trials)]
    done: dict[str, list[Run]] = {}
    for group, runs in groups.items():
        finished = [run for run in runs if run.finished]
        if not finished:
            continue
        problem = Problem(finished[0].experiment)
        if problem.simulator.participants > 1:
            raise ConfigError(
                f"{group}: its candidates play each other; zswarm-ot evaluate RUN --against RUN"
            )
        say(f"{group}: {len(finished)} champions, {trials:,} trials each")
        if note := other_code(finished[0]):
            say(f"{group}: {note}")
        genomes = [_genome(run) for run in finished]
        found = connection.outcomes(problem, genomes, seeds=seeds)
        for at, run in enumerate(finished):
            metrics = {name: column[at] for name, column in found.metrics.items()}
            measure.save(run, Evaluated(seed, np.asarray(found.fitness[at]), metrics))
        done[group] = finished
    if not done:
        raise ConfigError("no run is finished: there is no champion to evaluate")
    return done


def _genome(run: Run) -> bytes:
    champion = run.champion()
    if champion is None:
        raise ConfigError(f"{run.shown}: it has no champion")
    return champion.genome


def summary(group: str, found: Sequence[tuple[Run, Evaluated]]) -> dict[str, Any]:
    """Return medians and quartiles of the runs' means, for programs."""
    means = np.array([one.fitness.mean() for _, one in found])
    low, median, high = np.percentile(means, (25, 50, 75)).tolist()
    metrics = {
        name: float(np.median([one.metrics[name].mean() for _, one in found]))
        for name in found[0][1].metrics
    }
    spread = {"q25": low, "median": median, "q75": high}
    return {"setting": group, "runs": len(found), **spread, "metrics": metrics}


def rows(
    loaded: Mapping[str, Sequence[tuple[Run, Evaluated]]],
) -> tuple[list[str], list[list[Any]]]:
    """Return a tidy table: a row for each trial of each champion."""
    metrics = list(
        dict.fromkeys(
            name for found in loaded.values() for _, one in found for name in one.metrics
        )
    )
    made = [
        [
            group,
            run.name,
            run.experiment.seed,
            trial,
            float(one.fitness[trial]),
            *(
                float(one.metrics[name][trial]) if name in one.metrics else None
                for name in metrics
            ),
        ]
        for group, found in loaded.items()
        for run, one in found
        for trial in range(len(one.fitness))
    ]
    return ["group", "run", "seed", "trial", "fitness", *metrics], made
