"""Compare ratios of this machine with the recorded ones, in two minutes: `make bench-quick`.

Each is of two things measured here and now, in turns, so that most of what differs between machines
cancels out. One that is worse than ``ratios.json`` says by more than its tolerance ends this with
exit code 1. ``--keep`` writes what was found there.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import dispatch
import machine
import results_file
from runs import simulations_per_s

HERE = Path(__file__).resolve().parent
KEPT = HERE / "ratios.json"
KERNEL_S = 300.0


class Size(NamedTuple):
    """The amount of work to measure."""

    rounds: int
    population: int
    seconds: float  # of dispatch, for each kind of work
    generations: int  # of a whole run


USUAL = Size(rounds=3, population=400, seconds=0.5, generations=60)
ONCE = Size(rounds=1, population=50, seconds=0.0, generations=5)


class Ratio(NamedTuple):
    """A measured ratio and the recorded one; higher is better.

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
        """Return whether the ratio is worse by more than its tolerance."""
        return self.kept is not None and self.found < self.kept * (1 - self.tolerance)

    def __str__(self) -> str:
        if self.kept is None:
            return f"{'new':<6} {self.name}: {self.found:.3g}"
        verdict = "WORSE" if self.worse else "ok"
        found = f"{self.name}: {self.found:.3g}, kept {self.kept:.3g}"
        return f"{verdict:<6} {found}, tolerance {self.tolerance:.0%}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument(
        "--keep", action="store_true", help="write what is found to ratios.json"
    )
    parser.add_argument(
        "--once",
        action="store_true",
        help="one small round, and no verdict: whether it works",
    )
    parser.add_argument(
        "--kept", type=Path, default=KEPT, help="[default: benchmarks/ratios.json]"
    )
    options = parser.parse_args()
    machine.warn_if_busy()
    begin = time.monotonic()
    size = ONCE if options.once else USUAL
    found: dict[str, float] = {}
    for part in PARTS:
        found |= part(size)
        print(f"... {time.monotonic() - begin:.0f} s", flush=True)
    if options.keep:
        kept = json.loads(options.kept.read_text()) if options.kept.exists() else {}
        results_file.write(options.kept, renewed(kept, found))
    ratios = compared(json.loads(options.kept.read_text()), found)
    for ratio in ratios:
        print(ratio)
    sys.exit(not options.once and any(ratio.worse for ratio in ratios))


def compared(kept: dict[str, dict[str, float]], found: dict[str, float]) -> list[Ratio]:
    """Compare found ratios with recorded ones; skip those not found here."""
    return [
        Ratio(
            name,
            value,
            kept.get(name, {}).get("ratio"),
            kept.get(name, {}).get("tolerance", TOLERANCE),
        )
        for name, value in found.items()
    ]


def renewed(
    kept: dict[str, dict[str, float]], found: dict[str, float]
) -> dict[str, dict[str, float]]:
    """Return the ratios to record: those found, with their previous tolerances."""
    return kept | {
        name: {
            "ratio": float(f"{value:.3g}"),
            "tolerance": kept.get(name, {}).get("tolerance", TOLERANCE),
        }
        for name, value in found.items()
    }


TOLERANCE = 0.25


def beside_a_pool(size: Size) -> dict[str, float]:
    """Compare no-ops and 5 ms sleeps with ProcessPoolExecutor."""
    values: dict[tuple[str, str, int], list[float]] = {}
    for slots in (2, 8):
        for _ in range(size.rounds):
            for peer in ("zswarm", "ProcessPoolExecutor"):
                for row in dispatch.in_own_process(
                    peer, slots, (size.population,), size.seconds, ("noop", "sleep")
                ):
                    if "missing" in row:
                        raise SystemExit(f"{peer}: {row['missing']}")
                    if row.get("cut") in ("automatic", "1"):
                        values.setdefault((peer, row["work"], slots), []).append(
                            row.get("us", row.get("efficiency"))
                        )
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


def kernel(size: Size) -> dict[str, float]:
    """Compare the flagship kernel with C, or with a numpy batch where there is no compiler."""
    if not (HERE / "kernels.py").exists():
        return {}
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, HERE / "kernels.py", "--quick", "--folder", folder]
        command += ["--rounds", str(size.rounds)]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, timeout=KERNEL_S)
        rows = json.loads((Path(folder) / "kernels.json").read_text())["rows"]
    rate = {
        (row["kernel"], row["variant"], row["agents"]): row["agent_steps_per_s"]
        for row in rows
        if "missing" not in row
    }
    found = {}
    for (name, variant, agents), ours in rate.items():
        other = next(
            (each for each in ("C", "numpy batch") if (name, each, agents) in rate), None
        )
        if variant == "numba" and other:
            found[f"{name}, {agents} agents: speed beside {other}"] = (
                ours / rate[name, other, agents]
            )
    return found


def whole_runs(size: Size) -> dict[str, float]:
    """Compare whole runs with as many simulations in a loop of one process."""
    return {
        f"{field}, NNGA of 50: simulations/s of a run beside a loop's": max(
            simulations_per_s(field, size.generations)[0] for _ in range(size.rounds)
        )
        / max(alone_per_s(field, size.generations) for _ in range(size.rounds))
        for field in ("stadium", "random")
    }


def alone_per_s(field: str, generations: int) -> float:
    """Return simulations per second of a loop in its own process."""
    command = [sys.executable, HERE / "alone.py", field, str(generations)]
    done = subprocess.run(
        command, check=True, stdout=subprocess.PIPE, text=True, timeout=KERNEL_S
    )
    return float(done.stdout)


PARTS: list[Callable[[Size], dict[str, float]]] = [kernel, whole_runs, beside_a_pool]


if __name__ == "__main__":
    main()
