"""The launch-file example evolves through real roslaunch with the fitness of its room."""

import importlib
import os
import shutil
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from tests.integration.programs import (
    Optimizer,
    Server,
    children,
    command_line,
    query,
    status,
    wait_until,
)
from tests.repository import REPOSITORY
from zswarm.kernels.random import derive_seed
from zswarm.plugins import registry as plugins
from zswarm.ros.launch.roslaunch import Supervisor
from zswarm.sims import exit_fitness

EXAMPLE = REPOSITORY / "examples" / "ros" / "files"
EXPERIMENT = """
name = "exit"
seed = 4
generations = 2
[problem]
simulator = "{simulator}"
trials = 1
[problem.settings]
steps = 20
robots = 3
[representation]
kind = "fully-meshed"
[optimizer]
kind = "nnga"
population = 4
[cluster]
trial_timeout_s = 25.0
"""
PARAMETERS = {
    "half_width": 2.5,
    "exits": 2,
    "exit_0": [-2.0, 1.0],
    "exit_1": [2.0, 1.0],
    "start": [0.0, -1.0],
}
pytestmark = [
    pytest.mark.robots,
    pytest.mark.skipif(
        shutil.which("roslaunch") is None,
        reason="roslaunch is not installed: apt install ros-core",
    ),
]


@pytest.fixture
def room() -> Iterator[ModuleType]:
    """Import the example's module of that name."""
    sys.path.insert(0, str(EXAMPLE / "exit_world" / "scripts"))
    yield importlib.import_module("room")
    sys.path.pop(0)
    sys.modules.pop("room")


def in_process(room: ModuleType, genome: bytes, seed: int) -> float:
    """Return a candidate's fitness by the kernel's decisions in the example's room."""
    network = plugins.load("representation", "fully-meshed")
    built = network(network.settings_type(), 10, 2)
    parameters = built.parameters([genome])[0]
    world = room.Room(
        {
            **PARAMETERS,
            "step_size": 0.25,
            "epsilon": 0.15,
            "numAgents": 3,
            "seed": seed % 2**31,
        }
    )
    states, action = np.zeros((3, built.state_size), np.float32), np.zeros(2, np.float32)
    for _ in range(20):
        for robot in range(3):
            if world.inside[robot]:
                built.step(
                    parameters,
                    states[robot],
                    np.array(world.observe(robot), np.float32),
                    action,
                )
                world.move(
                    robot, 2.0 * float(action[0]) - 1.0, 2.0 * float(action[1]) - 1.0
                )
    return exit_fitness.last_distance([world.nearest(robot)[0] for robot in range(3)])


def launched(process: int) -> list[int]:
    """Return the running roslaunch descendants of a process."""
    below = [process]
    for parent in below:
        below += children(parent)
    return [
        one
        for one in below
        if "roslaunch" in command_line(one) and "supervisor" not in command_line(one)
    ]


def belonging(folder: Path) -> list[int]:
    """Return processes with a folder in their command lines."""
    numbers = [int(path.name) for path in Path("/proc").iterdir() if path.name.isdigit()]
    return [
        number
        for number in numbers
        if str(folder) in command_line(number)
        and (found := status(number))
        and found.state != "Z"
    ]


def test_a_run_loses_nothing_when_roslaunch_is_killed_or_stopped(
    tmp_path: Path, room: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each candidate has the fitness of its network and room here; nothing is left running."""
    (tmp_path / "t").mkdir()
    told = {"ZSWARM_SIMULATORS": str(EXAMPLE), "TMPDIR": str(tmp_path / "t")}
    (tmp_path / "exit.toml").write_text(EXPERIMENT.format(simulator="exit-yaml"))
    server = Server(tmp_path, "ros", capacity=2, **told).ready()
    try:
        options = (
            f"--json --out runs --servers 1 --connect {server.endpoint} --no-multicast"
        )
        command = ["run", "exit.toml", *options.split()]
        optimizer = Optimizer(tmp_path, "ot", command, **told)
        run = tmp_path / "runs" / "exit"
        wait_until(
            lambda: query(run, "SELECT 1 FROM candidates"),
            "a generation is recorded",
            400,
        )
        for number in (signal.SIGKILL, signal.SIGSTOP):
            (victim, *_) = wait_until(
                lambda: launched(server.process.pid), "a trial is played"
            )
            os.kill(victim, number)
            wait_until(
                lambda victim=victim: status(victim) is None,
                "what was killed or stands still is gone",
            )
        done = optimizer.done()
    finally:
        server.kill(signal.SIGTERM)
        server.wait()
    assert done["requeued"] >= 1
    rows = query(run, "SELECT genome, fitness FROM candidates")
    assert [fitness for _, fitness in rows] == [
        in_process(room, genome, derive_seed(4, "trial", 0)) for genome, _ in rows
    ]
    assert len(rows) == done["evaluations"]
    assert belonging(tmp_path / "t") == []
    monkeypatch.setenv("TMPDIR", str(tmp_path / "t"))
    # The server may kill the supervisor of a killed slot: the next one sweeps its folder
    Supervisor().close()
    assert list((tmp_path / "t").glob("zswarm-*")) == []
