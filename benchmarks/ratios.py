"""Ratios of this machine beside those that are checked in, in two minutes: `make bench-quick`.

Each is of two things measured here and now, in turns, so that most of what differs between machines cancels out. One that is
worse than ``ratios.json`` says by more than its tolerance ends this with exit code 1. ``--keep`` writes what was found there.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import dispatch
import machine
from runs import simulations_per_s

HERE = Path(__file__).resolve().parent
KEPT = HERE / "ratios.json"
ROUNDS = 3
POPULATION = 400
KERNEL_S = 60.0
GENERATIONS = 60  # of a whole run


class Ratio(NamedTuple):
    """What was found beside what is kept; higher is better.

    Attributes:
        kept: None: nothing is.
        tolerance: share of it by which it may be worse.
    """

    name: str
    found: float
    kept: float | None
    tolerance: float

    @property
    def worse(self) -> bool:
        """By more than it may be."""
        return self.kept is not None and self.found < self.kept * (1 - self.tolerance)

    def __str__(self) -> str:
        if self.kept is None:
            return f"{'new':<6} {self.name}: {self.found:.3g}"
        verdict = "WORSE" if self.worse else "ok"
        return f"{verdict:<6} {self.name}: {self.found:.3g}, kept {self.kept:.3g}, tolerance {self.tolerance:.0%}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--keep", action="store_true", help="write what is found to ratios.json")
    parser.add_argument("--kept", type=Path, default=KEPT, help="[default: benchmarks/ratios.json]")
    options = parser.parse_args()
    os.environ["ZSWARM_PLAIN"] = "1"  # this process evaluates nothing
    machine.warn_if_busy()
    begin = time.monotonic()
    found: dict[str, float] = {}
    for part in PARTS:
        found |= part()
        print(f"... {time.monotonic() - begin:.0f} s", flush=True)
    if options.keep:
        kept = json.loads(options.kept.read_text()) if options.kept.exists() else {}
        options.kept.write_text(json.dumps(renewed(kept, found), indent=1) + "\n")
    ratios = compared(json.loads(options.kept.read_text()), found)
    for ratio in ratios:
        print(ratio)
    sys.exit(any(ratio.worse for ratio in ratios))


def compared(kept: dict[str, dict[str, float]], found: dict[str, float]) -> list[Ratio]:
    """What was found beside what is kept; what could not be found here is left out."""
    return [
        Ratio(name, value, kept.get(name, {}).get("ratio"), kept.get(name, {}).get("tolerance", TOLERANCE))
        for name, value in found.items()
    ]


def renewed(kept: dict[str, dict[str, float]], found: dict[str, float]) -> dict[str, dict[str, float]]:
    """What is to be kept: what was found, with the tolerances of before."""
    return kept | {
        name: {"ratio": float(f"{value:.3g}"), "tolerance": kept.get(name, {}).get("tolerance", TOLERANCE)}
        for name, value in found.items()
    }


TOLERANCE = 0.25


def beside_a_pool() -> dict[str, float]:
    """Dispatch: no-ops beside ProcessPoolExecutor one by one, and the share of work in the time of 5 ms sleeps."""
    values: dict[tuple[str, str, int], list[float]] = {}
    for slots in (2, 8):
        for _ in range(ROUNDS):
            for peer in ("zswarm", "ProcessPoolExecutor"):
                for row in dispatch.in_own_process(peer, slots, (POPULATION,), 0.5, ("noop", "sleep")):
                    if "missing" in row:
                        raise SystemExit(f"{peer}: {row['missing']}")
                    if row.get("cut") in ("by itself", "1"):
                        values.setdefault((peer, row["work"], slots), []).append(row.get("us", row.get("efficiency")))
    best = {key: (min if key[1] == "noop" else max)(each) for key, each in values.items()}
    found = {}
    for slots in (2, 8):
        found[f"no-op, {slots} slots: times faster than ProcessPoolExecutor"] = (
            best["ProcessPoolExecutor", "noop", slots] / best["zswarm", "noop", slots]
        )
        found[f"sleep 5 ms, {slots} slots: efficiency beside ProcessPoolExecutor's"] = (
            best["zswarm", "sleep", slots] / best["ProcessPoolExecutor", "sleep", slots]
        )
    return found


def kernel() -> dict[str, float]:
    """The flagship kernel beside the same in C; beside a batch in numpy where there is no compiler."""
    if not (HERE / "kernels.py").exists():
        return {}
    with tempfile.TemporaryDirectory() as folder:
        environment = {key: value for key, value in os.environ.items() if key != "ZSWARM_PLAIN"}
        command = [sys.executable, HERE / "kernels.py", "--quick", "--folder", folder]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, timeout=KERNEL_S, env=environment)
        rows = json.loads((Path(folder) / "kernels.json").read_text())["rows"]
    rate = {(row["kernel"], row["variant"], row["agents"]): row["agent_steps_per_s"] for row in rows if "missing" not in row}
    found = {}
    for (name, variant, agents), ours in rate.items():
        other = next((each for each in ("C", "numpy batch") if (name, each, agents) in rate), None)
        if variant == "numba" and other:
            found[f"{name}, {agents} agents: speed beside {other}"] = ours / rate[name, other, agents]
    return found


def whole_runs() -> dict[str, float]:
    """Whole runs beside as many simulations of the same field in a loop of one process, without any dispatch."""
    return {
        f"{field}, NNGA of 50: simulations/s of a run beside a loop's": max(
            simulations_per_s(field, GENERATIONS) for _ in range(ROUNDS)
        )
        / max(alone_per_s(field) for _ in range(ROUNDS))
        for field in ("stadium", "random")
    }


def alone_per_s(field: str) -> float:
    """Of a loop, in a process of its own, which does evaluate."""
    command = [sys.executable, HERE / "alone.py", field, str(GENERATIONS)]
    environment = {key: value for key, value in os.environ.items() if key != "ZSWARM_PLAIN"}
    return float(subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True, timeout=KERNEL_S, env=environment).stdout)


PARTS: list[Callable[[], dict[str, float]]] = [kernel, whole_runs, beside_a_pool]


if __name__ == "__main__":
    main()
