"""Measure what the cost model needs to know about an experiment and its servers."""

import math
import statistics
import time
from collections.abc import Sequence
from typing import NamedTuple

import msgspec
import numpy as np

from zswarm import evaluate
from zswarm.errors import EvaluationError, NoServers
from zswarm.ot.assessment import amount, contest
from zswarm.ot.build import Parts
from zswarm.ot.cluster import discovery, matching
from zswarm.ot.cluster.connection import Connection
from zswarm.ot.cluster.schedule import BATCH_S
from zswarm.ot.estimate.cost_model import TABLE_I, Constants, Plan
from zswarm.ot.estimate.sample import breed, counted, rounds, simulations
from zswarm.ot.problem import Problem

QUESTIONS = 25  # to each server
SAMPLE_S = 0.5  # of work for every slot
GENERATIONS = 5  # that are timed
READY_S = 30.0  # for the slots to get ready; later ones are not counted
PLAYED = 3  # candidates whose turns are counted


class Calibration(NamedTuple):
    """An experiment on the available servers."""

    plan: Plan
    constants: Constants
    servers: int
    slots: int


def calibrate(parts: Parts, connection: Connection) -> Calibration:
    """Measure trials and messages; the parts are used up.

    Raises:
        NoServers: no server that can evaluate the experiment answered.
        EvaluationError: what was tried failed.
    """
    problem, optimizer = parts
    complete = problem.experiment
    genomes = optimizer.ask()
    trial_s, dispatch_s = _time_trials(problem, connection, genomes)
    differ = contest.unfit(problem) == "" and _differ(problem, connection, genomes)
    slots = connection.slots
    later, breed_s = breed(optimizer, len(genomes))
    evolve_s = breed_s + _gap(problem, connection, later, trial_s)
    trips = discovery.round_trips(
        complete.cluster.realm,
        connection.reach,
        connection.local.endpoint if connection.local is not None else "",
        requirements=matching.requirements(complete, complete.cluster),
        times=QUESTIONS,
    )
    if not trips.seconds or not slots:
        raise NoServers(f"no server in realm {complete.cluster.realm} answered")
    plan = plan_of(problem, genomes, len(genomes), len(later), differ=differ)
    constants = msgspec.structs.replace(  # files are not measured
        TABLE_I,
        step_s=trial_s / plan.steps,
        message_s=statistics.median(trips.seconds) / 2,
        busy_s=trips.busy_s / 2,
        evolve_s=evolve_s,
        dispatch_s=dispatch_s,
        batch=batch(trial_s, slots / trips.servers, plan.batches[0] / trips.servers),
    )
    return Calibration(plan, constants, trips.servers, slots)


def of_table_1(parts: Parts) -> Calibration:
    """Take the paper's times, on one slot; the parts are used up."""
    genomes = parts.optimizer.ask()
    later, _ = breed(parts.optimizer, len(genomes))
    plan = plan_of(parts.problem, genomes, len(genomes), len(later))
    return Calibration(plan, TABLE_I, servers=1, slots=1)


def plan_of(
    problem: Problem,
    genomes: Sequence[bytes],
    first: int,
    later: int,
    *,
    differ: bool = True,
) -> Plan:
    """Describe an experiment for the cost model, with its games as candidates.

    Args:
        problem: the problem.
        genomes: some of them are played here, to count steps and turns.
        first, later: how many candidates the first generation has, and a later one.
        differ: whether trials differ: else there is no assessment.

    Raises:
        EvaluationError: a trial that was tried failed.
    """
    simulator, network = problem.simulator, problem.representation
    seed = int(problem.trial_seeds(0)[0])
    turns = decisions = 0
    for genome in genomes[:PLAYED]:
        parameters = network.parameters([genome] * simulator.participants)
        try:
            for turn in evaluate.turns(simulator, network, parameters, seed):
                turns += 1
                decisions += len(turn.agents)
        except Exception as error:  # a simulator may raise anything
            raise EvaluationError(
                f"a trial that was tried failed: {type(error).__name__}: {error}"
            ) from error
    played = min(PLAYED, len(genomes))
    agents = max(1, len(simulator.owners))
    steps = max(1, round(decisions / agents / played))
    work = counted(problem, first, later)
    return Plan(
        generations=work.generations,
        population=sum(rounds(problem, first)),
        newcomers=sum(rounds(problem, later)),
        evaluations=problem.experiment.problem.trials,
        steps=steps,
        agents=agents,
        turns=max(1, round(turns / played / steps)),
        played=amount.played(problem.experiment),
        after=work.assessment_simulations if differ else 0,
    )


def batch(trial_s: float, slots: float, trials: float) -> int:
    """Return the number of trials in a message, about as ``dispatch`` chooses it.

    Args:
        trial_s: time of a trial.
        slots: of a server.
        trials: of a generation for it; two batches are under way at a time.
    """
    return max(1, round(min(BATCH_S / trial_s * slots, trials / 2)))


def _time_trials(
    problem: Problem, connection: Connection, genomes: list[bytes]
) -> tuple[float, float]:
    """Return the seconds that a trial takes of a slot, and of this program."""
    # Afterwards kernels are compiled and slots are ready.
    connection.evaluate(problem, genomes)
    _wait_for_slots(connection)
    candidates = genomes
    while True:
        begin, computed = time.perf_counter(), time.process_time()
        fitness = connection.evaluate(problem, candidates)
        taken, computed = time.perf_counter() - begin, time.process_time() - computed
        if np.isnan(fitness).all():
            raise EvaluationError(
                "every trial that was tried failed, so nothing can be predicted: zswarm-ot check "
                "explains why"
            )
        trials = simulations(problem, len(candidates))
        if taken >= SAMPLE_S or problem.simulator.participants > 1:
            return taken * connection.slots / trials, computed / trials
        candidates = genomes * (
            1 + int(len(candidates) / len(genomes) * SAMPLE_S * 1.5 / taken)
        )


def _differ(problem: Problem, connection: Connection, genomes: list[bytes]) -> bool:
    """Return whether trials of candidates differ from one seed to another."""
    found = connection.outcomes(problem, genomes, seeds=range(2))
    outcomes = np.stack([found.fitness, *found.metrics.values()])
    return not np.array_equal(outcomes[..., 1:], outcomes[..., :-1], equal_nan=True)


def _gap(
    problem: Problem, connection: Connection, genomes: list[bytes], trial_s: float
) -> float:
    """Return the seconds of a generation in which slots wait for its first and last messages."""
    taken = []
    for _ in range(GENERATIONS):
        begin = time.perf_counter()
        connection.evaluate(problem, genomes)
        taken.append(time.perf_counter() - begin)
    turns = math.ceil(simulations(problem, len(genomes)) / connection.slots)
    return max(0.0, statistics.median(taken) - turns * trial_s)


def _wait_for_slots(connection: Connection) -> None:
    """Wait until no more slots get ready for a while."""
    deadline, last = time.monotonic() + READY_S, 0
    while time.monotonic() < deadline and (slots := connection.slots) != last:
        last = slots
        time.sleep(0.5)
