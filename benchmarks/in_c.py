"""Compile the kernels of zswarm written in C, ``kernels/*.c``, and call them through ctypes.

Compiled with ``EXACT`` they have the same bits as zswarm's; ``FAST`` is what they are timed with.
"""

import ctypes
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from zswarm.sims.epuck import reference_models, sensors

EXACT = ("-O2", "-ffp-contract=off", "-Wno-psabi")
FAST = ("-O3", "-march=native", "-fno-math-errno", "-fno-trapping-math")
SOURCES = Path(__file__).parent / "kernels"


def compiler() -> str | None:
    """Return the C compiler of this machine, if there is one."""
    return shutil.which("gcc") or shutil.which("cc")


def library(name: str, options: tuple[str, ...]) -> ctypes.CDLL:
    """Compile and load ``kernels/<name>.c``."""
    with tempfile.TemporaryDirectory() as folder:
        built = Path(folder) / f"{name}.so"
        command = [
            str(compiler()),
            *options,
            "-std=gnu11",
            "-shared",
            "-fPIC",
            SOURCES / f"{name}.c",
            "-o",
            built,
            "-lm",
        ]
        subprocess.run(command, check=True)
        return ctypes.CDLL(str(built))


def arrays(
    network: Any, genomes: list[bytes], participants: np.ndarray, metrics: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return a row of parameters for each trial, and room for its fitness and metrics."""
    rows = np.ascontiguousarray(network.parameters(genomes)[participants[:, 0]])
    return rows, np.empty(len(rows)), np.empty((len(rows), metrics))


class Arena:
    """Play arena aggregation in C, with a tanh network of 8 neurons and one iteration."""

    def __init__(self, options: tuple[str, ...]) -> None:
        self._play = library("arena", options).play

    def evaluate(
        self,
        simulator: Any,
        network: Any,
        genomes: list[bytes],
        participants: np.ndarray,
        seeds: np.ndarray,
    ) -> Any:
        """Return fitness (trials,) and metrics (trials, 3)."""
        rows, fitness, metrics = arrays(network, genomes, participants, 3)
        seeds = seeds.astype(np.uint64)
        world = simulator.world
        names = "side sight radius half_stride half_turn cells_per_metre".split()
        lengths = np.array([getattr(world, name) for name in names])
        numbers = (
            len(seeds),
            simulator.settings.steps,
            simulator.settings.robots,
            world.per_side,
        )
        self._play(
            *map(ctypes.c_int64, numbers),
            lengths.ctypes,
            rows.ctypes,
            ctypes.c_int64(rows.shape[1]),
            seeds.ctypes,
            fitness.ctypes,
            metrics.ctypes,
        )
        return fitness, metrics


class EmergencyExit:
    """Play emergency-exit in C, on zswarm's fields, with a clamp network of two hidden neurons."""

    def __init__(self, options: tuple[str, ...], *, side_by_side: bool) -> None:
        built = library("emergency_exit", options)
        self._play = built.play_eight if side_by_side else built.play

    def evaluate(
        self,
        simulator: Any,
        network: Any,
        genomes: list[bytes],
        participants: np.ndarray,
        seeds: np.ndarray,
    ) -> Any:
        """Return fitness (trials,) and metrics (trials, 2)."""
        rows, fitness, metrics = arrays(network, genomes, participants, 2)
        laid_out = simulator.fields
        field_of_trial = laid_out.rows(seeds)
        fields = laid_out.cached
        numbers = (
            len(seeds),
            simulator.settings.steps,
            laid_out.agents,
            laid_out.stride,
            laid_out.cells,
        )
        self._play(
            *map(ctypes.c_int64, numbers),
            fields.free.ctypes,
            fields.to_exit.ctypes,
            fields.starts.ctypes,
            field_of_trial.ctypes,
            rows.ctypes,
            ctypes.c_int64(rows.shape[1]),
            fitness.ctypes,
            metrics.ctypes,
        )
        return fitness, metrics


class Epuck:
    """Play epuck in C: aggregation, foraging or grid exploration, reference model 1.2.

    The network is a feed-forward one without hidden nodes.
    """

    def __init__(self, options: tuple[str, ...]) -> None:
        self._play = library("epuck", options).play

    def evaluate(
        self,
        simulator: Any,
        network: Any,
        genomes: list[bytes],
        participants: np.ndarray,
        seeds: np.ndarray,
    ) -> Any:
        """Return fitness (trials,) and metrics (trials, 1)."""
        rows, fitness, metrics = arrays(network, genomes, participants, 1)
        seeds = seeds.astype(np.uint64)
        world = simulator.world
        directions = np.zeros((2, 8))
        directions[:, :4] = reference_models.DIRECTIONS_X, reference_models.DIRECTIONS_Y
        tables = np.vstack(
            [
                *(sensors.RAY_X, sensors.RAY_Y, sensors.ANGLES),
                *(sensors.ANGLES_X, sensors.ANGLES_Y, directions),
            ]
        )
        numbers = (
            *(len(seeds), world.steps, world.number, world.mission),
            *(len(world.walls), len(world.floor)),
        )
        self._play(
            *map(ctypes.c_int64, numbers),
            np.array([world.hearing, world.around, world.free]).ctypes,
            world.constants.ctypes,
            world.walls.ctypes,
            world.floor.ctypes,
            world.greys.ctypes,
            tables.ctypes,
            rows.ctypes,
            ctypes.c_int64(rows.shape[1]),
            seeds.ctypes,
            fitness.ctypes,
            metrics.ctypes,
        )
        return fitness, metrics
