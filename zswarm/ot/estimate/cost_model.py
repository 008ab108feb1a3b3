"""Predict how long an optimization takes, depending on where its controllers are.

Equations 1 to 8 and Table I of "Distributed Simulation for Evolutionary Design of Swarms of
Cyber-Physical Systems" (CPSwarm), and what they omit: whole rounds of simulations, and the one
program that all messages pass, which is why more servers do not always help. ``WAYS`` lists the
ways to run an optimization, each a function of a plan, constants and slots.
"""

import math
from collections.abc import Callable

import msgspec

NEAR = 1.01  # slots are enough if more of them save less than a hundredth


class Plan(msgspec.Struct, frozen=True, kw_only=True):
    """The size of an optimization."""

    generations: int  # n_gen
    population: int  # n_pop
    steps: int  # n_step, of a simulation
    agents: int  # n_agent
    evaluations: int = 1  # n_eval, simulations of a candidate
    # Candidates of a later generation without a fitness, as NNGA keeps an elite; None: all of them.
    newcomers: int | None = None
    # Of a step: 1 if all agents act at once, ``agents`` if one after another.
    turns: int = 1
    played: float = 1.0  # expected share of the simulations: less than 1 with racing
    after: int = 0  # simulations that follow the last generation: the assessment's

    @property
    def batches(self) -> tuple[int, int]:
        """Simulations of the first generation and of each later one, as expected."""
        later = self.population if self.newcomers is None else self.newcomers
        first, later = self.population * self.evaluations, later * self.evaluations
        return round(first * self.played), round(later * self.played)

    @property
    def simulations(self) -> int:
        """All simulations (eq. 1), and those of the assessment."""
        first, later = self.batches
        return first + (self.generations - 1) * later + self.after


class Constants(msgspec.Struct, frozen=True, kw_only=True):
    """Times on some machines, in seconds.

    ``message_s`` delays one simulation. ``busy_s`` is the part of it in which the program that all
    messages pass (broker or optimizer) cannot take another one: it limits all servers together.
    """

    step_s: float  # t_step, of a simulation with all its agents
    message_s: float  # t_msg, one way
    busy_s: float
    evolve_s: float = 0.0  # t_evo, between two generations
    export_s: float = 0.0  # t_export, parameters and controller written as files
    compile_s: float = 0.0  # t_compile
    fitness_s: float = 0.0  # t_fitness, reading logs
    dispatch_s: float = 0.0  # the optimizer's work for a simulation, without messages
    batch: int = 1  # simulations in a message, where a candidate travels as parameters


class Cost(msgspec.Struct, frozen=True):
    """The cost of one simulation, besides its steps."""

    messages: float
    overhead_s: float  # t_overhead, added to the time of its steps
    serial_s: float  # of the program that all simulations share


# Measured by the paper, except that a message keeps broker and optimizer busy all its time.
TABLE_I = Constants(
    evolve_s=0.012,
    message_s=0.030,
    busy_s=0.030,
    export_s=0.00535,
    compile_s=8.833,
    fitness_s=0.00069,
    step_s=0.100,
)
TABLE_I_GENERATIONS, TABLE_I_POPULATION, TABLE_I_EVALUATIONS = 200, 50, 1

Way = Callable[[Plan, Constants, int], Cost]


class Predicted(msgspec.Struct, frozen=True, kw_only=True):
    """One way to run an experiment."""

    way: str
    messages: float  # of the whole run
    seconds: float
    useful_slots: int  # more of them save less than a hundredth


def predict(plan: Plan, constants: Constants, slots: int) -> list[Predicted]:
    """Predict each way, in the order of ``WAYS``."""
    return [
        Predicted(
            way=name,
            messages=way(plan, constants, slots).messages * plan.simulations,
            seconds=expected_s(way, plan, constants, slots),
            useful_slots=useful_slots(way, plan, constants),
        )
        for name, (way, _) in WAYS.items()
    ]


def internal(plan: Plan, constants: Constants, slots: int = 1) -> Cost:
    """Keep the controller in the optimizer, behind a broker (eq. 4 and 5).

    Discovery, server, parameters, control and fitness take a message each, and every agent a sensor
    and an actuator message in each step. Every idle server answers a discovery: one of the answers
    is waited for, all of them keep the broker busy.
    """
    waited = 5 + 2 * plan.steps * plan.agents
    return _by_message(waited, constants, passed=waited + slots - 1)


def external(_plan: Plan, constants: Constants, _slots: int = 1) -> Cost:
    """Export the controller as source code, compile it for each candidate, read logs (eq. 6)."""
    files = constants.export_s + constants.fitness_s
    return Cost(0, files + constants.compile_s, files + constants.dispatch_s)


def blob(_plan: Plan, constants: Constants, _slots: int = 1) -> Cost:
    """Send parameters to a controller, and fitness back: section VI of the paper, and zswarm."""
    return _by_message(2 / constants.batch, constants)


def by_turn(plan: Plan, constants: Constants, _slots: int = 1) -> Cost:
    """Keep the controller in the optimizer, without discovery: two messages for each turn."""
    return _by_message(2 / constants.batch + 2 * plan.steps * plan.turns, constants)


def by_agent(plan: Plan, constants: Constants, _slots: int = 1) -> Cost:
    """Likewise, with two messages for each agent and step."""
    return _by_message(2 / constants.batch + 2 * plan.steps * plan.agents, constants)


# Each way with its meaning.
WAYS: dict[str, tuple[Way, str]] = {
    "parameters": (
        blob,
        "candidates travel as parameters to controllers on servers: what run does",
    ),
    "optimizer, by turn": (
        by_turn,
        'controller = "optimizer": two messages for each turn',
    ),
    "optimizer, by agent": (
        by_agent,
        'with messages = "agent": two messages for each agent and step',
    ),
    "broker": (
        internal,
        "the paper's first design: the same, with servers discovered for each candidate",
    ),
    "files": (
        external,
        "the paper's second design: source code exported and compiled for each candidate",
    ),
}


def _by_message(waited: float, constants: Constants, passed: float | None = None) -> Cost:
    passed = waited if passed is None else passed
    serial_s = passed * constants.busy_s + constants.dispatch_s
    return Cost(passed, waited * constants.message_s, serial_s)


def expected_s(way: Way, plan: Plan, constants: Constants, slots: int = 1) -> float:
    """Return the time with a number of slots, each for one simulation.

    A generation takes whole rounds of simulations, and no less than they take of the program that
    they share.

    Raises:
        ValueError: no slots.
    """
    if slots < 1:
        raise ValueError(f"slots: expected 1 or more, got {slots}")
    cost = way(plan, constants, slots)
    one = plan.steps * constants.step_s + cost.overhead_s

    def generation(simulations: int) -> float:
        rounds_s = math.ceil(simulations / slots) * one
        return constants.evolve_s + max(rounds_s, simulations * cost.serial_s)

    first, later = plan.batches
    search = generation(first) + (plan.generations - 1) * generation(later)
    return search + (generation(plan.after) if plan.after else 0.0)


def useful_slots(way: Way, plan: Plan, constants: Constants) -> int:
    """Return the fewest slots that come within a hundredth of the shortest time."""
    most = plan.population * plan.evaluations
    times = [expected_s(way, plan, constants, slots) for slots in range(1, most + 1)]
    enough = min(times) * NEAR
    return next(slots for slots, time in enumerate(times, 1) if time <= enough)
