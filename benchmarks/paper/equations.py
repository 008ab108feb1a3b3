"""The paper's own time and its figures: equations 2, 3 and 7 to 10, and figure 3."""

import msgspec

from zswarm.ot.estimate.cost_model import Constants, Plan, Way, external, internal


def optimization_s(
    way: Way, plan: Plan, constants: Constants, threads: float = 1
) -> float:
    """Return the paper's t_opt (eq. 2, 3, 7 and 8).

    Raises:
        ValueError: more threads than simulations of a generation, or less than one.
    """
    most = plan.population * plan.evaluations
    if not 1 <= threads <= most:
        raise ValueError(
            f"threads: expected 1 to {most} (population x evaluations), got {threads}"
        )
    one = plan.steps * constants.step_s + way(plan, constants, 1).overhead_s
    return plan.generations * constants.evolve_s + plan.simulations / threads * one


def ratio(
    plan: Plan, constants: Constants, threads: float = 1, *, against: Way = external
) -> float:
    """Return the r of figure 3: above 1 the controller does not belong in the optimizer."""
    return optimization_s(internal, plan, constants, threads) / optimization_s(
        against, plan, constants, threads
    )


def crossing(plan: Plan, constants: Constants, *, against: Way = external) -> int | None:
    """Return the first number of steps at which ``ratio`` is above 1; None: it never is."""

    def above(steps: int) -> bool:
        return (
            ratio(msgspec.structs.replace(plan, steps=steps), constants, against=against)
            > 1
        )

    low, high = 0, 1
    # Both times are linear in steps: the ratio passes 1 once at most.
    while not above(high):
        low, high = high, 2 * high
        if high > 1 << 40:
            return None
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if above(middle) else (middle, high)
    return high


class Coefficients(msgspec.Struct, frozen=True):
    """The coefficients of equations 9 and 10.

    ``base_s (1 + internal / n_thread (messages + n_step (step + n_agent)))`` with the controller in
    the optimizer,
    ``base_s (1 + external / n_thread (files + n_step))`` with one that is exported.
    """

    base_s: float
    internal: float
    messages: float
    step: float
    external: float
    files: float


def coefficients(plan: Plan, constants: Constants) -> Coefficients:
    """Return those of a plan; its steps and agents take no part."""
    each = plan.population * plan.evaluations / constants.evolve_s
    return Coefficients(
        base_s=plan.generations * constants.evolve_s,
        internal=each * 2 * constants.message_s,
        messages=5 / 2,
        step=constants.step_s / (2 * constants.message_s),
        external=each * constants.step_s,
        files=external(plan, constants).overhead_s / constants.step_s,
    )
