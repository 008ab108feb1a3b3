"""Environments that nobody here wrote, of PettingZoo, MPE2 and Gymnasium.

Each keeps the contract, and evolution is better in it than random controllers, on seeds that it never saw.
"""

from typing import Any

import numpy as np
import pytest
from random_controllers import compared

from zswarm import plugins
from zswarm.errors import ConfigError
from zswarm.evaluate import build
from zswarm.sims.pettingzoo import environments
from zswarm.testing import check_simulator

pytestmark = [
    pytest.mark.filterwarnings("ignore:The old environment creation API:DeprecationWarning"),
    pytest.mark.filterwarnings("ignore:builtin type [Ss]wig:DeprecationWarning"),  # as an error it crashes Box2D's import
]
TWO_NETS = {"kind": "bulk", "parts": 2, "of": {"kind": "feed-forward", "hidden": [8], "activation": "tanh"}}
EVOLVED = [  # simulator, environment, generations, whatever else
    ("pettingzoo", "simple_v3", 8, {}),
    ("pettingzoo", "simple_line_v1", 4, {}),
    ("pettingzoo", "simple_formation_v1", 4, {}),
    ("pettingzoo", "simple_spread_v3", 6, {}),
    ("pettingzoo", "simple_speaker_listener_v4", 18, {"representation": TWO_NETS, "seeds": [1, 2, 3]}),
    ("gymnasium", "CartPole-v1", 8, {}),
    ("gymnasium", "Acrobot-v1", 3, {}),
    ("gymnasium", "Pendulum-v1", 8, {}),
]
KEPT = {
    "pettingzoo": ["knights_archers_zombies_v11", "multiwalker_v9", "rps_v2", "simple_tag_v3"],
    "gymnasium": ["BipedalWalker-v3", "Blackjack-v1", "FrozenLake-v1", "MountainCarContinuous-v0", "Taxi-v4"],
}


@pytest.mark.parametrize(("simulator", "environment"), [(simulator, name) for simulator in KEPT for name in KEPT[simulator]])
def test_an_environment_keeps_the_contract(simulator: str, environment: str) -> None:
    check_simulator(plugins.load("simulator", simulator), {"environment": environment, "steps": 10})


@pytest.mark.long
def test_every_small_environment_keeps_the_contract() -> None:
    for name, family in environments().items():
        if family == "mpe2":
            check_simulator(plugins.load("simulator", "pettingzoo"), {"environment": name, "steps": 10})


@pytest.mark.long
@pytest.mark.parametrize(("simulator", "environment", "generations", "parts"), EVOLVED)
def test_evolved_controllers_are_better_than_random_ones_on_seeds_they_never_saw(
    simulator: str, environment: str, generations: int, parts: dict[str, Any]
) -> None:
    """Champions of two runs or three."""
    assert compared(simulator, {"environment": environment}, **{"seeds": [1, 2], "generations": generations, **parts}).p < 0.01


@pytest.mark.parametrize(
    ("simulator", "settings", "reason"),
    [
        (
            "pettingzoo",
            {"environment": "simple_spred_v3"},
            r"pettingzoo: unknown environment 'simple_spred_v3' \(did you mean 'simple_s",
        ),
        ("pettingzoo", {"environment": "os.path"}, "pettingzoo: unknown environment 'os.path'; known are: "),
        ("pettingzoo", {"options": {"landmarks": 3}}, "simulator 'pettingzoo' cannot be set up: TypeError: .*landmarks"),
        ("gymnasium", {"environment": "antigravity:CartPole-v1"}, "gymnasium: unknown environment 'antigravity:CartPole-v1'"),
        ("gymnasium", {"environment": "CartPole"}, r"gymnasium: unknown environment 'CartPole' \(did you mean 'CartPole-v"),
        ("gymnasium", {"environment": "Ant-v5"}, "gymnasium: Ant-v5 needs more: "),
    ],
)
def test_what_is_not_there_is_refused_in_a_line(simulator: str, settings: dict[str, Any], reason: str) -> None:
    with pytest.raises(ConfigError, match=f"^{reason}") as refusal:
        build(simulator, settings, "fully-meshed", {})
    assert "\n" not in str(refusal.value)


def test_types_are_participants_or_are_told_who_they_are() -> None:
    together = build("pettingzoo", {"environment": "simple_tag_v3"}, "fully-meshed", {})[0]
    against = build("pettingzoo", {"environment": "simple_tag_v3", "genomes": "types", "steps": 1}, "fully-meshed", {})[0]
    assert (together.participants, list(together.owners)) == (1, [0] * 4)
    assert (against.participants, list(against.owners)) == (2, [0, 0, 0, 1])
    assert together.metrics == against.metrics == ("steps", "return_adversary", "return_agent")
    assert together.reset(1).observations[:, 0].tolist() == [0, 0, 0, 1]
    against.reset(1)
    assert against.step(np.zeros((4, against.outputs), np.float32)) is None
    assert len(against.outcome().fitness) == 2
