"""What the cost model needs to know of an experiment and of the servers that would run it, measured on them."""

import math
import statistics
import time
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from zswarm import evaluate
from zswarm.errors import EvaluationError, NoServers
from zswarm.experiment import Experiment
from zswarm.ot import cost_model, discovery, explanation, matching
from zswarm.ot.connection import Connection
from zswarm.ot.dispatch import BATCH_S
from zswarm.ot.problem import Problem
from zswarm.ot.run import Parts

TRIPS = 25  # questions to each server
MEASURED_S = 0.5  # of work for every slot
GENERATIONS = 5  # that are timed
READY_S = 30.0  # until all slots are ready, at most; those that are not are not counted
PLAYED = 3  # candidates whose turns are counted


class Measured(NamedTuple):
    """An experiment on the servers that are there."""

    plan: cost_model.Plan
    constants: cost_model.Constants
    servers: int
    slots: int


def measure(complete: Experiment, parts: Parts, connection: Connection) -> Measured:
    """Play and ask until all is known; the parts are used up.

    Raises:
        NoServers: none that can evaluate it answered.
        EvaluationError: what was tried failed.
    """
    problem, optimizer = parts
    genomes = optimizer.ask()
    trial_s, dispatch_s = _trials(problem, connection, genomes)
    slots = connection.slots
    begun = time.perf_counter()
    optimizer.tell(np.arange(len(genomes), dtype=np.float64), np.zeros((len(genomes), len(optimizer.measures))))
    later = optimizer.ask()
    evolve_s = time.perf_counter() - begun + _gap(problem, connection, later, trial_s)
    requirements = matching.requirements(complete, complete.cluster)
    local = connection.local.endpoint if connection.local is not None else ""
    trips = discovery.trips(complete.cluster.realm, connection.reach, local, requirements=requirements, times=TRIPS)
    if not trips.seconds or not slots:
        raise NoServers(f"no server in realm {complete.cluster.realm} answered")
    plan = plan_of(problem, genomes, len(genomes), len(later))
    constants = cost_model.Constants(
        step_s=trial_s / plan.steps,
        message_s=statistics.median(trips.seconds) / 2,
        busy_s=trips.busy_s / 2,
        evolve_s=evolve_s,
        export_s=cost_model.TABLE_I.export_s,
        compile_s=cost_model.TABLE_I.compile_s,
        fitness_s=cost_model.TABLE_I.fitness_s,
        dispatch_s=dispatch_s,
        batch=batch(trial_s, slots / trips.servers, plan.batches[0] / trips.servers),
    )
    return Measured(plan, constants, trips.servers, slots)


def plan_of(problem: Problem, genomes: Sequence[bytes], first: int, later: int) -> cost_model.Plan:
    """An experiment as the cost model sees it, its games as candidates.

    Args:
        genomes: some of them are played here, to count steps and turns.
        first: candidates of the first generation.
        later: candidates of a later one.

    Raises:
        EvaluationError: a trial that was tried failed.
    """
    simulator, network = problem.simulator, problem.representation
    seed = int(problem.trial_seeds(0)[0])
    turns = decisions = played = 0
    for genome in genomes[:PLAYED]:
        parameters = network.parameters([genome] * simulator.participants)
        try:
            for turn in evaluate.turns(simulator, network, parameters, seed):
                turns += 1
                decisions += len(turn.agents)
        except Exception as error:  # a simulator may raise anything
            raise EvaluationError(f"a trial that was tried failed: {type(error).__name__}: {error}") from error
        played += 1
    agents = max(1, len(simulator.owners))
    steps = max(1, round(decisions / agents / played))
    games = [sum(explanation.rounds(problem, count)) for count in (first, later)]
    return cost_model.Plan(
        generations=problem.experiment.generations,
        population=games[0],
        newcomers=games[1],
        evaluations=problem.experiment.problem.trials,
        steps=steps,
        agents=agents,
        turns=max(1, round(turns / played / steps)),
    )


def batch(trial_s: float, slots: float, trials: float) -> int:
    """Trials in a message, about as ``dispatch`` cuts them.

    Args:
        slots: of a server.
        trials: of a generation for it; two batches are under way at a time.
    """
    return max(1, round(min(BATCH_S / trial_s * slots, trials / 2)))


def _trials(problem: Problem, connection: Connection, genomes: list[bytes]) -> tuple[float, float]:
    """What a trial takes a slot, and what it takes this program, in seconds."""
    connection.evaluate(problem, genomes)  # compiled, and the slots that are there are ready
    _wait_for_slots(connection)
    candidates, one_s = genomes, 0.0
    while True:
        begun, computed = time.perf_counter(), time.process_time()
        fitness = connection.evaluate(problem, candidates)
        took, computed = time.perf_counter() - begun, time.process_time() - computed
        if np.isnan(fitness).all():
            raise EvaluationError("every trial that was tried failed; nothing can be predicted: zswarm-ot check says why")
        trials = sum(explanation.rounds(problem, len(candidates))) * problem.experiment.problem.trials
        one_s = took * connection.slots / trials
        if took >= MEASURED_S or problem.simulator.participants > 1:
            return one_s, computed / trials
        candidates = genomes * (1 + int(len(candidates) / len(genomes) * MEASURED_S * 1.5 / took))


def _gap(problem: Problem, connection: Connection, genomes: list[bytes], trial_s: float) -> float:
    """What a generation takes beside its trials: seconds in which slots wait for its first and its last message."""
    took = []
    for _ in range(GENERATIONS):
        begun = time.perf_counter()
        connection.evaluate(problem, genomes)
        took.append(time.perf_counter() - begun)
    trials = sum(explanation.rounds(problem, len(genomes))) * problem.experiment.problem.trials
    return max(0.0, statistics.median(took) - math.ceil(trials / connection.slots) * trial_s)


def _wait_for_slots(connection: Connection) -> None:
    """Until no more slots get ready, for a while."""
    deadline, last = time.monotonic() + READY_S, 0
    while time.monotonic() < deadline and (slots := connection.slots) != last:
        last = slots
        time.sleep(0.5)
