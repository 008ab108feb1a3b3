"""Compare a third-party program as simulator with the compiled kernel, in CPU time per trial.

    make -C examples/foreign/c && javac -d examples/foreign/java/classes
    examples/foreign/java/*.java python benchmarks/foreign.py

Time of this process and of the program's own is added; rounds take turns, medians count. The rows
are those of docs/foreign.md.
"""

import os
import statistics
import time
from pathlib import Path
from typing import Any

EXAMPLES = Path(__file__).resolve().parents[1] / "examples" / "foreign"
os.environ["ZSWARM_SIMULATORS"] = os.pathsep.join(
    str(EXAMPLES / language) for language in ("c", "java")
)

import numpy as np  # noqa: E402
from tables import figure, markdown  # noqa: E402

from zswarm.evaluate import build, evaluate  # noqa: E402
from zswarm.kernels.random import Stream  # noqa: E402

WAYS = {
    "`emergency-exit`, compiled by numba": ("emergency-exit", False),
    "in C, whole trials": ("emergency-exit-c", False),
    "in C, turns": ("emergency-exit-c", True),
    "in Java, turns": ("emergency-exit-java", True),
}
FIELDS = {"random": "10 robots", "stadium": "72 robots"}
ROUNDS, LEAST_S = 5, 0.5
TICK = os.sysconf("SC_CLK_TCK")


class Way:
    """One way to play the trials of a field."""

    def __init__(self, simulator: str, in_turns: bool, field: str) -> None:
        self.simulator, self.network = build(
            simulator, {"field": field}, "fully-meshed", {}
        )
        if in_turns:
            self.simulator.hosted = None
        self.genomes = self.network.random(16, Stream(1))
        self.turns = 0
        self.play(16)  # warms up

    def play(self, trials: int) -> bytes:
        """Play that many trials and return their fitness as bytes."""
        rows, seeds = (
            np.arange(trials).reshape(-1, 1) % 16,
            np.arange(trials, dtype=np.uint64),
        )
        return evaluate(
            self.simulator, self.network, self.genomes, rows, seeds
        ).fitness.tobytes()

    def microseconds(self) -> float:
        """Return the CPU time per trial in microseconds."""
        trials = 16
        while True:
            begin = self.spent()
            self.play(trials)
            if (elapsed := self.spent() - begin) >= LEAST_S:
                return elapsed / trials * 1e6
            trials *= 2 if elapsed > LEAST_S / 8 else 8

    def spent(self) -> float:
        """Return the CPU time of both processes in seconds; the program's comes in hundredths."""
        spare: Any = getattr(self.simulator, "spare", None)
        if spare is None:
            return time.process_time()
        fields = (
            Path(f"/proc/{spare[0]._process.pid}/stat")
            .read_text()
            .rpartition(") ")[2]
            .split()
        )
        return time.process_time() + (int(fields[11]) + int(fields[12])) / TICK


def main() -> None:
    columns = {}
    for field in FIELDS:
        ways = {
            name: Way(simulator, in_turns, field)
            for name, (simulator, in_turns) in WAYS.items()
        }
        assert len({way.play(16) for way in ways.values()}) == 1, "not the same bits"
        found: dict[str, list[float]] = {name: [] for name in ways}
        for _ in range(ROUNDS):
            for name, way in ways.items():
                found[name].append(way.microseconds())
        columns[field] = {name: statistics.median(times) for name, times in found.items()}
    rows = [[name, *(figure(columns[field][name]) for field in FIELDS)] for name in WAYS]
    print(
        markdown(
            [
                "us of CPU time per trial",
                *(f"{field}, {robots}" for field, robots in FIELDS.items()),
            ],
            rows,
        )
    )


if __name__ == "__main__":
    main()
