"""The paper's file-based design: export C, compile it, run it, read its logs.

Parameters, representation and logs are files, as in the paper. The representation is the C99 pair
of ``zswarm-ot export``; the simulator is the emergency exit of ``examples/foreign/c``. It is
compiled by the C compiler alone, or by ``catkin_make`` as a package of ROS 1, which is what the
paper's 8.8 seconds are of.
"""

import contextlib
import itertools
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from zswarm.champion.controller import Controller
from zswarm.ot.problem import Problem
from zswarm.ot.workload import Workload
from zswarm.robots.c import c99

HERE = Path(__file__).resolve().parent
EXAMPLE = HERE.parents[1] / "examples" / "foreign" / "c"
FLAGS = ("-O2", "-std=c11", "-D_POSIX_C_SOURCE=200809L", "-ffp-contract=off")
BUILDS = {"cc": "gcc", "catkin": "catkin_make"}  # and the program that each needs
# Modules of catkin are those of the system's Python.
SYSTEM = {"PATH": "/usr/local/bin:/usr/bin:/bin"}
PACKAGE = """<package format="2"><name>exit_world</name><version>1.0.0</version>
<description>Emergency exit</description>
<maintainer email="nobody@example.org">nobody</maintainer><license>Apache-2.0</license>
<buildtool_depend>catkin</buildtool_depend></package>
"""
LISTS = f"""cmake_minimum_required(VERSION 3.5)
project(exit_world C)
find_package(catkin REQUIRED)
catkin_package()
add_compile_options({" ".join(FLAGS)})
add_executable(exit_world exit_world.c zs_candidate.c)
target_include_directories(exit_world PRIVATE {EXAMPLE})
target_link_libraries(exit_world m)
"""


class Spent(NamedTuple):
    """Seconds of one candidate."""

    export_s: float
    compile_s: float
    simulate_s: float
    fitness_s: float


class Files:
    """A workspace in which one candidate after another is compiled and simulated.

    Attributes:
        spent: of each candidate so far.
    """

    def __init__(self, folder: Path, build: str) -> None:
        self.spent: list[Spent] = []
        self._workspace, self._logs = folder, folder / "run"
        self._logs.mkdir()
        self._package = folder / "src" / "exit_world"
        self._package.mkdir(parents=True)
        shutil.copy(HERE / "exit_world.c", self._package)
        catkin = build == "catkin"
        self._program = folder / (
            "devel/lib/exit_world/exit_world" if catkin else "exit_world"
        )
        if catkin:
            (self._package / "package.xml").write_text(PACKAGE)
            (self._package / "CMakeLists.txt").write_text(LISTS)
        compiled = [
            str(self._package / name) for name in ("exit_world.c", "zs_candidate.c")
        ]
        compiler = [
            "gcc",
            *FLAGS,
            f"-I{EXAMPLE}",
            *compiled,
            "-o",
            str(self._program),
            "-lm",
        ]
        self._build = ["catkin_make", "-C", str(folder)] if catkin else compiler

    def play(self, problem: Problem, workload: Workload) -> None:
        """Simulate, one candidate after another."""
        for trial, seed in enumerate(workload.seeds):
            genome = workload.genomes[workload.participants[trial, 0]]
            workload.fitness[trial, 0] = self._simulate(
                problem, problem.controller(genome, 0.0, "paper"), int(seed)
            )

    def _simulate(self, problem: Problem, controller: Controller, seed: int) -> float:
        settings = problem.experiment.problem.settings
        times = [time.perf_counter()]
        parameters = {name: settings[name] for name in ("agents", "steps", "step_s")} | {
            "trial_seed": seed
        }
        (self._logs / "parameters.yaml").write_text(
            "".join(f"{name}: {value}\n" for name, value in parameters.items())
        )
        for name, text in c99.pair(controller, "candidate").items():
            (self._package / name).write_text(text)
        times.append(time.perf_counter())
        _done(self._build, self._workspace)
        times.append(time.perf_counter())
        _done([str(self._program)], self._logs)
        times.append(time.perf_counter())
        fitness = judged(self._logs, settings["agents"], settings["steps"])
        times.append(time.perf_counter())
        self.spent.append(
            Spent(*(after - before for before, after in itertools.pairwise(times)))
        )
        return fitness


def judged(folder: Path, agents: int, steps: int) -> float:
    """Return the fitness from agents' logs: final distances and the first step with all out."""
    logs = [
        [
            float(line.split("\t")[1])
            for line in (folder / f"agent_{agent}.log").read_text().splitlines()[1:]
        ]
        for agent in range(agents)
    ]
    out = next(
        (
            step
            for step, distances in enumerate(zip(*logs, strict=True))
            if not any(distances)
        ),
        steps,
    )
    distance = 0.0
    for log in logs:  # one after another, as the simulator adds them
        distance += log[-1]
    return (steps - out) / steps - distance


def _done(command: list[str], folder: Path) -> None:
    done = subprocess.run(
        command, cwd=folder, env=SYSTEM, capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise RuntimeError(f"{command[0]} failed: {(done.stderr or done.stdout)[-2000:]}")


def missing(build: str) -> str:
    """Return the missing program, or ""."""
    return (
        ""
        if shutil.which(BUILDS[build], path=SYSTEM["PATH"])
        else f"{BUILDS[build]} is not installed"
    )


@contextlib.contextmanager
def workspace(build: str) -> Iterator[Files]:
    """Make a workspace, deleted at the end."""
    with tempfile.TemporaryDirectory() as name:
        yield Files(Path(name), build)
