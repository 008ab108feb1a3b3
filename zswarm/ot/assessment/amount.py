"""How many trials an assessment has, and how many of a search racing spares: numbers only."""

from zswarm.experiment import Experiment
from zswarm.ot.assessment.race import LEAST

SHARE = 0.1  # of the run's simulations, by default
TRACKED = 100  # seeds of each tracked generation
RACED = 0.7  # of a search's trials, which racing plays: the mean of docs/benchmarks.md


def share(complete: Experiment) -> float:
    """Return the assessment's trials as a share of those of the run."""
    budget = complete.assessment.budget
    return SHARE if budget == "auto" else budget


def budget_of(complete: Experiment, trials: int) -> int:
    """Return the trials of an assessment after a search of some trials; 0: too few for one."""
    budget = int(share(complete) * trials)
    return 0 if budget < LEAST else budget


def played(complete: Experiment) -> float:
    """Return the share of a search's trials that is expected to be played."""
    return RACED if complete.assessment.racing else 1.0


def trials_after(
    complete: Experiment, trials: int, generations: int, *, fit: bool
) -> int:
    """Return how many trials follow a search at most: of the assessment, and of the track.

    Args:
        complete: the experiment.
        trials, generations: of the search.
        fit: whether candidates can be assessed, and trials may differ.
    """
    assessed = budget_of(complete, trials) if fit else 0
    each = complete.assessment.track
    return assessed + (TRACKED * (generations // each) if each else 0)
