"""Measure simulations per second of whole runs: NNGA, 50 individuals and 200 generations.

From the end of the first generation to that of the last, as FREVO's figures are without its start;
and from the slots' start on.
"""

import argparse
import json
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

import machine
import tables

ROUNDS = 3
FIELDS = {"stadium": "stadium", "random": "emergency-exit"}  # and the example that has it


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=ROUNDS, help=f"[default: {ROUNDS}]")
    parser.add_argument(
        "--quick",
        action="store_true",
        help="one round of 5 generations: whether it works",
    )
    parser.add_argument(
        "--folder", type=Path, help="where the results go [default: build/bench]"
    )
    options = parser.parse_args()
    machine.warn_if_busy()
    begin = time.monotonic()
    rounds, generations = (1, 5) if options.quick else (options.rounds, 200)
    rates: dict[str, list[tuple[float, float]]] = {}
    for _ in range(rounds):
        for field in FIELDS:
            rates.setdefault(field, []).append(simulations_per_s(field, generations))
    rows = [
        {"field": field} | spread("per_s", under_way) | spread("whole_per_s", whole)
        for field, all_ in rates.items()
        for under_way, whole in [zip(*all_, strict=True)]
    ]
    file = machine.write(
        "runs",
        rows,
        folder=options.folder,
        rounds=rounds,
        seconds=round(time.monotonic() - begin),
    )
    print(
        f"{tables.runs(json.loads(file.read_text()))}\n{file}, {time.monotonic() - begin:.0f} s"
    )


def spread(key: str, rates: tuple[float, ...]) -> dict[str, Any]:
    return {
        key: statistics.median(rates),
        f"{key}_least": min(rates),
        f"{key}_most": max(rates),
    }


def simulations_per_s(field: str, generations: int) -> tuple[float, float]:
    """Return simulations per second between generations and from the start of a local run."""
    from zswarm import experiment
    from zswarm.ot import evolution
    from zswarm.ot.cluster.connection import Connection
    from zswarm.ot.logger import Logger

    loaded = experiment.load(
        experiment.find(FIELDS[field]),
        ["cluster.servers=local", f"generations={generations}"],
    )
    with (
        tempfile.TemporaryDirectory() as out,
        Connection(loaded.cluster) as connection,
        evolution.start(loaded, field, Path(out), connection, Logger()) as begun,
    ):
        ends = [(time.monotonic(), ended.evaluations) for ended in begun]
        result = begun.finish()
    (first, early), (last, all_) = ends[0], ends[-1]
    trials = loaded.problem.trials
    return (all_ - early) * trials / (
        last - first
    ), result.evaluations * trials / result.seconds


if __name__ == "__main__":
    main()
