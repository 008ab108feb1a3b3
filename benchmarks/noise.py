"""Compare what runs report with what their champions do on 500 held-out seeds, on four problems.

Each problem is searched with fixed seeds and with fresh ones, from 20 run seeds, by the optimizer
of its example. Each search ends with an assessment as in `zswarm-ot run`; a search without one has
as many more generations as the assessment has simulations. Racing is compared with equal allocation
on candidates whose true order many trials have shown. Runs are played in processes of this program,
one per core, without servers and record: no time is measured.
"""

import argparse
import json
import multiprocessing
import os
import time
from pathlib import Path
from typing import Any, NamedTuple

import machine
import numpy as np
import tables

SEEDS = 20
HELD_OUT = 500  # seeds on which a champion is judged
MODES = {"fixed": [], "fresh": ["problem.seeds=fresh"]}
CHOICES = 5  # runs of a problem whose last generation is raced again and again
TRUTH = 200  # trials that show the true order of its candidates
REPEATS = 300


class Task(NamedTuple):
    """A problem: an example, changes to it, and simulations per run."""

    example: str
    changes: list[str]
    simulations: int


TASKS = {
    "minisim": Task("minisim", [], 10_000),
    # Else it has FREVO's fields, whose seeds are fixed.
    "emergency-exit": Task("emergency-exit", ["problem.settings.seed=-1"], 10_000),
    "arena-foraging": Task("arena-foraging", [], 3_000),
    # Smaller than the example, which takes 12 ms for a simulation.
    "foraging-physical": Task(
        "foraging-physical",
        [
            f"problem.settings.{key}"
            for key in ("steps=50", "robots=2", "pucks=3", "side=2.5")
        ],
        1_000,
    ),
}


class Run(NamedTuple):
    """One of a mode on a task."""

    task: str
    mode: str
    seed: int
    simulations: int
    held_out: int


class Champion(NamedTuple):
    """Fitness per trial: as reported, and on held-out seeds."""

    reported: float
    held_out: float


class Ended(NamedTuple):
    """What a run left."""

    run: Run
    search: Champion  # the best in search, without an assessment
    assessed: Champion
    choice: list[np.ndarray]  # see chosen: at most one


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument(
        "--seeds", type=int, default=SEEDS, help=f"runs of each mode [default: {SEEDS}]"
    )
    parser.add_argument("--only", help="problems, with commas between [default: all]")
    parser.add_argument(
        "--quick",
        action="store_true",
        help="two problems and seeds, small runs: whether it works",
    )
    parser.add_argument(
        "--folder", type=Path, help="where the results go [default: build/bench]"
    )
    options = parser.parse_args()
    os.environ["OPENBLAS_NUM_THREADS"] = "1"  # in processes: as many as cores
    begin, seeds = time.monotonic(), 2 if options.quick else options.seeds
    tasks = options.only.split(",") if options.only else list(TASKS)
    if options.quick:
        tasks = tasks[:2]
    runs = [
        Run(task, mode, seed, 900, 20)
        if options.quick
        else Run(task, mode, seed, TASKS[task].simulations, HELD_OUT)
        for task in tasks
        for mode in MODES
        for seed in range(1, seeds + 1)
    ]
    found: dict[str, dict[str, list[Ended]]] = {}
    with multiprocessing.get_context("spawn").Pool(len(os.sched_getaffinity(0))) as pool:
        for number, ended in enumerate(pool.imap(play, runs), 1):
            modes = found.setdefault(ended.run.task, {})
            modes.setdefault(ended.run.mode, []).append(ended)
            if number % seeds:
                continue
            rows = [
                row(task, mode, found[task]) for task in found for mode in found[task]
            ]
            about = {"seeds": seeds, "seconds": round(time.monotonic() - begin)}
            file = machine.write("noise", rows, folder=options.folder, **about)
            print(f"{ended.run[:2]}: {number} of {len(runs)} runs, {about}", flush=True)
    print(f"{tables.noise(json.loads(file.read_text()))}\n{file}")


def row(task: str, mode: str, modes: dict[str, list[Ended]]) -> dict[str, Any]:
    """Return medians over the runs of a mode, and how likely its champions beat others."""
    runs, fixed = modes[mode], modes["fixed"]
    made: dict[str, Any] = {
        "task": task,
        "mode": mode,
        "simulations": runs[0].run.simulations,
    }
    for name in ("search", "assessed"):
        both = np.array([getattr(one, name) for one in runs])
        gap = (both[:, 0] - both[:, 1]) / np.abs(both[:, 1])
        made |= {
            f"{name}_reported": float(np.median(both[:, 0])),
            name: float(np.median(both[:, 1])),
            f"{name}_gap": float(np.median(gap)),
            f"{name}_error": float(np.median(np.abs(gap))),
            f"{name}_beats_fixed": a12(held_out(runs, name), held_out(fixed, name)),
        }
    made["assessed_beats_search"] = a12(
        held_out(runs, "assessed"), held_out(runs, "search")
    )
    if choices := [choice for one in runs for choice in one.choice]:
        names = ("saved", "right_raced", "right_equal", "right_fewer")
        mean = np.mean(choices, axis=0).tolist()
        made["choice"] = dict(zip(names, mean, strict=True))
    return made


def held_out(runs: list[Ended], name: str) -> np.ndarray:
    """Return the held-out fitness of each run's champion."""
    return np.array([getattr(one, name).held_out for one in runs])


def a12(some: np.ndarray, others: np.ndarray) -> float:
    """Return the probability that one of some is above one of others; ties count half."""
    differences = some[:, None] - others
    return float(np.mean((differences > 0) + 0.5 * (differences == 0)))


def play(run: Run) -> Ended:
    """Search, assess, and judge both champions."""
    from zswarm.ot.assessment.amount import SHARE
    from zswarm.ot.assessment.contest import Contest
    from zswarm.ot.record.contenders import Contenders, of_generation
    from zswarm.ot.record.history_hash import digest

    search = Search(run)
    problem, trials = search.problem, search.problem.experiment.problem.trials
    contenders, genomes = Contenders(20), {}
    champion, contest = (b"", 0.0), None
    while True:
        asked, fitness, assessed_at = search.generation()
        if search.played > run.simulations:
            break
        champion = search.optimizer.best()
        if search.played * (1 + SHARE) <= run.simulations:
            digests = [digest(genome) for genome in asked]
            genomes |= dict(zip(digests, asked, strict=True))
            contenders.add(of_generation(assessed_at, digests, fitness.tolist()))
            found = contenders.ranked()
            budget = int(SHARE * search.played)
            contest = [genomes[one.digest] for one in found], found, budget
    assert contest is not None
    raced = Contest(
        problem, contest[0], [one.fitness for one in contest[1]], contest[2], differ=True
    )
    while (work := raced.workload()) is not None:
        evaluate(problem, work)
        raced.take(work)
    winner = raced.champion()
    assert winner is not None
    genome, reported = winner
    assert reported.mean is not None
    best, in_search = champion
    judged = {one: judge(run, problem, one) for one in {best, genome}}
    choice = run.mode == "fixed" and run.seed <= CHOICES
    return Ended(
        run,
        Champion(in_search / trials, judged[best]),
        Champion(reported.mean / trials, judged[genome]),
        [chosen(search, asked, run)] if choice else [],
    )


class Search:
    """A search without servers and record.

    Attributes:
        played: trials so far.
    """

    def __init__(self, run: Run) -> None:
        from zswarm import experiment
        from zswarm.ot.assessment.seen_seeds import SeenSeeds
        from zswarm.ot.build import build

        task = TASKS[run.task]
        changes = [*task.changes, *MODES[run.mode], f"seed={run.seed}"]
        file = experiment.load(experiment.find(task.example), changes)
        self.problem, self.optimizer = build(experiment.complete(file, task.example))
        self._seen = SeenSeeds()
        self.played = 0

    def generation(self) -> tuple[list[bytes], np.ndarray, int]:
        """Return the genomes of the next one, their fitness, and its number."""
        genomes, number = self.optimizer.ask(), self.optimizer.generation
        work = self.problem.workload(genomes, number)
        evaluate(self.problem, work)
        self.played += len(work.seeds)
        fitness = self.problem.total(work)
        if self.optimizer.fresh:
            none = np.empty((len(fitness), 0))
            fitness, _ = self._seen.merge(genomes, fitness, none)
        self.optimizer.tell(fitness)
        return genomes, fitness, number


def evaluate(problem: Any, work: Any) -> None:
    """Fill in a workload's outcomes."""
    from zswarm import evaluate

    played = evaluate.evaluate(
        problem.simulator,
        problem.representation,
        work.genomes,
        work.participants,
        work.seeds,
    )
    work.fitness[:], work.metrics[:] = played.fitness, played.metrics


def judge(run: Run, problem: Any, genome: bytes) -> float:
    """Return a champion's mean fitness on seeds that neither search nor assessment plays."""
    from zswarm.kernels.random import derive_seed

    seeds = [derive_seed(run.seed, "benchmark", n) for n in range(run.held_out)]
    work = problem.workload([genome], 0, np.array(seeds, np.uint64))
    evaluate(problem, work)
    return float(work.fitness.mean())


def chosen(search: Search, asked: list[bytes], run: Run) -> np.ndarray:
    """Race the last generation again and again, with trials drawn from those that it has.

    Returns:
        The share of trials saved, and the share of the true survivors among those chosen: by
        racing, by all trials, and by equally many for each as racing has in the mean.
    """
    from zswarm.kernels.random import derive_seed

    problem, count = search.problem, max(TRUTH if run.held_out >= HELD_OUT else 20, 20)
    trials, survivors = problem.experiment.problem.trials, search.optimizer.survivors
    seeds = [derive_seed(run.seed, "truth", n) for n in range(count)]
    work = problem.workload(asked, 0, np.array(seeds, np.uint64))
    evaluate(problem, work)
    outcomes = work.fitness.reshape(len(asked), count)
    best = np.argsort(-outcomes.mean(axis=1), kind="stable")[:survivors]
    found, draw = [], np.random.default_rng(run.seed)
    for _ in range(REPEATS):
        drawn = outcomes[:, draw.choice(count, trials, replace=False)]
        raced, played = race(drawn, survivors)
        fewer = drawn[:, : max(1, round(trials * played))]
        picked = (raced, drawn.sum(axis=1), fewer.sum(axis=1))
        right = [
            len(np.intersect1d(best, np.argsort(-one, kind="stable")[:survivors]))
            for one in picked
        ]
        found.append((1 - played, *(hits / len(best) for hits in right)))
    mean: np.ndarray = np.mean(found, axis=0)
    return mean


def race(fitness: np.ndarray, survivors: int) -> tuple[np.ndarray, float]:
    """Return the totals of racing, and the share of the trials that it has played."""
    from zswarm.ot.assessment import racing

    running, played = np.arange(len(fitness)), np.zeros(len(fitness), int)
    for end in racing.rounds(fitness.shape[1]):
        played[running] = end
        running = running[racing.remaining(fitness[running, :end], survivors)]
    return racing.totals(fitness, played), float(played.mean() / fitness.shape[1])


if __name__ == "__main__":
    main()
