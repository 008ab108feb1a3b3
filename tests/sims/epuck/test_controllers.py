"""Controllers score as in ARGoS, whose means over its own seeds were recorded."""

import importlib.util
import random
import sys
from functools import cache
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from tests.repository import REPOSITORY
from zswarm.evaluate import build, evaluate
from zswarm.robots.argos import genome

SEEDS, MANY_SEEDS = 3, 4
# Mean fitness in ARGoS and its deviation, of three runs of controllers with random weights.
RECORDED = {
    ("aggregation", 0): (1098.67, 160.85),
    ("aggregation", 4): (704.0, 136.4),
    ("foraging", 0): (18.33, 2.31),
    ("foraging", 12): (18.67, 1.53),
    ("grid-exploration", 0): (-170360.0, 5223.0),
    ("grid-exploration", 12): (-193527.0, 3847.0),
    ("grid-exploration", 16): (-299050.0, 4026.0),
}
T_95 = 2.776  # Student's t of four degrees of freedom: two times three runs
# docs/epuck.md says how much the runs of AutoMoDe's missions depend on two starts.
SLOWEST = "foraging"
MISSIONS = ("aggregation", SLOWEST, "gridexploration")
MISSIONS += tuple(
    f"chocolate_{mission}" for mission in ("aac", "sca", "spc", "lcn", "cfa")
)


@cache
def comparison() -> ModuleType:
    """Return ``benchmarks/argos.py``; skip the test where ARGoS' numbers are not."""
    path = REPOSITORY / "benchmarks" / "argos.py"
    spec = importlib.util.spec_from_file_location("argos_benchmark", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # where its results are pickled from
    spec.loader.exec_module(module)
    if not module.GOLDEN.is_dir():
        pytest.skip(f"ARGoS' numbers are not in {module.GOLDEN}: SHARED names the folder")
    return module


def random_controllers(count: int) -> list[list[tuple[int, int, float]]]:
    """Return the links of the controllers with random weights, as they were made for ARGoS."""
    stream = random.Random(20261123)
    pairs = [(source, wheel) for wheel in (16, 17) for source in range(1, 16)]
    return [
        [(*pair, round(stream.uniform(-5.0, 5.0), 6)) for pair in pairs]
        for _ in range(count)
    ]


def built(links: list[tuple[int, int, float]]) -> genome.Built:
    """Return a network of these links."""
    genes = [genome.Gene(*link, enabled=True) for link in links]
    return genome.build(genome.ArgosNetwork([*range(1, 15)], 15, [16, 17], [], genes))


def played(mission: str, network: genome.Built, seeds: int) -> np.ndarray:
    """Return the fitness of trials with some seeds."""
    kind: dict[str, Any] = dict(network.representation)
    simulator, made = build("epuck", {"mission": mission}, kind.pop("kind"), kind)
    numbers = np.arange(1, seeds + 1, dtype=np.uint64)
    rows = np.zeros((seeds, 1), np.int64)
    found: np.ndarray = evaluate(simulator, made, [network.genome], rows, numbers).fitness
    return found[:, 0]


@pytest.mark.parametrize(("mission", "number"), RECORDED)
def test_random_controllers_score_as_in_argos(mission: str, number: int) -> None:
    """Means of three runs here and three there; the bits here are the same everywhere."""
    network = built(random_controllers(number + 1)[number])
    fitness = played(mission, network, SEEDS)
    mean, deviation = RECORDED[mission, number]
    width = np.sqrt((deviation**2 + fitness.std(ddof=1) ** 2) / SEEDS)
    assert abs(fitness.mean() - mean) <= max(T_95 * width, 0.1 * abs(mean)), fitness


@pytest.mark.parametrize(
    "mission",
    [
        pytest.param(
            mission,
            marks=pytest.mark.thorough if mission == SLOWEST else pytest.mark.long,
        )
        for mission in MISSIONS
    ],
)
def test_all_controllers_score_as_in_argos(mission: str) -> None:
    """Networks and machines that others published, with the noise of design and of reality."""
    argos = comparison()
    rows = [row for row in argos.rows() if row.mission == mission]
    results = [argos.play(row, MANY_SEEDS) for row in rows]
    assert len(results) >= 4
    often = [one for one in results if one.row.runs > 3]
    assert [one for one in often if abs(one.z) > 4.5] == []  # less likely than .001
    unlikely = [one for one in results if not one.holds and abs(one.z) > 2.0]
    assert len(unlikely) <= 0.1 * len(results) + 1, unlikely
    for (_, model), group in argos.grouped(results).items():
        if model == "design" and not mission.startswith("chocolate"):
            assert argos.kendall(group) >= 0.75
