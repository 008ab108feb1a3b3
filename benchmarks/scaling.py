"""Time an optimization with one and more servers: real ``zswarm-ss`` daemons of one slot.

Whole runs, from looking for the servers to the last generation, record included: once with
evaluations that sleep 20 ms, which scale past the cores of this machine, and once with real ones
(the Stadium field), which cannot.
"""

import argparse
import contextlib
import json
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

import leased
import machine
import tables

SERVERS, ROUNDS = (1, 2, 4, 8, 16), 3
SLEEP_S = 0.02
WORKS = {"sleep": "sleeps of 20 ms", "real": "emergency-exit, stadium"}
SLEEPING = f"""
name = "sleep"
seed = 1
generations = 4
[problem]
simulator = "bench"
[problem.settings]
sleep_s = {SLEEP_S}
[representation]
kind = "fully-meshed"
[optimizer]
kind = "nnga"
population = 160
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--rounds", type=int, default=ROUNDS, help=f"[default: {ROUNDS}]")
    parser.add_argument(
        "--quick",
        action="store_true",
        help="one round, up to two servers: whether it works",
    )
    parser.add_argument(
        "--folder", type=Path, help="where the results go [default: build/bench]"
    )
    options = parser.parse_args()
    rounds, sizes = (1, SERVERS[:2]) if options.quick else (options.rounds, SERVERS)
    machine.warn_if_busy()
    begin = time.monotonic()
    found: dict[tuple[str, int], list[dict[str, float]]] = {}
    with leased.bench_simulator(), contextlib.ExitStack() as stack:
        endpoints = [f"tcp/127.0.0.1:{leased.free_port()}" for _ in range(max(sizes))]
        for number, endpoint in enumerate(endpoints):
            stack.enter_context(leased.daemon(1, endpoint, "--name", f"s{number}"))
        with leased.leased(endpoints, len(endpoints), {}):
            pass  # now all of them are there: a run waits 10 s for the number that it is told
        for work in WORKS:
            optimize(work, endpoints)  # once to warm all of them up
        for number in range(rounds):
            for work in WORKS:
                for size in sizes:
                    found.setdefault((work, size), []).append(
                        optimize(work, endpoints[:size])
                    )
            print(
                f"round {number + 1} of {rounds}: {time.monotonic() - begin:.0f} s",
                flush=True,
            )
    rows: list[dict[str, Any]] = []
    for (work, size), measured in found.items():
        seconds = sorted(each["s"] for each in measured)
        row = {"work": work, "servers": size, "evaluations": measured[0]["evaluations"]}
        row |= {
            "s": statistics.median(seconds),
            "s_least": seconds[0],
            "s_most": seconds[-1],
        }
        if work == "sleep":
            row["efficiency"] = row["evaluations"] * SLEEP_S / size / row["s"]
        rows.append(row)
    file = machine.write(
        "scaling",
        rows,
        folder=options.folder,
        rounds=rounds,
        seconds=round(time.monotonic() - begin),
    )
    print(
        f"{tables.scaling(json.loads(file.read_text()))}\n{file}, {time.monotonic() - begin:.0f} s"
    )


def optimize(work: str, endpoints: list[str]) -> dict[str, float]:
    """Run once on these servers; return seconds and evaluations."""
    from zswarm import experiment
    from zswarm.ot import evolution
    from zswarm.ot.cluster.connection import Connection
    from zswarm.ot.logger import Logger

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "sleep.toml").write_text(SLEEPING)
        file = folder / "sleep.toml" if work == "sleep" else experiment.find("stadium")
        where = [
            f"cluster.servers={len(endpoints)}",
            f"cluster.connect={json.dumps(endpoints)}",
            "cluster.multicast=false",
        ]
        loaded = experiment.load(file, where)
        begin = time.perf_counter()
        with (
            Connection(loaded.cluster) as connection,
            evolution.start(loaded, str(file), folder, connection, Logger()) as begun,
        ):
            result = begun.finish()
        return {"s": time.perf_counter() - begin, "evaluations": result.evaluations}


if __name__ == "__main__":
    main()
