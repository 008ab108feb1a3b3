"""How long an optimization takes by where its controllers are: a model to plan with.

Equations 1-10 and Table I of "Distributed Simulation for Evolutionary Design of Swarms of Cyber-Physical Systems" (CPSwarm),
and what they leave out: whole rounds, and the one program that all messages pass, which is why more servers do not always help.

``optimization_s`` is the paper's time, ``expected_s`` the one with both. A way is a function of a plan, constants and slots.
"""

import math
from collections.abc import Callable

import msgspec

NEAR = 1.01  # slots are enough when more of them save less than a hundredth


class Plan(msgspec.Struct, frozen=True, kw_only=True):
    """An optimization.

    ``newcomers`` are the candidates of a later generation that have no fitness yet, as NNGA's elite has; None: all of them, as in
    the paper. ``turns`` are those of a step in which agents act: 1 when all act at once, ``agents`` when one after another.
    """

    generations: int  # n_gen
    population: int  # n_pop
    steps: int  # n_step, of a simulation
    agents: int  # n_agent
    evaluations: int = 1  # n_eval, simulations of a candidate
    newcomers: int | None = None
    turns: int = 1

    @property
    def batches(self) -> tuple[int, int]:
        """Simulations of the first generation and of each later one."""
        later = self.population if self.newcomers is None else self.newcomers
        return self.population * self.evaluations, later * self.evaluations

    @property
    def simulations(self) -> int:
        """In all: equation 1."""
        first, later = self.batches
        return first + (self.generations - 1) * later


class Constants(msgspec.Struct, frozen=True, kw_only=True):
    """What takes how long, in seconds, on some machines.

    ``busy_s`` is the part of ``message_s`` in which the program that all messages pass (broker or optimizer) has no time for
    another message: it limits all servers together, where ``message_s`` delays one simulation.
    """

    step_s: float  # t_step, a step of a simulation with all its agents
    message_s: float  # t_msg, one message, one way
    busy_s: float
    evolve_s: float = 0.0  # t_evo, between two generations
    export_s: float = 0.0  # t_export, parameters and controller written as files
    compile_s: float = 0.0  # t_compile
    fitness_s: float = 0.0  # t_fitness, logs read
    dispatch_s: float = 0.0  # the optimizer's own work for a simulation, messages apart
    batch: int = 1  # simulations in a message, where a candidate travels as parameters


class Cost(msgspec.Struct, frozen=True):
    """Of one simulation, in a way to run it."""

    messages: float
    overhead_s: float  # t_overhead, added to the time of its steps
    serial_s: float  # the time it takes of what all simulations share


TABLE_I = Constants(  # measured by the paper; that a message keeps broker and optimizer busy all its time is our reading
    evolve_s=0.012, message_s=0.030, busy_s=0.030, export_s=0.00535, compile_s=8.833, fitness_s=0.00069, step_s=0.100
)
TABLE_I_GENERATIONS, TABLE_I_POPULATION, TABLE_I_EVALUATIONS = 200, 50, 1

Way = Callable[[Plan, Constants, int], Cost]


# ---- ways ---------------------------------------------------------------------------------------------------------


def internal(plan: Plan, constants: Constants, slots: int = 1) -> Cost:
    """The controller in the optimizer, behind a broker: equations 4 and 5.

    Discovery, server, parameters, control and fitness, then a sensor and an actuator message for each agent and step. Every idle
    server answers a discovery: one of these answers is waited for, all of them keep the broker busy.
    """
    waited = 5 + 2 * plan.steps * plan.agents
    passed = waited + slots - 1
    return Cost(passed, waited * constants.message_s, passed * constants.busy_s + constants.dispatch_s)


def external(_plan: Plan, constants: Constants, _slots: int = 1) -> Cost:
    """The controller exported to the simulator as source code, compiled for each candidate, logs read: equation 6."""
    files = constants.export_s + constants.fitness_s
    return Cost(0, files + constants.compile_s, files + constants.dispatch_s)


def blob(_plan: Plan, constants: Constants, _slots: int = 1) -> Cost:
    """A controller that reads its parameters from a message; another brings the fitness: the paper's section VI, and zswarm."""
    messages = 2 / constants.batch
    return Cost(messages, messages * constants.message_s, messages * constants.busy_s + constants.dispatch_s)


def by_turn(plan: Plan, constants: Constants, _slots: int = 1) -> Cost:
    """The controller in the optimizer, servers discovered once: ``controller = "optimizer"``, two messages for each turn."""
    return _asked(plan.steps * plan.turns, constants)


def by_agent(plan: Plan, constants: Constants, _slots: int = 1) -> Cost:
    """Likewise with two messages for each agent and step: ``messages = "agent"``."""
    return _asked(plan.steps * plan.agents, constants)


def _asked(questions: int, constants: Constants) -> Cost:
    messages = 2 / constants.batch + 2 * questions
    return Cost(messages, messages * constants.message_s, messages * constants.busy_s + constants.dispatch_s)


# ---- times --------------------------------------------------------------------------------------------------------


def optimization_s(way: Way, plan: Plan, constants: Constants, threads: float = 1) -> float:
    """The paper's t_opt: equations 2, 3, 7 and 8.

    Raises:
        ValueError: more threads than simulations of a generation, or less than one.
    """
    most = plan.population * plan.evaluations
    if not 1 <= threads <= most:
        raise ValueError(f"threads: expected 1 to {most} (population x evaluations), got {threads}")
    one = plan.steps * constants.step_s + way(plan, constants, 1).overhead_s
    return plan.generations * constants.evolve_s + plan.simulations / threads * one


def expected_s(way: Way, plan: Plan, constants: Constants, slots: int = 1) -> float:
    """The time with so many slots, each for one simulation.

    A generation takes whole rounds of simulations, and no less than what they all take of the program that they share.

    Raises:
        ValueError: no slots.
    """
    if slots < 1:
        raise ValueError(f"slots: expected 1 or more, got {slots}")
    cost = way(plan, constants, slots)
    one = plan.steps * constants.step_s + cost.overhead_s

    def generation(simulations: int) -> float:
        return constants.evolve_s + max(math.ceil(simulations / slots) * one, simulations * cost.serial_s)

    first, later = plan.batches
    return generation(first) + (plan.generations - 1) * generation(later)


def useful_slots(way: Way, plan: Plan, constants: Constants) -> int:
    """The fewest slots that come within a hundredth of the shortest time: more are of no use."""
    times = [expected_s(way, plan, constants, slots) for slots in range(1, plan.population * plan.evaluations + 1)]
    enough = min(times) * NEAR
    return next(slots for slots, time in enumerate(times, 1) if time <= enough)


# ---- the paper's figures ------------------------------------------------------------------------------------------


def ratio(plan: Plan, constants: Constants, threads: float = 1, *, against: Way = external) -> float:
    """The paper's r of figure 3: above 1 the controller does not belong in the optimizer."""
    return optimization_s(internal, plan, constants, threads) / optimization_s(against, plan, constants, threads)


def crossing(plan: Plan, constants: Constants, *, against: Way = external) -> int | None:
    """The first number of steps at which ``ratio`` is above 1, in place of the plan's; None: it never is."""

    def above(steps: int) -> bool:
        return ratio(msgspec.structs.replace(plan, steps=steps), constants, against=against) > 1

    low, high = 0, 1
    while not above(high):  # both times are linear in steps: the ratio passes 1 once at most
        low, high = high, 2 * high
        if high > 1 << 40:
            return None
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if above(middle) else (middle, high)
    return high


class Coefficients(msgspec.Struct, frozen=True):
    """Of equations 9 and 10.

    ``base_s (1 + internal / n_thread (messages + n_step (step + n_agent)))`` with the controller in the optimizer,
    ``base_s (1 + external / n_thread (files + n_step))`` with one that is exported.
    """

    base_s: float
    internal: float
    messages: float
    step: float
    external: float
    files: float


def coefficients(plan: Plan, constants: Constants) -> Coefficients:
    """Those of a plan's generations, population and evaluations; steps and agents take no part."""
    each = plan.population * plan.evaluations / constants.evolve_s
    return Coefficients(
        base_s=plan.generations * constants.evolve_s,
        internal=each * 2 * constants.message_s,
        messages=5 / 2,
        step=constants.step_s / (2 * constants.message_s),
        external=each * constants.step_s,
        files=external(plan, constants).overhead_s / constants.step_s,
    )
