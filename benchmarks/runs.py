"""Simulations per second of whole runs: NNGA with 50 individuals and 200 generations, everything included but the start."""

import argparse
import json
import os
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
    parser.add_argument("--quick", action="store_true", help="one round of 20 generations: whether it works")
    parser.add_argument("--folder", type=Path, help="where the results go [default: build/bench]")
    options = parser.parse_args()
    os.environ["ZSWARM_PLAIN"] = "1"  # this process evaluates nothing
    machine.warn_if_busy()
    begin = time.monotonic()
    rounds, generations = (1, 20) if options.quick else (options.rounds, 200)
    rates: dict[str, list[float]] = {}
    for _ in range(rounds):
        for field in FIELDS:
            rates.setdefault(field, []).append(simulations_per_s(field, generations))
    rows: list[dict[str, Any]] = [
        {"field": field, "per_s": statistics.median(all_), "per_s_least": min(all_), "per_s_most": max(all_)}
        for field, all_ in rates.items()
    ]
    file = machine.write("runs", rows, folder=options.folder, rounds=rounds, seconds=round(time.monotonic() - begin))
    print(f"{tables.runs(json.loads(file.read_text()))}\n{file}, {time.monotonic() - begin:.0f} s")


def simulations_per_s(field: str, generations: int) -> float:
    """Of a run on this machine's slots, one per core; a candidate is as many simulations as it has trials."""
    from zswarm import experiment
    from zswarm.ot import evolution
    from zswarm.ot.connection import Connection
    from zswarm.ot.logger import Logger

    loaded = experiment.load(experiment.find(FIELDS[field]), ["cluster.servers=local", f"generations={generations}"])
    with (
        tempfile.TemporaryDirectory() as out,
        Connection(loaded.cluster) as connection,
        evolution.start(loaded, field, Path(out), connection, Logger()) as begun,
    ):
        result = begun.finish()
    return result.evaluations * loaded.problem.trials / result.seconds


if __name__ == "__main__":
    main()
