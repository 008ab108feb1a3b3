"""Explain an experiment before it is run: what is judged, how much work it is, likely mistakes."""

import inspect
import shutil
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from zswarm import evaluate, experiment
from zswarm.config import ranges
from zswarm.experiment import Experiment
from zswarm.ot.assessment import amount
from zswarm.ot.build import Parts
from zswarm.ot.estimate.sample import MOST_BRED, breed, counted, rounds
from zswarm.ot.problem import Problem
from zswarm.plugins import portability, registry
from zswarm.sims.randomized import Varied
from zswarm.system.format import size
from zswarm.system.text import clean

SAMPLE_S = 0.3  # of trials
MOST_TRIALS = 512  # of the sample
MOST_SEEDS = 8  # of the sample, where settings differ by trial; else 2
EXAMPLE_SERVERS, EXAMPLE_SLOTS = 8, 4
FEW = 5  # candidates
NOTHING_EVOLVES = "nothing can evolve"

# Bytes in the record: of a candidate besides its genome, of a trial besides its metrics, of a
# participant of a trial except the first, of a generation.
CANDIDATE, TRIAL, METRIC, PARTICIPANT, GENERATION = 60, 24, 8, 16, 1300


class Explanation(msgspec.Struct, frozen=True, kw_only=True):
    """An experiment in numbers."""

    experiment: str
    simulator: str
    about: str  # first line of the simulator's docstring
    ranges: dict[str, str]  # settings that differ by trial, in words
    agents: int  # in a trial; the least, where their number differs
    most_agents: int
    participants: int
    inputs: int
    hidden: int | None
    outputs: int
    sensors: list[str]
    actuators: list[str]
    metrics: list[str]
    trials: int
    representation: str
    genome_numbers: int | None
    genome_bytes: int | None
    ranking: str
    games: int  # of the first generation; one for each candidate where none plays another
    optimizer: str
    portable: bool
    repeatable: bool  # the same trial has the same outcomes
    unportable: list[
        str
    ]  # lines of its source that may have other bits on other machines
    generations: int  # up to the last one, or as many as a budget has room for
    candidates_first_generation: int
    candidates_later_generations: int
    evaluations: int
    simulations: int  # at most
    simulations_expected: int  # fewer with racing
    assessment_simulations: int  # at most, after the last generation
    trial_s: float
    slots: int  # of this machine
    seconds: float  # on these
    seconds_elsewhere: float  # on EXAMPLE_SERVERS with EXAMPLE_SLOTS each
    record_bytes: int
    warnings: list[str]


class TrialSample(NamedTuple):
    """The results of a few trials."""

    trial_s: float
    differs: bool  # one genome's fitness, from seed to seed
    same: bool  # all outcomes of each genome, for every seed
    failed: bool  # all of them
    error: str


def explain(
    complete: Experiment, parts: Parts, sample: TrialSample | None = None
) -> Explanation:
    """Count the work of a run; the parts are used up.

    Args:
        sample: of its trials; None: some are played.
    """
    problem, optimizer = parts
    genomes = optimizer.ask()
    sample = sample or time_trials(problem, genomes)
    first = later = len(genomes)
    if first <= MOST_BRED:
        later = len(breed(optimizer, first)[0])
    genome = problem.representation.genome_bytes or int(
        np.mean([len(one) for one in genomes])
    )
    work = _work(problem, first, later, sample, genome)
    hidden = complete.representation.settings.get("hidden")
    return Explanation(
        experiment=complete.name,
        trials=complete.problem.trials,
        representation=complete.representation.kind,
        hidden=hidden if isinstance(hidden, int) else None,
        genome_numbers=problem.representation.genes,
        genome_bytes=problem.representation.genome_bytes,
        ranking=complete.ranking.kind,
        optimizer=complete.optimizer.kind,
        portable=optimizer.portable,
        repeatable=problem.simulator.repeatable,
        unportable=_unportable(problem),
        candidates_first_generation=first,
        candidates_later_generations=later,
        trial_s=sample.trial_s,
        warnings=list(_warnings(complete, sample, first, work["generations"])),
        **_simulator(problem),
        **work,
    )


def _unportable(problem: Problem) -> list[str]:
    """Return a line for each place in a simulator's source that may have other bits elsewhere."""
    name = problem.experiment.problem.simulator
    if name in registry.BUNDLED["simulator"] or not problem.simulator.repeatable:
        return []
    found = portability.findings(registry.load("simulator", name))
    return [clean(f"{each.file.name}:{each.line}: {each.text}") for each in found]


def _simulator(problem: Problem) -> dict[str, Any]:
    """Describe the simulator."""
    settings, simulator = problem.experiment.problem, problem.simulator
    about = inspect.getdoc(registry.load("simulator", settings.simulator)) or ""
    agents = (
        simulator.agents
        if isinstance(simulator, Varied)
        else (len(simulator.owners),) * 2
    )
    drawn = ranges.found(settings.settings)
    return {
        "simulator": settings.simulator,
        "about": " ".join(about.partition("\n\n")[0].split()),
        "ranges": {".".join(path): ranges.words(one) for path, one in drawn.items()},
        "agents": agents[0],
        "most_agents": agents[1],
        **{key: getattr(simulator, key) for key in ("participants", "inputs", "outputs")},
        **{
            key: list(getattr(simulator, key))
            for key in ("sensors", "actuators", "metrics")
        },
    }


def _work(
    problem: Problem, first: int, later: int, sample: TrialSample, genome_bytes: int
) -> dict[str, Any]:
    """Count evaluations, simulations, seconds and bytes of a run."""
    complete, simulator = problem.experiment, problem.simulator
    effort, trials = counted(problem, first, later), complete.problem.trials
    others, evaluations = effort.generations - 1, effort.evaluations
    played = [rounds(problem, count) for count in (first, later)]
    simulations = effort.simulations
    trial = (
        TRIAL
        + METRIC * len(simulator.metrics)
        + PARTICIPANT * (simulator.participants - 1)
    )
    share = amount.played(complete)
    assessed = 0 if sample.same else effort.assessment_simulations
    record = evaluations * (genome_bytes + CANDIDATE)
    record += (simulations + assessed) * trial

    def seconds(slots: int) -> float:
        """Count whole rounds of trials: each round of games waits for its last one."""
        steps = [sum(-(-games * trials // slots) for games in some) for some in played]
        steps_after = -(-assessed // slots)
        searching = share * (steps[0] + others * steps[1])
        return sample.trial_s * (searching + steps_after)

    slots = experiment.slots_of_this_machine(complete.cluster)
    return {
        "generations": effort.generations,
        "games": sum(played[0]),
        "evaluations": evaluations,
        "simulations": simulations,
        "simulations_expected": round(share * simulations),
        "assessment_simulations": assessed,
        "slots": slots,
        "seconds": seconds(slots),
        "seconds_elsewhere": seconds(EXAMPLE_SERVERS * EXAMPLE_SLOTS),
        "record_bytes": record + effort.generations * GENERATION,
    }


def time_trials(problem: Problem, genomes: list[bytes]) -> TrialSample:
    """Play candidates until the time of a trial is known, compilation excluded."""
    simulator, network = problem.simulator, problem.representation
    evaluate.warm_up(simulator, network)
    seeds = _seeds(problem)
    played, taken, number, fitness, error, same = 0, 0.0, 1, [], "", True
    while taken < SAMPLE_S and played < MOST_TRIALS:
        some = [
            genomes[index % len(genomes)]
            for index in range(played // 2, played // 2 + number)
        ]
        games = (np.arange(len(some))[:, None] + np.arange(simulator.participants)) % len(
            some
        )
        participants = np.repeat(games, len(seeds), axis=0)
        all_seeds = np.tile(seeds, len(some))
        begin = time.perf_counter()
        outcomes = evaluate.evaluate(simulator, network, some, participants, all_seeds)
        taken += time.perf_counter() - begin
        played += len(participants)
        number *= 2
        fitness.append(outcomes.fitness[:, 0].reshape(-1, len(seeds)))
        metrics = outcomes.metrics.reshape(len(some), len(seeds), -1)
        firsts = np.repeat(metrics[:, :1], len(seeds), axis=1)
        same = same and np.array_equal(metrics, firsts, equal_nan=True)
        error = error or outcomes.error
    together = np.concatenate(fitness)
    whole = together[~np.isnan(together).any(axis=1)]
    differs = bool((whole[:, :1] != whole).any())
    same = same and not differs and len(whole) > 0
    return TrialSample(
        taken / played, differs, same, bool(np.isnan(together).all()), error
    )


def _seeds(problem: Problem) -> np.ndarray:
    """Return (seeds,) uint64, at least two different ones where there are any."""
    simulator = problem.simulator
    if problem.experiment.problem.trials > 1:
        return problem.trial_seeds(0)[
            : MOST_SEEDS if isinstance(simulator, Varied) else 2
        ]
    if (fixed := simulator.fixed_seeds(2)) is not None:
        return np.array(fixed, np.uint64)
    seeds = np.array(
        [problem.trial_seeds(generation)[0] for generation in (0, 1)], np.uint64
    )
    if seeds[0] == seeds[1]:
        seeds[1] += np.uint64(1)
    return seeds


def _warnings(
    complete: Experiment, sample: TrialSample, first: int, generations: int
) -> Iterator[str]:
    trials = complete.problem.trials
    if sample.failed:
        reason = f": {sample.error}" if sample.error else ""
        yield f"every trial that was tried failed{reason}; {NOTHING_EVOLVES}"
    elif sample.error:
        yield f"a trial that was tried failed: {sample.error}; the candidate is ranked last"
    if generations == 1:
        why = (
            "generations = 1"
            if complete.generations == 1
            else "one generation uses the budget"
        )
        yield f"{why}: random candidates are judged, and nothing evolves"
    if first < FEW:
        yield f"only {first} candidates in a generation: evolution needs a choice; 50 is usual"
    if trials == 1 and sample.differs:
        yield (
            "trials = 1: one trial judges a candidate, and trials differ, so luck decides; "
            "problem.trials = 10 judges better"
        )
    if trials > 1 and sample.same:
        yield (
            f"trials = {trials}: the trials do not differ, nothing in them depends on the seed; "
            "problem.trials = 1 finds the same in less time"
        )


def too_large(record: int, out: Path = Path("runs")) -> Iterator[str]:
    """Yield a warning if a record does not fit on the disk; ``out`` is where runs will be made."""
    folder = next(
        path for path in (out.absolute(), *out.absolute().parents) if path.exists()
    )
    if record > (free := shutil.disk_usage(folder).free):
        yield f"the record needs about {size(record)}, and {size(free)} are free in {out}"
