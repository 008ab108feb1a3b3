"""Measure the four steps of docs/from-numpy.md: trials per second of CPU time.

    python benchmarks/from_numpy.py

It prints the table of the page. Each step is a process; rounds take turns, medians count.
"""

import re
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

PAGE = Path(__file__).resolve().parents[1] / "docs" / "from-numpy.md"
STEPS = {  # the blocks of the page that make a step's module
    "1. plain numpy": (0, 1),
    "2. the same, with equal bits": (0, 2),
    "3. compiled rules, turn by turn": (0, 3, 4),
    "4. whole trials compiled": (0, 3, 5),
}
ROUNDS = 3
MEASURE = """
import time
import numpy as np
import gather
from zswarm.evaluate import evaluate
from zswarm.kernels.random import Stream
from zswarm.testing.rules import fully_meshed

simulator = gather.Gather(gather.Settings())
network = fully_meshed(simulator.inputs, simulator.outputs)
genomes = network.random(1, Stream(1))

def seconds(trials):
    begin = time.process_time()
    rows, seeds = np.zeros((trials, 1), np.int64), np.arange(trials, dtype=np.uint64)
    evaluate(simulator, network, genomes, rows, seeds)
    return time.process_time() - begin

seconds(2)
trials = 4
while (taken := seconds(trials)) < 0.3:
    trials *= 2
print(trials / taken)
"""


def modules() -> dict[str, str]:
    """Return the module of each step, from the page."""
    blocks = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(), re.S | re.M)
    return {
        step: "\n\n".join(blocks[number] for number in numbers)
        for step, numbers in STEPS.items()
    }


def run(module: str, code: str, *options: str) -> str:
    """Run code in a process that can import a step's module as ``gather``; return its output."""
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "gather.py").write_text(module)
        Path(folder, "main.py").write_text(code)
        command = [sys.executable, *options, "main.py"]
        done = subprocess.run(
            command, cwd=folder, capture_output=True, text=True, check=False
        )
    if done.returncode:
        raise RuntimeError(done.stderr)
    return done.stdout


def main() -> None:
    """Print the table."""
    rates: dict[str, list[float]] = {step: [] for step in STEPS}
    for _ in range(ROUNDS):
        for step, module in modules().items():
            rates[step].append(float(run(module, MEASURE)))
    medians = {step: statistics.median(some) for step, some in rates.items()}
    first = next(iter(medians.values()))
    print(
        "| step | trials per second | | same bits on all machines |\n| --- | --- | --- | --- |"
    )
    for number, (step, rate) in enumerate(medians.items()):
        ratio = (
            f"{rate / first:.{0 if rate >= 9.95 * first else 1}f}x" if number else "1x"
        )
        same = "yes" if number else "no"
        print(f"| {step} | {float(f'{rate:.2g}'):,.0f} | {ratio} | {same} |")


if __name__ == "__main__":
    main()
