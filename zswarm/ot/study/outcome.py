"""The outcome of a study, and the logger that follows one."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from zswarm.ot.analysis.curves import Spread, spread
from zswarm.ot.logger import Logger, Result
from zswarm.ot.study.plan import Planned, labels


class RunEnded(NamedTuple):
    """A run of a study that ended."""

    planned: Planned
    result: Result | None  # None: it failed
    error: str = ""
    earlier: bool = False  # it had finished before the study was resumed


class Summary(NamedTuple):
    """The finished runs of a setting."""

    settings: dict[str, Any]
    label: str
    runs: int
    fitness: Spread
    evaluations: int
    held_out: float | None  # median of the champions' means on held-out seeds
    trials: int = 1  # of a candidate: fitness is their sum

    def numbers(self) -> dict[str, Any]:
        """Return what is reported to programs."""
        found = {
            name: getattr(self.fitness, name) for name in ("median", "q25", "q75", "best")
        }
        return {
            **found,
            "held_out": self.held_out,
            "evaluations": self.evaluations,
            "trials": self.trials,
        }


class StudyOutcome(NamedTuple):
    """A study that ended."""

    study: str
    runs: int
    finished: int
    failed: list[RunEnded]
    settings: list[Summary]
    whole: Summary  # over all settings
    seconds: float  # of this program
    # Fitness of some runs is a score, which compares only within one generation.
    relative: bool


class StudyLogger(Logger):
    """Follow a study: ``on_say`` takes lines about it, and each of its runs has a logger.

    All calls come from the thread that plays the study.
    """

    def run_logger(self, planned: Planned) -> Logger:  # noqa: ARG002
        """Return the logger of a run before it begins."""
        return Logger()

    def on_run(self, ended: RunEnded) -> None:
        """Called when a run ended; first for those that had finished earlier."""

    def on_outcome(self, outcome: StudyOutcome | None) -> None:
        """Called last, when the study ended or was stopped (None)."""


def summarize(
    study: str, planned: Sequence[Planned], ended: Sequence[RunEnded], seconds: float
) -> StudyOutcome:
    """Summarize the runs of a study by setting."""
    finished = [one for one in ended if one.result is not None]
    by_setting: dict[str, list[RunEnded]] = {}
    for one in finished:
        by_setting.setdefault(repr(one.planned.settings), []).append(one)  # 1 is not 1.0
    summaries = [
        _summary(one.settings, name, by_setting.get(repr(one.settings), []))
        for name, one in labels(planned)
    ]
    return StudyOutcome(
        study,
        len(planned),
        len(finished),
        [one for one in ended if one.result is None],
        summaries,
        _summary({}, "", finished),
        round(seconds, 3),
        any(one.result.relative for one in finished if one.result),
    )


def _summary(settings: dict[str, Any], words: str, ended: Sequence[RunEnded]) -> Summary:
    results = [one.result for one in ended if one.result is not None]
    best = np.array(
        [-np.inf if np.isnan(result.best) else result.best for result in results]
    )
    evaluations = sum(result.evaluations for result in results)
    champions = [result.champion for result in results if result.champion is not None]
    means = [one.mean for one in champions if one.mean is not None]
    held_out = float(np.median(means)) if means else None
    trials = results[0].trials if results else 1
    return Summary(
        settings, words, len(results), spread(best), evaluations, held_out, trials
    )
