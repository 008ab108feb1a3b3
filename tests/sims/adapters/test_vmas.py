"""Scenarios of VMAS keep the contract, and evolution beats random controllers in them.

In an environment of their own (``make vmas``): torch is large.
"""

from typing import Any

import numpy as np
import pytest

from tests.installed_parts import vmas_is_here
from tests.sims.random_controllers import compared
from zswarm import experiment
from zswarm.errors import ConfigError
from zswarm.evaluate import build
from zswarm.plugins import registry as plugins
from zswarm.testing import check_simulator

pytestmark = pytest.mark.vmas


def test_vmas_is_installed() -> None:
    assert vmas_is_here()


@pytest.mark.parametrize(
    "scenario",
    [
        "balance",
        "dispersion",
        "flocking",
        "navigation",
        "simple_tag",
        "simple_world_comm",
        "wheel",
    ],
)
def test_a_scenario_keeps_the_contract(scenario: str) -> None:
    check_simulator(
        plugins.load("simulator", "vmas"), {"scenario": scenario, "steps": 10}
    )


@pytest.mark.parametrize(
    ("scenario", "options", "steps", "effort"),
    [
        ("simple", {}, 30, {"generations": 10, "trials": 2}),
        ("circle_trajectory", {}, 20, {"generations": 8, "trials": 2}),
        (
            "navigation",
            {"n_agents": 2, "collisions": False},
            30,
            {"generations": 9, "trials": 2},
        ),
    ],
)
def test_evolution_is_better_than_random_on_seeds_it_never_saw(
    scenario: str, options: dict[str, Any], steps: int, effort: dict[str, Any]
) -> None:
    """Beat random actions and networks; a step takes milliseconds, so trials are few."""
    settings = {"scenario": scenario, "options": options, "steps": steps}
    found = compared(
        "vmas", settings, runs=3, population=10, unseen=8, others=9, **effort
    )
    assert found.p < 0.01, found


@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        (
            {"scenario": "dispersal"},
            r"vmas: unknown environment 'dispersal' \(did you mean 'dispersion'\?\); "
            "known are: .*balance",
        ),
        ({"scenario": "../dispersion"}, "vmas: unknown environment '../dispersion'"),
        ({"scenario": "dispersion.py"}, "vmas: unknown environment"),
        (
            {"options": {"device": "cuda"}},
            "simulator 'vmas' cannot be set up: TypeError: .*device",
        ),
    ],
)
def test_settings_that_vmas_lacks_are_refused_in_one_line(
    settings: dict[str, Any], reason: str
) -> None:
    with pytest.raises(ConfigError, match=f"^{reason}") as refusal:
        build("vmas", settings, "fully-meshed", {})
    assert "\n" not in str(refusal.value)


def test_types_are_participants_or_the_first_input() -> None:
    together = build("vmas", {"scenario": "simple_tag"}, "fully-meshed", {})[0]
    against = build(
        "vmas", {"scenario": "simple_tag", "genomes": "types"}, "fully-meshed", {}
    )[0]
    assert (together.participants, against.participants) == (1, 2)
    assert (
        together.metrics
        == against.metrics
        == ("steps", "return_adversary", "return_agent")
    )
    assert np.unique(together.reset(1).observations[:, 0]).tolist() == [0, 1]


def test_the_example_is_complete() -> None:
    path = experiment.find("vmas")
    whole = experiment.complete(experiment.load(path), str(path))
    simulator, _ = build(
        "vmas",
        whole.problem.settings,
        whole.representation.kind,
        whole.representation.settings,
    )
    assert (simulator.inputs, simulator.participants) == (13, 1)
    assert list(simulator.owners) == [0] * whole.problem.settings["options"]["n_agents"]
