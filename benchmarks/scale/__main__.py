"""Run many servers and one optimizer on one machine: `make scale`, or `make scale ARGS=--quick`.

The servers are true to the protocol: each has its own zenoh session on its own loopback port, the
slot table, keys, codec and liveliness token of `zswarm-ss`. Only evaluating is simulated: a batch
is finished when its trials' time has passed, and fitness is a number drawn from genome and seed.
Many servers share a process and its loop. The optimizer is the `Cluster` that `zswarm-ot run` uses,
in a process of its own.

Printed, as tables for docs/benchmarks.md: how long discovery and handshake take, how many messages,
what both sides use; the same with a router between optimizer and servers; how much of the slots'
time generations use; what is lost in tails, when slots
wait for the last trials of a generation, and what starting those twice would win. The charts go to
benchmarks/scale.png.
"""

import argparse
import statistics
import time
from pathlib import Path

import machine

from scale.farm import running
from scale.ideal import Schedule, schedule
from scale.life import live
from scale.pretended import Times, work
from scale.report import Fleet, Results, draw, print_tables, rows

TAILS = {
    "all alike": Times(0.5),
    "0.5 to 1.5 times the mean": Times(0.5, "uniform"),
    "heavy tail, the trial's own": Times(0.5, "heavy"),
    "heavy tail, the machine's": Times(0.5, "heavy", "execution"),
    "one server 10 times slower": Times(0.5, slow=10.0),
}


# s of a trial, trials per slot, from and up to servers.
LOADS = [(1.0, 10, 16, 1024), (0.1, 50, 16, 64), (4.0, 5, 256, 1024)]
ROUTED = (256, 1024)  # servers, also with a router


def measure(*, quick: bool) -> Results:
    """Measure all sizes."""
    results = Results({}, {}, {}, {})
    fleets = [Fleet(size) for size in ((16,) if quick else (16, 64, 256, 1024))]
    fleets += [Fleet(size, routed=True) for size in ((16,) if quick else ROUTED)]
    for fleet in fleets:
        size = fleet.servers
        with running(size, routed=fleet.routed) as servers:
            results.opened[fleet] = servers.mb
            runs = [live(servers, Times(), 0) for _ in range(1 if quick else 3)]
            results.found[fleet] = runs
            loads = LOADS[:1] if quick or fleet.routed else LOADS
            for mean_s, per_slot, smallest, largest in loads:
                if smallest <= size <= largest:
                    run = live(servers, Times(mean_s), 1 if quick else 2, per_slot)
                    if run.uses:
                        results.used[fleet, mean_s] = run
            if fleet == Fleet(16 if quick else 64):
                for name, times in TAILS.items():
                    run = live(servers, times, 1 if quick else 3)
                    schedules = [
                        schedule(times, work(g, run.uses[g].evaluations), size)
                        for g in range(len(run.uses))
                    ]
                    results.tails[name] = (
                        run,
                        Schedule(
                            *(
                                statistics.mean(each)
                                for each in zip(*schedules, strict=True)
                            )
                        ),
                    )
    return results


def main() -> None:
    """Measure, print, draw."""
    parser = argparse.ArgumentParser(description="How zswarm scales, on this machine.")
    parser.add_argument(
        "--quick",
        action="store_true",
        help="a small version, for looking whether it works",
    )
    parser.add_argument(
        "--chart",
        type=Path,
        default=Path(__file__).parent.with_suffix(".png"),
        help="where the charts go",
    )
    parser.add_argument(
        "--folder", type=Path, help="where the results go [default: build/bench]"
    )
    options = parser.parse_args()
    begin = time.monotonic()
    results = measure(quick=options.quick)
    machine.write(
        "scale",
        rows(results),
        folder=options.folder,
        seconds=round(time.monotonic() - begin),
    )
    print_tables(results)
    draw(results, options.chart)


if __name__ == "__main__":
    main()
