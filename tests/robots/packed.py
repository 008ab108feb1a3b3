"""Write packages of evolved controllers to a folder and load them from there."""

import importlib
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import msgspec
import numpy as np

from zswarm import evaluate
from zswarm.champion.controller import Controller
from zswarm.kernels.random import Stream
from zswarm.robots.package import Files
from zswarm.sims.simulator import RobotInterface
from zswarm.sims.turtlebot_exit import TurtlebotExit


def evolved(kind: str = "fully-meshed", seed: int = 4, **settings: Any) -> Controller:
    """Return a controller of TurtleBots that leave a room, with a random genome."""
    simulator, network = evaluate.build("turtlebot-exit", settings, kind, {})
    return Controller(
        simulator="turtlebot-exit",
        simulator_settings=msgspec.to_builtins(simulator.settings),
        representation=kind,
        representation_settings=msgspec.to_builtins(network.settings),
        inputs=simulator.inputs,
        outputs=simulator.outputs,
        sensors=list(simulator.sensors),
        actuators=list(simulator.actuators),
        genome=network.random(1, Stream(seed))[0],
        fitness=-1.25,
        run="runs/of a test",
    )


def simulator(controller: Controller) -> TurtlebotExit:
    """Return the simulator that the controller was evolved in."""
    built, _ = evaluate.build(
        controller.simulator,
        controller.simulator_settings,
        controller.representation,
        controller.representation_settings,
    )
    assert isinstance(built, TurtlebotExit)
    return built


def write(files: Files, folder: Path) -> Path:
    """Write a package into a folder and return the folder."""
    for path, content in files.items():
        file = folder / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(content if isinstance(content, bytes) else content.encode())
    return folder


def load(folder: Path, name: str, *modules: str) -> list[ModuleType]:
    """Import modules of a Python package in a folder again."""
    for module in [one for one in sys.modules if one.split(".")[0] == name]:
        del sys.modules[module]
    sys.path.insert(0, str(folder))
    try:
        importlib.invalidate_caches()
        return [importlib.import_module(f"{name}.{module}") for module in modules]
    finally:
        sys.path.remove(str(folder))


def scanner(robot: RobotInterface) -> tuple[float, float]:
    """Return ``angle_min`` and ``angle_increment`` as a laser scan carries them: float32."""
    return float(np.float32(-robot.view / 2)), float(
        np.float32(robot.view / (robot.rays - 1))
    )


def played(
    world: TurtlebotExit, seed: int, decide: Callable[[int, int], tuple[float, float]]
) -> tuple[list[bytes], list[float]]:
    """Return the poses of all robots in each step of a trial, and its fitness and metrics.

    Args:
        decide: (step, robot) -> m/s ahead, rad/s counter-clockwise.
    """
    turn, poses, step = world.reset(seed), [world.poses.tobytes()], 0
    linear, angular = np.zeros(world.settings.robots), np.zeros(world.settings.robots)
    while turn is not None:
        for robot in turn.agents:
            linear[robot], angular[robot] = decide(step, robot)
        turn = world.drive(linear, angular)
        step += 1
        poses.append(world.poses.tobytes())
    outcome = world.outcome()
    return poses, [*outcome.fitness, *outcome.metrics]


def in_process(controller: Controller, seed: int) -> tuple[list[bytes], list[float]]:
    """Return the same for the controller as it was evolved."""
    world = simulator(controller)
    drivers = [controller.driver() for _ in range(world.settings.robots)]
    turn, poses = world.reset(seed), [world.poses.tobytes()]
    while turn is not None:
        actions = [
            drivers[robot].act(seen)
            for robot, seen in zip(turn.agents, turn.observations, strict=True)
        ]
        turn = world.step(np.array(actions))
        poses.append(world.poses.tobytes())
    outcome = world.outcome()
    return poses, [*outcome.fitness, *outcome.metrics]
