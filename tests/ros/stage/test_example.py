"""The package of examples/ros/stage/files: by roslaunch, each candidate compiled into its nodes."""

import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

from tests.ros.stage import stage_here
from zswarm import evaluate
from zswarm.kernels.random import Stream
from zswarm.sims.turtlebot_exit import TurtlebotExitSettings

FILES = stage_here.EXAMPLE / "files"
NETWORK = {"hidden": 2, "iterations": 1, "activation": "tanh", "weight_range": 1.0}


def test_its_world_is_that_of_make_world() -> None:
    settings = TurtlebotExitSettings(robots=4, map="open", epsilon=0.6)
    text = stage_here.make_world.world(settings, 1, "lockstep 0.2", 0.2)
    assert (FILES / "stage_exit" / "world" / "room.world").read_text() == text


@pytest.mark.stage
def test_two_candidates_are_compiled_and_played(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They are other controllers, so they have other fitness; each robot has a log."""
    stage_here.need()
    for line in sourced(stage_here.BUILT / "setup.bash", tmp_path).split("\0"):
        name, _, text = line.partition("=")
        if name in {"CMAKE_PREFIX_PATH", "ROS_PACKAGE_PATH", "PATH", "LD_LIBRARY_PATH"}:
            monkeypatch.setenv(name, text)
    monkeypatch.setenv("STAGEPATH", str(stage_here.BUILT / "lib"))
    monkeypatch.setenv("ZSWARM_SIMULATORS", str(FILES))
    simulator, network = evaluate.build(
        "stage-exit", {"steps": 40}, "fully-meshed", NETWORK
    )
    genomes = [network.random(1, Stream(seed))[0] for seed in (1, 2)]
    outcomes = evaluate.evaluate(
        simulator,
        network,
        genomes,
        np.array([[0], [1]]),
        np.array([1, 2], np.uint64),
    )
    fitness = outcomes.fitness[:, 0]
    assert np.isfinite(fitness).all()
    assert (fitness < 0).all()
    assert fitness[0] != fitness[1]
    assert outcomes.metrics[:, 1].max() <= 41


def sourced(file: Path, folder: Path) -> str:
    """Return the environment after a shell read a file, separated by zeros."""
    command = ["bash", "-c", f'source "{file}" && env -0']
    environment = {**os.environ, "HOME": str(folder)}
    done = subprocess.run(command, capture_output=True, env=environment, check=True)
    return done.stdout.decode()
