"""Predict a finished run from its first generations, to compare in its report."""

import statistics
from typing import NamedTuple

import msgspec

from zswarm.errors import ConfigError, EvaluationError
from zswarm.ot.estimate import cost_model
from zswarm.ot.estimate.calibration import plan_of
from zswarm.ot.estimate.cost_model import TABLE_I, Plan
from zswarm.ot.notes import RunEvent
from zswarm.ot.problem import Problem
from zswarm.ot.record.reader import Run

FEWEST = 10  # generations of the shortest run that is predicted
SHARE = 5  # it is predicted from a fifth of them


class Hindsight(NamedTuple):
    """A run without its first generation, in which servers get ready: measured and predicted."""

    known: int  # generations from which it is predicted
    trial_s: float  # a trial on a slot, in the known generations
    gap_s: float  # in which slots waited, in each of them
    measured_s: float
    predicted_s: float
    # In the paper's designs, with Table I's times for messages, export and compiler.
    broker_s: float
    files_s: float


def look_back(run: Run, genome: bytes) -> Hindsight | None:
    """Predict a run; None if it is too short, has no servers, or cannot be played here.

    Args:
        run: the run.
        genome: a candidate, to count the turns of a trial.

    Raises:
        ConfigError: the record is damaged.
    """
    history = run.history()
    if len(history) < FEWEST or run.relative:
        return None
    known = len(history) // SHARE
    evaluated = [generation["evaluations"] for generation in history]
    slots = _slots(run)
    trials, seconds = run.rows(
        "SELECT sum(count), sum(seconds) FROM outcomes WHERE generation BETWEEN 1 AND ?",
        tuple[int | None, float | None],
        known,
    )[0]
    if not slots or not trials or not seconds:
        return None
    trial_s, each = seconds / trials, trials / known
    plan = _plan(run, genome, evaluated[0], evaluated[1] - evaluated[0], each)
    if plan is None:
        return None
    taken = statistics.median(
        generation["seconds"] for generation in history[1 : known + 1]
    )
    gap_s = max(0.0, taken - each / min(slots, each) * trial_s)
    times = msgspec.structs.replace(TABLE_I, step_s=trial_s / plan.steps, evolve_s=gap_s)
    # The time of messages is in the gap.
    here = msgspec.structs.replace(times, message_s=0.0, busy_s=0.0)
    return Hindsight(
        known=known,
        trial_s=trial_s,
        gap_s=gap_s,
        measured_s=history[-1]["finished_at"] - history[0]["finished_at"],
        predicted_s=cost_model.expected_s(cost_model.blob, plan, here, slots),
        broker_s=cost_model.expected_s(cost_model.internal, plan, times, slots),
        files_s=cost_model.expected_s(cost_model.external, plan, times, slots),
    )


def _plan(run: Run, genome: bytes, first: int, later: int, each: float) -> Plan | None:
    """Plan all generations except the first; None if the problem cannot be played here.

    Args:
        first, later: candidates of the first generation, and of a later one.
        each: trials of a later one: fewer than its candidates have, with racing.
    """
    try:
        plan = plan_of(Problem(run.experiment), [genome], first, later)
    except (ConfigError, EvaluationError, MemoryError, ValueError):
        return None
    generations = run.generations() - 1
    return msgspec.structs.replace(
        plan,
        generations=generations,
        population=later,
        newcomers=None,
        played=each / (later * plan.evaluations),
        after=0,
    )


def _slots(run: Run) -> int:
    """Sum up the most slots that each server had."""
    most = run.rows(
        "SELECT max(count) FROM events WHERE event IN (?, ?) AND server <> '' GROUP BY server",
        tuple[int | None],
        RunEvent.SERVER_JOINED,
        RunEvent.SERVER_SLOTS,
    )
    return sum(count or 0 for (count,) in most)
