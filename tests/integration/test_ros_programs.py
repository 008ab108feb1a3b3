"""A ROS simulation evolves as the bundled simulator does, through killed nodes."""

import os
import re
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.integration.programs import (
    Optimizer,
    Server,
    children,
    command_line,
    query,
    wait_until,
)
from tests.ros.ros_here import need
from zswarm import evaluate, experiment
from zswarm.ot.build import build
from zswarm.ot.record.history_hash import History

pytestmark = pytest.mark.robots
ROOM = {"robots": 2, "steps": 40, "map": "open", "epsilon": 0.5}
EXPERIMENT = """
name = "room"
seed = 5
generations = {generations}
[problem]
simulator = "{simulator}"
trials = 2
[problem.settings]
{settings}
[representation]
kind = "fully-meshed"
[optimizer]
kind = "nnga"
population = 10
[cluster]
trial_timeout_s = 60.0
"""
NODE = "zswarm.ros.simulation.node"


def write(to: Path, simulator: str, generations: int, **settings: Any) -> Path:
    file = to / f"{simulator}.toml"
    lines = "\n".join(
        f"{key} = {value!r}".lower() for key, value in {**ROOM, **settings}.items()
    )
    file.write_text(
        EXPERIMENT.format(simulator=simulator, generations=generations, settings=lines)
    )
    return file


def history(to: Path, generations: int) -> tuple[str, int]:
    """Return the bundled simulator's history hash and its number of distinct candidates."""
    file = write(to, "turtlebot-exit", generations)
    problem, optimizer = build(experiment.complete(experiment.load(file), str(file)))
    told, different = History(), set()
    for generation in range(generations):
        genomes = optimizer.ask()
        different.update(map(bytes, genomes))
        work = problem.workload(genomes, generation)
        outcomes = evaluate.evaluate(
            problem.simulator,
            problem.representation,
            genomes,
            work.participants,
            work.seeds,
        )
        fitness = outcomes.fitness[0::2, 0] + outcomes.fitness[1::2, 0]
        told.add(genomes, fitness)
        optimizer.tell(fitness, np.empty((len(genomes), 0)))
    return told.hex(), len(different)


@contextmanager
def evolving(
    to: Path, file: Path
) -> Iterator[tuple[Server, Optimizer, Callable[[], list[int]]]]:
    """A server of two slots, a run on it, and its nodes; check that none remains."""
    server = Server(to, "ss", capacity=2)
    arguments = [
        "run",
        str(file),
        "--json",
        "--no-multicast",
        "--servers",
        "1",
        "--connect",
        server.endpoint,
    ]
    optimizer = Optimizer(to, "ot", arguments)
    started: set[int] = set()

    def nodes() -> list[int]:
        slots = [child for slot in server.workers() for child in children(slot)]
        started.update(slots, *map(children, slots))
        return [child for child in slots if NODE in command_line(child)]

    try:
        yield server, optimizer, nodes
    finally:
        nodes()
        optimizer.close()
        server.kill(signal.SIGTERM)
        server.wait()
        wait_until(
            lambda: (
                not any(
                    re.search("zswarm|rosmaster", command_line(one)) for one in started
                )
            ),
            "all have ended",
            20,
        )


@pytest.mark.parametrize("link", ["zenoh", "rospy", "rclpy"])
def test_a_run_in_ros_is_that_of_the_bundled_simulator_though_a_node_is_killed(
    link: str, tmp_path: Path
) -> None:
    need(link)
    generations = 6
    expected, different = history(tmp_path, generations)
    file = write(tmp_path, "turtlebot-exit-ros", generations, link=link)
    with evolving(tmp_path, file) as (server, optimizer, nodes):
        record = tmp_path / "runs" / "room"
        wait_until(
            lambda: (
                len(query(record, "SELECT 1 FROM outcomes")) > 20
                or optimizer.process.poll() is not None
            ),
            "some are there",
        )
        assert optimizer.process.poll() is None, optimizer.err.read_text()
        os.kill(nodes()[0], signal.SIGKILL)
        done = optimizer.done()
        (died,) = server.events("slot_died")
    assert re.search(
        "simulator 'turtlebot-exit-ros', trial seed [0-9]+: the simulation node was killed by "
        "signal 9",
        died["reason"],
    )
    assert done["history_hash"] == expected
    assert done["requeued"] > 0
    assert done["evaluations"] == different, "each once"


def test_a_hanging_simulation_is_a_fault_and_the_run_continues(tmp_path: Path) -> None:
    """A stopped node, as on an overloaded machine, is replaced by another."""
    need("zenoh")
    expected, _ = history(tmp_path, 4)
    file = write(tmp_path, "turtlebot-exit-ros", 4, deadline_s=2.0)
    with evolving(tmp_path, file) as (server, optimizer, nodes):
        wait_until(
            lambda: query(tmp_path / "runs" / "room", "SELECT 1 FROM outcomes"),
            "some trials are counted",
        )
        os.kill(nodes()[0], signal.SIGSTOP)
        done = optimizer.done()
        deaths = server.events("slot_died")  # more where the machine is overloaded
    assert deaths
    for died in deaths:
        assert re.search(
            r"no scan and pose of robot [01, ]+ at [\d.]+ s within 2 s \(deadline_s\)",
            died["reason"],
        )
    assert done["history_hash"] == expected
