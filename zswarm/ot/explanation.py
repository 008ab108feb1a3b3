"""What an experiment amounts to, before it is run: what is judged, how much work it is, and what is likely a mistake."""

import inspect
import shutil
import time
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from zswarm import evaluate, experiment, plugins, ranges
from zswarm.experiment import Experiment
from zswarm.ot.problem import Problem
from zswarm.ot.rankings.ranking import Round
from zswarm.ot.run import Parts
from zswarm.varied import Varied

MEASURED_S = 0.3  # of trials, to know what one takes
MOST_PLAYED = 512  # trials of the measurement
MOST_SEEDS = 8  # of them, where settings differ by trial; else 2
MOST_BRED = 5_000  # candidates of a first generation up to which a second one is made to be counted
EXAMPLE_SERVERS, EXAMPLE_SLOTS = 8, 4
UNITS = ((1e-6, "us", 1e-3), (1e-3, "ms", 1.0), (1.0, "s", 120.0), (60.0, "min", 7200.0), (3600.0, "h", 172_800.0))
FEW = 5  # candidates

# Bytes on the disk: of a candidate beside its genome, of a trial beside its metrics, of a generation.
CANDIDATE, TRIAL, METRIC, GENERATION = 60, 24, 8, 1300
PARTICIPANT = 16  # and of each participant of a trial but the first


class Explanation(msgspec.Struct, frozen=True, kw_only=True):
    """An experiment in numbers."""

    experiment: str
    simulator: str
    about: str  # the simulator's own words
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
    runs: int  # of its study; all the rest is of one run with the file's own values
    generations: int
    candidates_first_generation: int
    candidates_later_generations: int
    evaluations: int
    simulations: int
    trial_s: float
    slots: int  # of this machine
    seconds: float  # on these
    seconds_elsewhere: float  # on EXAMPLE_SERVERS with EXAMPLE_SLOTS each
    record_bytes: int
    warnings: list[str]


class Measured(NamedTuple):
    """What some trials showed."""

    trial_s: float
    differs: bool  # one genome's fitness, from seed to seed
    same: bool  # all that came out of each genome, whatever the seed
    failed: bool  # all of them
    error: str


def explain(complete: Experiment, parts: Parts, out: Path = Path("runs")) -> Explanation:
    """Measure and count; the parts are used up.

    Args:
        out: the folder whose disk is looked at.
    """
    problem, optimizer = parts
    simulator, network = problem.simulator, problem.representation
    genomes = optimizer.ask()
    measured = measure(problem, genomes)
    first = later = len(genomes)
    if first <= MOST_BRED:
        optimizer.tell(np.arange(first, dtype=np.float64), np.zeros((first, len(optimizer.measures))))
        later = len(optimizer.ask())
    generations, trials = complete.generations, complete.problem.trials
    evaluations = first + (generations - 1) * later
    played = {count: rounds(problem, count) for count in {first, later}}
    simulations = trials * (sum(played[first]) + (generations - 1) * sum(played[later]))
    participants, name = simulator.participants, complete.problem.simulator
    agents = simulator.agents if isinstance(simulator, Varied) else (len(simulator.owners),) * 2
    slots = experiment.slots_of_this_machine(complete.cluster)
    hidden = complete.representation.settings.get("hidden")
    size = network.genome_bytes or int(np.mean([len(genome) for genome in genomes]))
    each = TRIAL + METRIC * len(simulator.metrics) + (participants - 1) * PARTICIPANT
    record = evaluations * (size + CANDIDATE) + simulations * each + generations * GENERATION
    return Explanation(
        experiment=complete.name,
        simulator=name,
        about=" ".join((inspect.getdoc(plugins.load("simulator", name)) or "").partition("\n\n")[0].split()),
        ranges={".".join(path): ranges.words(one) for path, one in ranges.found(complete.problem.settings).items()},
        agents=agents[0],
        most_agents=agents[1],
        participants=participants,
        inputs=simulator.inputs,
        hidden=hidden if isinstance(hidden, int) else None,
        outputs=simulator.outputs,
        sensors=list(simulator.sensors),
        actuators=list(simulator.actuators),
        metrics=list(simulator.metrics),
        trials=trials,
        representation=complete.representation.kind,
        genome_numbers=network.genes,
        genome_bytes=network.genome_bytes,
        ranking=complete.ranking.kind,
        games=sum(played[first]),
        optimizer=complete.optimizer.kind,
        portable=parts.optimizer.portable,
        runs=complete.study.runs(),
        generations=generations,
        candidates_first_generation=first,
        candidates_later_generations=later,
        evaluations=evaluations,
        simulations=simulations,
        trial_s=measured.trial_s,
        slots=slots,
        seconds=_seconds(played[first], played[later], complete, measured.trial_s, slots),
        seconds_elsewhere=_seconds(played[first], played[later], complete, measured.trial_s, EXAMPLE_SERVERS * EXAMPLE_SLOTS),
        record_bytes=record,
        warnings=_warnings(complete, measured, first, record, out),
    )


def rounds(problem: Problem, candidates: int) -> list[int]:
    """Games in each round of a generation, if all of them are tied."""
    played: list[Round] = []
    while (games := problem.ranking.next_games(candidates, played)) is not None:
        played.append(Round(games, np.zeros(games.shape)))
    return [len(round_.games) for round_ in played]


def measure(problem: Problem, genomes: list[bytes]) -> Measured:
    """Play candidates until the time of a trial is known; what has to be compiled is not counted."""
    simulator, network = problem.simulator, problem.representation
    evaluate.warm_up(simulator, network)
    if problem.experiment.problem.trials > 1:
        seeds = problem.trial_seeds(0)[: MOST_SEEDS if isinstance(simulator, Varied) else 2]
    else:
        seeds = np.array([problem.trial_seeds(generation)[0] for generation in (0, 1)], np.uint64)
        fixed = simulator.fixed_seeds(2)
        seeds = seeds if fixed is None else np.array(fixed, np.uint64)
        if fixed is None and seeds[0] == seeds[1]:
            seeds[1] += np.uint64(1)
    played, taken, number, fitness, error, same = 0, 0.0, 1, [], "", True
    while taken < MEASURED_S and played < MOST_PLAYED:
        some = [genomes[index % len(genomes)] for index in range(played // 2, played // 2 + number)]
        games = (np.arange(len(some))[:, None] + np.arange(simulator.participants)) % len(some)
        participants = np.repeat(games, len(seeds), axis=0)
        begin = time.perf_counter()
        outcomes = evaluate.evaluate(simulator, network, some, participants, np.tile(seeds, len(some)))
        taken += time.perf_counter() - begin
        played += len(participants)
        number *= 2
        fitness.append(outcomes.fitness[:, 0].reshape(-1, len(seeds)))
        metrics = outcomes.metrics.reshape(len(some), len(seeds), -1)
        same = same and np.array_equal(metrics, np.repeat(metrics[:, :1], len(seeds), axis=1), equal_nan=True)
        error = error or outcomes.error
    together = np.concatenate(fitness)
    whole = together[~np.isnan(together).any(axis=1)]
    differs = bool((whole[:, :1] != whole).any())
    return Measured(taken / played, differs, same and not differs and len(whole) > 0, bool(np.isnan(together).all()), error)


def _seconds(first: list[int], later: list[int], complete: Experiment, trial_s: float, slots: int) -> float:
    """Whole turns of trials; a generation waits for the last one, and so does every round of games in it."""
    turns = [sum(-(-games * complete.problem.trials // slots) for games in rounds) for rounds in (first, later)]
    return trial_s * (turns[0] + (complete.generations - 1) * turns[1])


def _warnings(complete: Experiment, measured: Measured, first: int, record: int, out: Path) -> list[str]:
    found = []
    if measured.failed:
        found.append(f"every trial that was tried failed{': ' + measured.error if measured.error else ''}; nothing can evolve")
    elif measured.error:
        found.append(f"a trial that was tried failed: {measured.error}; the candidate is ranked last")
    if complete.generations == 1:
        found.append("generations = 1: random candidates are judged, and nothing evolves")
    if first < FEW:
        found.append(f"only {first} candidates in a generation: evolution needs a choice; 50 is usual")
    if complete.problem.trials == 1 and measured.differs:
        found.append(
            "trials = 1: one trial judges a candidate, and trials differ, so luck decides; problem.trials = 10 judges better"
        )
    if complete.problem.trials > 1 and measured.same:
        found.append(
            f"trials = {complete.problem.trials}: the trials do not differ, nothing in them depends on the seed; "
            "problem.trials = 1 finds the same in less time"
        )
    folder = next(path for path in (out.absolute(), *out.absolute().parents) if path.exists())
    if record > (free := shutil.disk_usage(folder).free):
        found.append(f"the record needs about {in_bytes(record)}, and {in_bytes(free)} are free in {out}")
    return found


def in_bytes(count: float) -> str:
    """``12 kB``, ``3.4 GB``."""
    for unit in ("bytes", "kB", "MB", "GB"):
        if count < 1000:
            return f"{count:.3g} {unit}" if unit != "bytes" else f"{count:.0f} bytes"
        count /= 1000
    return f"{count:.3g} TB"


def in_time(seconds: float) -> str:
    """``0.12 ms``, ``34 s``, ``5 min``, ``2.5 days``."""
    for factor, unit, up_to in UNITS:
        if seconds < up_to:
            return f"{_figures(seconds / factor)} {unit}"
    return f"{_figures(seconds / 86_400)} days"


def _figures(value: float) -> str:
    return f"{value:.0f}" if value >= 99.5 else f"{value:.2g}"


def as_mapping(explanation: Explanation) -> dict[str, Any]:
    """For JSON."""
    mapping: dict[str, Any] = msgspec.to_builtins(explanation)
    return mapping
