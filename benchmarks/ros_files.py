"""Time a candidate on the launch-file route, with each form of a controller.

Wall-clock seconds, the median of some trials of the example in examples/ros/files; roslaunch must
be installed, and a C compiler.
"""

import os
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from zswarm import evaluate
from zswarm.kernels.random import Stream
from zswarm.ros.launch import logs, roslaunch

EXAMPLE = Path(__file__).parents[1] / "examples" / "ros" / "files"
TRIALS = 7
STEPS = ("export", "compile", "launch and play", "read the logs")


def main() -> None:
    os.environ["ZSWARM_SIMULATORS"] = str(EXAMPLE)
    print(f"{'s per candidate':16}" + "".join(f"{step:>18}" for step in STEPS))
    for form in ("yaml", "json", "c99"):
        print(
            f"{form:16}"
            + "".join(f"{seconds:18.4f}" for seconds in measure(f"exit-{form}"))
        )


def measure(name: str) -> list[float]:
    """Return the seconds of each step."""
    simulator, network = evaluate.build(
        name, {"robots": 10, "steps": 50}, "fully-meshed", {}
    )
    supervisor, package = simulator._copied()
    told = roslaunch.environment(supervisor.folder, package.parent)
    controller, results = simulator.manifest.controller, package / simulator.manifest.logs
    rows = []
    for seed, genome in enumerate(network.random(TRIALS + 1, Stream(1))):
        results.mkdir(exist_ok=True)
        arguments, export_s = timed(simulator._write, package, genome, seed)
        compile_s = (
            timed(supervisor.run, controller.rebuild, package, told)[1]
            if controller.rebuild
            else 0.0
        )
        _, launch_s = timed(
            roslaunch.launch,
            supervisor,
            package / simulator.manifest.launch,
            arguments,
            told,
        )
        _, read_s = timed(lambda: logs.fitness("cpswarm-log", logs.read(results, 10)))
        rows.append((export_s, compile_s, launch_s, read_s))
    # The first fills caches.
    return [statistics.median(column) for column in zip(*rows[1:], strict=True)]


def timed(function: Callable[..., Any], *arguments: Any) -> tuple[Any, float]:
    begin = time.perf_counter()
    result = function(*arguments)
    return result, time.perf_counter() - begin


if __name__ == "__main__":
    main()
