"""Test environments of other packages: PettingZoo, MPE2 and Gymnasium.

Each keeps the contract, and evolution beats random controllers in it, on held-out seeds.
"""

import os
import subprocess
import sys
from typing import Any

import numpy as np
import pytest

from tests.sims.random_controllers import compared
from zswarm.errors import ConfigError
from zswarm.evaluate import build
from zswarm.plugins import registry as plugins
from zswarm.sims.adapters.pettingzoo import environments
from zswarm.testing import check_simulator

pytestmark = [
    pytest.mark.filterwarnings(
        "ignore:The old environment creation API:DeprecationWarning"
    ),
    # As an error it crashes Box2D's import.
    pytest.mark.filterwarnings("ignore:builtin type [Ss]wig:DeprecationWarning"),
]
TWO_NETS = {"kind": "bulk", "parts": 2, "of": {"kind": "feed-forward", "hidden": []}}
# Environment, options, whatever else.
EVOLVED: list[tuple[str, dict[str, Any], dict[str, Any]]] = [
    (
        "simple_v3",
        {"max_cycles": 10},
        {"generations": 10, "trials": 5, "search": True, "others": 10},
    ),
    (
        "simple_spread_v3",
        {"local_ratio": 0.0, "max_cycles": 15},
        {"generations": 12, "trials": 3, "runs": 4, "others": 12},
    ),
    ("simple_formation_v1", {}, {"generations": 5, "runs": 3, "others": 12}),
    (
        "simple_speaker_listener_v4",
        {},
        {
            "generations": 8,
            "trials": 4,
            "runs": 4,
            "unseen": 10,
            "others": 12,
            "representation": TWO_NETS,
        },
    ),
    (
        "multiwalker_v9",
        {"max_cycles": 30},
        {"generations": 5, "runs": 3, "trials": 2, "unseen": 5, "others": 12},
    ),
]
KEPT = {
    "pettingzoo": [
        "rps_v2",
        "simple_tag_v3",
    ],
    "gymnasium": [
        "BipedalWalker-v3",
        "Blackjack-v1",
        "FrozenLake-v1",
        "MountainCarContinuous-v0",
        "Taxi-v4",
    ],
}


@pytest.mark.parametrize(
    ("simulator", "environment"),
    [
        *((simulator, name) for simulator in KEPT for name in KEPT[simulator]),
        *(
            pytest.param("pettingzoo", name, marks=pytest.mark.long)
            for name in ("knights_archers_zombies_v11", "multiwalker_v9")
        ),
    ],
)
def test_an_environment_keeps_the_contract(simulator: str, environment: str) -> None:
    check_simulator(
        plugins.load("simulator", simulator), {"environment": environment, "steps": 10}
    )


@pytest.mark.long
def test_every_small_environment_keeps_the_contract() -> None:
    for name, family in environments().items():
        if family == "mpe2":
            check_simulator(
                plugins.load("simulator", "pettingzoo"),
                {"environment": name, "steps": 10},
            )


@pytest.mark.long
@pytest.mark.parametrize(
    ("environment", "options", "effort"),
    [pytest.param(*each, id=each[0]) for each in EVOLVED],
)
def test_evolution_is_better_than_random_on_seeds_it_never_saw(
    environment: str, options: dict[str, Any], effort: dict[str, Any]
) -> None:
    """Beat random actions and networks; with ``search`` also the best of many networks."""
    found = compared(
        "pettingzoo", {"environment": environment, "options": options}, **effort
    )
    assert found.p < 0.01, found


@pytest.mark.long
@pytest.mark.parametrize(
    ("environment", "effort"),
    [
        ("CartPole-v1", {"generations": 5, "runs": 3, "others": 12}),
        (
            "Acrobot-v1",
            {"generations": 3, "runs": 3, "trials": 1, "unseen": 5, "others": 9},
        ),
        ("Pendulum-v1", {"generations": 6, "runs": 4}),
    ],
)
def test_evolution_of_one_agent_is_better_than_random_ones(
    environment: str, effort: dict[str, int]
) -> None:
    """It is compared with random actions and random networks."""
    found = compared("gymnasium", {"environment": environment}, **effort)
    assert found.p < 0.01, found


@pytest.mark.parametrize(
    ("simulator", "settings", "reason"),
    [
        (
            "pettingzoo",
            {"environment": "simple_spred_v3"},
            r"pettingzoo: unknown environment 'simple_spred_v3' \(did you mean 'simple_s",
        ),
        (
            "pettingzoo",
            {"environment": "os.path"},
            "pettingzoo: unknown environment 'os.path'; known are: ",
        ),
        (
            "pettingzoo",
            {"options": {"landmarks": 3}},
            "simulator 'pettingzoo' cannot be set up: TypeError: .*landmarks",
        ),
        (
            "gymnasium",
            {"environment": "antigravity:CartPole-v1"},
            "gymnasium: unknown environment 'antigravity:CartPole-v1'",
        ),
        (
            "gymnasium",
            {"environment": "CartPole"},
            r"gymnasium: unknown environment 'CartPole' \(did you mean 'CartPole-v",
        ),
        ("gymnasium", {"environment": "Ant-v5"}, "gymnasium: Ant-v5 needs more: "),
    ],
)
def test_unknown_environments_and_settings_are_refused_in_one_line(
    simulator: str, settings: dict[str, Any], reason: str
) -> None:
    with pytest.raises(ConfigError, match=f"^{reason}") as refusal:
        build(simulator, settings, "fully-meshed", {})
    assert "\n" not in str(refusal.value)


def test_types_are_participants_or_the_first_input() -> None:
    together = build("pettingzoo", {"environment": "simple_tag_v3"}, "fully-meshed", {})[
        0
    ]
    against = build(
        "pettingzoo",
        {"environment": "simple_tag_v3", "genomes": "types", "steps": 1},
        "fully-meshed",
        {},
    )[0]
    assert (together.participants, list(together.owners)) == (1, [0] * 4)
    assert (against.participants, list(against.owners)) == (2, [0, 0, 0, 1])
    assert (
        together.metrics
        == against.metrics
        == ("steps", "return_adversary", "return_agent")
    )
    assert together.reset(1).observations[:, 0].tolist() == [0, 0, 0, 1]
    against.reset(1)
    assert against.step(np.zeros((4, against.outputs), np.float32)) is None
    assert len(against.outcome().fitness) == 2


SILENT = """
import os, sys, threading
import numpy as np
from zswarm.plugins import registry as plugins

def play(name, environment):
    simulator_class = plugins.load("simulator", name)
    simulator = simulator_class(simulator_class.settings_type(environment=environment, steps=5))
    turn = simulator.reset(1)
    while turn is not None:
        turn = simulator.step(np.full((len(turn.agents), simulator.outputs), 0.5, np.float32))
    return simulator.outcome()

def open_files():
    links = [f"/proc/self/fd/{number}" for number in os.listdir("/proc/self/fd")[:-1]]
    return sorted(map(os.readlink, links))

ZOO = ("knights_archers_zombies_v11", "pistonball_v6", "multiwalker_v9", "pursuit_v5")
ENVIRONMENTS = [("pettingzoo", name) for name in ZOO]
ENVIRONMENTS += [("gymnasium", name) for name in ("CartPole-v1", "LunarLander-v3", "FrozenLake-v1")]
first = [play(*each) for each in ENVIRONMENTS]
files, tasks = open_files(), len(os.listdir("/proc/self/task"))
assert [play(*each) for each in ENVIRONMENTS] == first
assert open_files() == files, (files, open_files())
assert len(os.listdir("/proc/self/task")) == tasks
assert threading.active_count() == 1
"""


def test_environments_print_nothing_and_leave_nothing_behind() -> None:
    """They print nothing and leave no window, threads or files."""
    without = {
        name: value
        for name, value in os.environ.items()
        if name not in ("DISPLAY", "SDL_VIDEODRIVER")
    }
    ended = subprocess.run(
        [sys.executable, "-c", SILENT],
        capture_output=True,
        text=True,
        check=False,
        env=without,
    )
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "", "")
