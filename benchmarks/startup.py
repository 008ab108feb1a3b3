"""Measure how soon the first result is there, and the memory of programs.

- From pressing return to the first generation of ``zswarm-ot run stadium`` on two slots of this
  machine, each time a new program: with a warm cache of compiled kernels, and with an empty one
  (*cold*).
- The same of others, on two worker processes: to the first answer of a function that does nothing
(``dispatch.py``'s).
- Memory during a run: what each program has for itself alone, and with its share of what it
shares (PSS).
"""

import argparse
import contextlib
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import leased
import machine
import tables
from dispatch import in_own_process
from peers import PEERS
from usage import children, memory_mb

ROUNDS, COLD_ROUNDS = 3, 2
SLOTS = 2
CAPACITY = 4  # of the server whose memory is looked at
WARM_GENERATIONS = 200
RUN = ["-m", "zswarm.ot", "run", "stadium", "--json"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--rounds", type=int, default=ROUNDS, help=f"[default: {ROUNDS}]")
    parser.add_argument(
        "--quick", action="store_true", help="one round, without others: whether it works"
    )
    parser.add_argument(
        "--folder", type=Path, help="where the results go [default: build/bench]"
    )
    options = parser.parse_args()
    rounds = 1 if options.quick else options.rounds
    machine.warn_if_busy()
    begin = time.monotonic()
    first_generation({})  # fills the cache
    names = [name for name, known in PEERS.items() if SLOTS in (known.slots or (SLOTS,))]
    times: dict[tuple[str, str], list[float]] = {}
    missing: dict[str, str] = {}
    for _ in range(rounds):
        times.setdefault(("zswarm-ot run", "warm"), []).append(first_generation({}))
        for name in [] if options.quick else names:
            row = in_own_process(name, SLOTS, (), 0.0)[0]
            if "missing" in row:
                missing[name] = row["missing"]
            else:
                times.setdefault((name, "no-op"), []).append(row["first_s"])
    for _ in range(1 if options.quick else COLD_ROUNDS):
        with tempfile.TemporaryDirectory() as cache:
            times.setdefault(("zswarm-ot run", "cold"), []).append(
                first_generation({"ZSWARM_CACHE": cache})
            )
    rows: list[dict[str, Any]] = [
        {
            "what": "first result",
            "of": of,
            "how": how,
            "s": statistics.median(all_),
            "s_least": min(all_),
            "s_most": max(all_),
        }
        for (of, how), all_ in times.items()
    ]
    rows += [
        {"what": "first result", "of": name, "missing": reason}
        for name, reason in missing.items()
    ]
    rows += memory()
    packages = [package for known in PEERS.values() for package in known.distributions]
    file = machine.write(
        "startup",
        rows,
        packages,
        folder=options.folder,
        rounds=rounds,
        seconds=round(time.monotonic() - begin),
    )
    print(
        f"{tables.startup(json.loads(file.read_text()))}\n{file}, {time.monotonic() - begin:.0f} s"
    )


@contextlib.contextmanager
def run(
    *more: str, environment: dict[str, str] | None = None
) -> Iterator["subprocess.Popen[str]"]:
    """Start a run and read its lines; end it with the context."""
    with (
        tempfile.TemporaryDirectory() as folder,
        subprocess.Popen(
            [sys.executable, *RUN, "--no-multicast", "--out", folder, *more],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=os.environ | {"ZSWARM_KEYS": "none"} | (environment or {}),
        ) as process,
    ):
        try:
            yield process
        finally:
            # Unlike Ctrl-C, this also reaches a program that a shell started in the background
            process.terminate()
            process.communicate()


def generation(process: "subprocess.Popen[str]") -> dict[str, Any]:
    """Return the next line of a run."""
    assert process.stdout is not None
    if line := process.stdout.readline():
        return json.loads(line)
    raise SystemExit(f"the run ended: {process.communicate()[1][-2000:]}")


def first_generation(environment: dict[str, str]) -> float:
    """Return seconds from start to the first generation's line."""
    begin = time.perf_counter()
    options = ["--set", "cluster.servers=local", "--set", f"cluster.local_slots={SLOTS}"]
    with run(*options, environment=environment) as process:
        generation(process)
        return time.perf_counter() - begin


def memory() -> list[dict[str, Any]]:
    """Return the memory of each program during a run."""
    endpoint = f"tcp/127.0.0.1:{leased.free_port()}"
    options = ["--connect", endpoint, "--servers", "1", "--set", "generations=1000000"]
    with leased.daemon(CAPACITY, endpoint) as server, run(*options) as process:
        while generation(process)["generation"] < WARM_GENERATIONS:
            pass
        found = {
            "optimizer": [process.pid],
            "server": [server.pid],
            "fork server": [],
            "slot": [],
        }
        for child in children(server.pid):
            if slots := children(child):
                found["fork server"].append(child)
                found["slot"] += slots
        rows = []
        for name, pids in found.items():
            own, shared = zip(*map(memory_mb, pids), strict=True)
            rows.append(
                {
                    "what": "memory",
                    "of": name,
                    "own_mb": max(own),
                    "pss_mb": max(shared),
                    "processes": len(pids),
                }
            )
    return rows


if __name__ == "__main__":
    main()
