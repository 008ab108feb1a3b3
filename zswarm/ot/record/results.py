"""The results of finished runs, from their records."""

import math
from pathlib import Path

from zswarm.errors import ConfigError
from zswarm.experiment import Experiment
from zswarm.ot.logger import Result
from zswarm.ot.record import stopping
from zswarm.ot.record.reader import Run


def finished_result(folder: Path, complete: Experiment) -> Result | None:
    """Return the result of a run that has all its generations and whose experiment is unchanged.

    Raises:
        ConfigError: its record is damaged.
    """
    run = Run(folder)
    ended = stopping.ended(run.meta, complete)
    if (not ended and run.generations() != complete.generations) or run.changed:
        return None
    if run.finished:
        run.check()
    return result_after(folder, complete)


def result_after(folder: Path, complete: Experiment) -> Result | None:
    """Return a finished run's result after the experiment's generations, for runs of one length.

    It is None also for a run that cannot be read: resuming it reports why.
    """
    try:
        run = Run(folder)
        generations = complete.generations
        if stopping.ended(run.meta, complete):
            generations = min(generations, run.generations())
        if not run.finished or run.generations() < generations:
            return None
        history, (faulted, doubtful) = run.history(), run.marked()
        counts = [
            event["count"] for event in run.events() if event["event"] == "requeued"
        ]
    except ConfigError:
        return None
    last = history[generations - 1]
    whole = last is history[-1]
    return Result(
        str(folder),
        generations,
        math.nan if last["best"] is None else last["best"],
        last["evaluations"],
        sum(count or 0 for count in counts),
        run.history_hash or "" if whole else "",
        0.0,
        faulted,
        doubtful,
        run.relative,
        run.history_version,
        champion=run.held_out if whole else None,
        assessment_hash=run.meta.get("assessment_hash", "") if whole else "",
        trials=run.fitness_trials,
        repeatable="repeatable" not in run.meta,
    )
