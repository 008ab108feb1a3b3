"""Choose the trials of a run that a page steps through, and play them again."""

from collections.abc import Iterator
from typing import NamedTuple

from zswarm.errors import ConfigError
from zswarm.ot.record.reader import Run
from zswarm.ot.record.selection import available, generation_of, place_of
from zswarm.ot.replay import trace as again
from zswarm.ot.replay.trace import Trace

ALL, RISING = "all", "rising"
EXPECTED = f"expected {ALL}, {RISING}, or generations such as 1,10,200"
MOST_TRIALS = 2_000  # of a page


class TrialSteps(NamedTuple):
    """The trials of a run that are played, and the first one that is shown."""

    run: Run
    candidate: int | None  # None: the best of each generation
    trials: list[tuple[int, int]]  # generation and trial of each, from 0
    start: int

    def play(self) -> Iterator[Trace]:
        """Play one after another.

        Raises:
            ConfigError, EvaluationError: as ``trace.trace``.
        """
        for generation, trial in self.trials:
            yield again.trace(self.run, generation, self.candidate, trial)


def choose(
    run: Run,
    generation: int | None,
    candidate: int | None,
    trial: int,
    generations: str | None = None,
    *,
    trials: bool = False,
) -> TrialSteps:
    """Return the trials to step through, and the one that is shown first.

    Args:
        generation: the one to begin with, from 0; None: the one that found the best.
        candidate: from 0; None: the best of each generation. Without generations: the champion.
        trial: the one to begin with, from 0.
        generations: "all", "rising" (those in which the best rose), or numbers from 1.
        trials: take all trials of each candidate.

    Raises:
        ConfigError: the run has no such generation, or there are too many trials.
    """
    if generations is None:
        first, candidate = place_of(run, generation, candidate)
        listed = [first]
    else:
        first, listed = generation_of(run, generation), _listed(run, generations)
    if generation is not None and first not in listed:
        raise ConfigError(
            f"--generation {first + 1} is not one of --generations {generations}"
        )
    chosen = []
    for number in listed:
        count = again.count_trials(run, number, candidate) if trials else 1
        chosen += [(number, one if trials else trial) for one in range(count)]
        if len(chosen) > MOST_TRIALS:
            raise ConfigError(
                f"{run.shown}: more than {MOST_TRIALS} trials; name fewer generations"
            )
    shown = first if first in listed else listed[-1]
    if (shown, trial) not in chosen:
        count = sum(number == shown for number, _ in chosen)
        raise ConfigError(f"{run.shown}: no trial {trial}; {available('trial', count)}")
    return TrialSteps(run, candidate, chosen, chosen.index((shown, trial)))


def _listed(run: Run, text: str) -> list[int]:
    """Return generations, from 0, in their order."""
    if text == ALL:
        return list(range(run.generations()))
    if text == RISING:
        return _rising(run)
    numbers = set()
    for word in text.split(","):
        if not word.strip().isdecimal():
            raise ConfigError(f"--generations {text}: {EXPECTED}")
        numbers.add(generation_of(run, int(word) - 1))
    return sorted(numbers)


def _rising(run: Run) -> list[int]:
    """Return the generations in which the best rose, all where fitness does not compare."""
    history = run.history()
    if run.relative:
        return [int(row["generation"]) for row in history]
    best, found = None, []
    for row in history:
        if row["best"] is not None and (best is None or row["best"] > best):
            best = row["best"]
            found.append(int(row["generation"]))
    return found or [int(row["generation"]) for row in history[-1:]]
