"""What the cost model says of a run from its first generations, beside what the run took: for its report."""

import statistics
from typing import NamedTuple

import msgspec

from zswarm.errors import ConfigError, EvaluationError
from zswarm.ot import constants, cost_model
from zswarm.ot.cost_model import TABLE_I, Plan
from zswarm.ot.problem import Problem
from zswarm.ot.reading import Run

FEWEST = 10  # generations of a run that is worth a prediction
SHARE = 5  # a fifth of them is what the prediction is made from


class Hindsight(NamedTuple):
    """A run after its first generation, in which servers get ready: measured, and predicted from the ones that came next."""

    known: int  # generations that it is predicted from
    generations: int  # that are predicted, those among them
    simulations: int
    slots: int
    trial_s: float  # a trial on a slot, in the known ones
    gap_s: float  # in which slots waited, in each
    measured_s: float
    predicted_s: float
    broker_s: float  # in the paper's designs, with Table I's times for messages, export and compiler
    files_s: float


def look_back(run: Run, genome: bytes) -> Hindsight | None:
    """None where a run is too short, its servers are not recorded, or its problem cannot be played here.

    Args:
        genome: a candidate, to count the turns of a trial.

    Raises:
        ConfigError: the record is damaged.
    """
    history = run.history()
    if len(history) < FEWEST or run.relative:
        return None
    known = len(history) // SHARE
    evaluated = [generation["evaluations"] for generation in history]
    plan = _plan(run, genome, evaluated[0], evaluated[1] - evaluated[0])
    slots = _slots(run)
    trials, seconds = run.rows(
        "SELECT sum(count), sum(seconds) FROM outcomes WHERE generation BETWEEN 1 AND ?", tuple[int | None, float | None], known
    )[0]
    if plan is None or not slots or not trials or not seconds:
        return None
    trial_s, each = seconds / trials, trials / known
    taken = statistics.median(generation["seconds"] for generation in history[1 : known + 1])
    gap_s = max(0.0, taken - each / min(slots, each) * trial_s)
    times = msgspec.structs.replace(TABLE_I, step_s=trial_s / plan.steps, evolve_s=gap_s)
    here = msgspec.structs.replace(times, message_s=0.0, busy_s=0.0)  # they are in the gap
    return Hindsight(
        known=known,
        generations=plan.generations,
        simulations=plan.simulations,
        slots=slots,
        trial_s=trial_s,
        gap_s=gap_s,
        measured_s=history[-1]["finished_at"] - history[0]["finished_at"],
        predicted_s=cost_model.expected_s(cost_model.blob, plan, here, slots),
        broker_s=cost_model.expected_s(cost_model.internal, plan, times, slots),
        files_s=cost_model.expected_s(cost_model.external, plan, times, slots),
    )


def _plan(run: Run, genome: bytes, first: int, later: int) -> Plan | None:
    """Of all generations but the first; None where the problem cannot be played here."""
    try:
        plan = constants.plan_of(Problem(run.experiment), [genome], first, later)
    except (ConfigError, EvaluationError, MemoryError, ValueError):
        return None
    return msgspec.structs.replace(plan, generations=run.generations() - 1, population=later, newcomers=None)


def _slots(run: Run) -> int:
    """As many as each server ever had, together."""
    most = run.rows(
        "SELECT max(count) FROM events WHERE event IN ('server_joined', 'server_slots') AND server <> '' GROUP BY server",
        tuple[int | None],
    )
    return sum(count or 0 for (count,) in most)
