"""Environments of other packages: spaces, agents that come and go, types, options.

These environments are made for the tests; others are played in test_pettingzoo.py.
"""

import itertools
from typing import Any

import numpy as np
import pytest
from gymnasium import spaces

from zswarm.config.decode import convert
from zswarm.errors import ConfigError
from zswarm.evaluate import build, evaluate
from zswarm.kernels.random import Stream
from zswarm.sims.adapters.environments import (
    ParallelEnvironment,
    ParallelSettings,
    check_options,
    folded,
    kind,
)
from zswarm.sims.adapters.spaces import act, sense
from zswarm.testing import check_simulator

ONES = np.ones(2, np.float32)


class Visitors:
    """Two hosts, and guests that leave and return in turn; rewards are the actions."""

    def __init__(self, guests: int = 2, steps: int = 6) -> None:
        self.possible_agents = [
            "host_0",
            "host_1",
            *(f"guest_{number}" for number in range(guests)),
        ]
        self.steps = steps
        self.agents: list[str] = []

    def observation_space(self, name: str) -> spaces.Space:
        return spaces.Box(-1, 1, (2,)) if name.startswith("host") else spaces.Discrete(5)

    def action_space(self, name: str) -> spaces.Space:
        return (
            spaces.Box(-2 * ONES, 4 * ONES)
            if name.startswith("host")
            else spaces.Discrete(3, start=1)
        )

    def reset(self, seed: int) -> tuple[dict[str, Any], dict[str, Any]]:
        self.at, self.seed, self.said = 0, seed, []
        self.agents = list(reversed(self.possible_agents))
        return self.seen(), {}

    def step(self, actions: dict[str, Any]) -> tuple[dict[str, Any], ...]:
        self.said.append(actions)
        paid = {
            name: float(np.sum(action))  # portable: of two numbers at most
            for name, action in actions.items()
        }
        self.at += 1
        gone = f"guest_{self.at % 3}"
        self.agents = (
            [name for name in reversed(self.possible_agents) if name != gone]
            if self.at < self.steps
            else []
        )
        return self.seen(), paid, {}, {}, {}

    def close(self) -> None:
        self.closed = True

    def seen(self) -> dict[str, Any]:
        share = np.float32(self.seed / 2**32)
        return {
            name: np.array([share, 1.0]) if name.startswith("host") else self.at % 5
            for name in self.agents
        }


class Visit(ParallelEnvironment):
    """Adapt the environment of hosts and guests."""

    def make(self, **options: Any) -> Visitors:
        return Visitors(**options)


def visit(**settings: Any) -> Visit:
    return Visit(convert(settings, ParallelSettings, "settings"))


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"genomes": "types"},
        {"fitness": "mean"},
        {"options": {"guests": 0}},
        {"steps": 1},
    ],
)
def test_an_environment_keeps_the_contract(settings: dict[str, Any]) -> None:
    check_simulator(Visit, settings)


def test_agents_observe_their_type_then_what_they_see_then_zeros() -> None:
    simulator = visit()
    turn = simulator.reset(0)
    assert (simulator.inputs, simulator.outputs, list(turn.agents)) == (
        6,
        3,
        [0, 1, 2, 3],
    )
    assert (
        turn.observations.tolist() == [[0, 0, 1, 0, 0, 0]] * 2 + [[1, 1, 0, 0, 0, 0]] * 2
    )


def test_agents_of_a_single_type_have_no_type_input() -> None:
    simulator = visit(options={"guests": 0})
    assert (simulator.inputs, simulator.reset(0).observations.tolist()) == (
        2,
        [[0, 1]] * 2,
    )


def test_outputs_become_actions_of_the_present_agents() -> None:
    """Actions follow the order of the agents; those that left are not asked until they return."""
    simulator = visit()
    simulator.reset(0)
    outputs = np.array([[0, 0.5, 9], [-1, 7, 9], [0.1, 0.9, 0.9], [3, 0, 0]], np.float32)
    there = [simulator.step(outputs)]
    environment = simulator._environment
    assert {
        name: np.asarray(action).tolist() for name, action in environment.said[0].items()
    } == {
        "host_0": [-2, 1],
        "host_1": [-2, 4],
        "guest_0": 2,
        "guest_1": 1,
    }
    while there[-1] is not None:
        there.append(simulator.step(outputs[: len(there[-1].agents)]))
    assert [list(turn.agents) for turn in there if turn] == [
        [0, 1, 2],
        [0, 1, 2, 3],
        [0, 1, 3],
        [0, 1, 2],
        [0, 1, 2, 3],
    ]
    assert [sorted(actions) for actions in environment.said[1:3]] == [
        ["guest_0", "host_0", "host_1"],
        ["guest_0", "guest_1", "host_0", "host_1"],
    ]


@pytest.mark.parametrize(
    ("settings", "fitness"),
    [
        ({}, [6]),
        ({"fitness": "mean"}, [1.5]),
        ({"genomes": "types"}, [1, 5]),
        ({"genomes": "types", "fitness": "mean"}, [0.5, 2.5]),
    ],
)
def test_fitness_is_what_the_agents_of_a_participant_were_paid(
    settings: dict[str, Any], fitness: list[float]
) -> None:
    simulator = visit(steps=1, **settings)
    simulator.reset(0)
    outputs = np.array([[0, 0.5, 0], [0, 1, 0], [0, 1, 0], [0, 0, 1]], np.float32)
    assert simulator.step(outputs) is None
    outcome = simulator.outcome()
    assert outcome.fitness == pytest.approx(fitness)
    assert simulator.metrics == ("steps", "return_host", "return_guest")
    assert outcome.metrics == pytest.approx([1, 0.5, 2.5])


def test_a_trial_ends_with_the_last_agent_or_after_the_steps_of_the_settings() -> None:
    for steps, settings in ((6, {}), (4, {"steps": 4}), (3, {"options": {"steps": 3}})):
        simulator = visit(**settings)
        turn = simulator.reset(1)
        for number in itertools.count(1):
            turn = simulator.step(np.zeros((len(turn.agents), 3), np.float32))
            if turn is None:
                assert number == steps
                break


def test_a_seed_is_folded_and_seeds_the_generators_that_environments_share() -> None:
    assert folded(7) == folded(7 << 32) == 7
    assert folded(2**64 - 1) == 0
    simulator = visit()
    drawn = []
    for seed in (3, 3, 4):
        simulator.reset(seed)
        drawn.append(np.random.random())
    assert drawn[0] == drawn[1] != drawn[2]


def test_an_environment_is_closed_with_its_simulator() -> None:
    """A slot that prepares another experiment relies on this."""
    simulator = visit()
    environment = simulator._environment
    del simulator
    assert environment.closed


@pytest.mark.parametrize(
    ("name", "type_"),
    [
        ("adversary_0", "adversary"),
        ("agent 12", "agent"),
        ("blue-3", "blue"),
        ("7", "7"),
        ("a b_1", "a_b"),
        (3, "3"),
    ],
)
def test_a_type_is_a_name_without_its_number(name: Any, type_: str) -> None:
    assert kind(name) == type_


# ---- spaces

SPACES = [
    spaces.Box(-1, 2, (2, 3)),
    spaces.Box(0, 255, (4,), np.uint8),
    spaces.Discrete(4, start=-1),
    spaces.MultiDiscrete([2, 5, 3]),
    spaces.MultiDiscrete(np.array([[2, 3], [4, 5]]), start=np.array([[1, 1], [0, 7]])),
    spaces.MultiBinary((2, 2)),
    spaces.Tuple([spaces.Discrete(3), spaces.Box(-1, 1, (2,))]),
    spaces.Dict(
        {
            "speed": spaces.Box(0, 1, (1,)),
            "word": spaces.Discrete(3),
            "more": spaces.Dict({"bit": spaces.MultiBinary(2)}),
        }
    ),
]


@pytest.mark.parametrize("space", SPACES, ids=str)
def test_any_outputs_are_an_action_of_the_space(space: spaces.Space) -> None:
    """Each action of the space can be reached."""
    acts = act(space, "actions")
    stream = Stream(1)
    for low, high in ((0, 1), (-9, 9)):
        for _ in range(50):
            action = acts.action(
                stream.uniform(low, high, acts.size + 2).astype(np.float32)
            )
            assert space.contains(action), action


@pytest.mark.parametrize("space", SPACES, ids=str)
def test_observations_are_flattened_as_gymnasium_does(space: spaces.Space) -> None:
    senses = sense(space, "observations")
    space.seed(1)
    for _ in range(5):
        observation = space.sample()
        assert (
            senses.numbers(observation).tolist()
            == spaces.flatten(space, observation).tolist()
        )
        assert senses.numbers(observation).shape == (senses.size,)


def test_outputs_go_from_bound_to_bound_and_beyond_where_there_is_none() -> None:
    box = spaces.Box(
        np.array([-2, -np.inf, 0], np.float32), np.array([6, np.inf, np.inf], np.float32)
    )
    acts = act(box, "actions")
    assert acts.action(np.array([0.25, 0.25, 2], np.float32)).tolist() == [0, -0.5, 3]
    assert acts.action(np.array([-7, 0, 0.5], np.float32)).tolist() == [-2, -1, 0]


def test_spaces_of_variable_size_are_refused() -> None:
    with pytest.raises(
        ConfigError,
        match=r"^observations of a: expected a fixed number of numbers, not Sequence",
    ):
        sense(spaces.Sequence(spaces.Discrete(2)), "observations of a")
    with pytest.raises(
        ConfigError, match=r"^actions of a: expected numbers or choices, not Text"
    ):
        act(spaces.Text(5), "actions of a")


def test_an_observation_of_another_size_is_named() -> None:
    with pytest.raises(ValueError, match="observations of a: expected 3 numbers, not 2"):
        sense(spaces.Box(0, 1, (3,)), "observations of a").numbers(np.zeros(2))


# ---- what an experiment may say


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"file": "/etc/passwd"}, "options: file: expected a text of letters"),
        ({"file": "../x"}, "options: file: expected a text of letters"),
        ({"env": "module:name"}, "options: env: expected a text of letters"),
        (
            {"deep": {"list": [1, "a/b"]}},
            "options: deep: list: expected a text of letters",
        ),
        ({"render_mode": "human"}, "options: render_mode: a trial is played without"),
        (
            {"a": {"b": {"c": {"d": {"e": {}}}}}},
            "options: a: b: c: d: e: expected at most 5 nested",
        ),
    ],
)
def test_options_name_no_file_and_no_module(options: dict[str, Any], reason: str) -> None:
    with pytest.raises(ConfigError, match=f"^{reason}"):
        check_options(options)


def test_plain_options_are_passed_on() -> None:
    check_options({"map_name": "4x4", "a": [1, 2.5, True, "x-y z"], "b": {"c": ""}})
    assert len(visit(options={"guests": 5}).owners) == 7


class Stranger(Visitors):
    def step(self, actions: dict[str, Any]) -> tuple[dict[str, Any], ...]:
        told = super().step(actions)
        self.agents.append("stranger")
        return told


class Strange(Visit):
    """Return an agent that was not announced."""

    def make(self, **options: Any) -> Visitors:
        return Stranger(**options)


def test_an_unannounced_agent_fails_the_trial_and_is_named() -> None:
    _, network = build("xor", {}, "fully-meshed", {})
    network = type(network)(network.settings, 6, 3)
    genomes = network.random(1, Stream(1))
    simulator = Strange(ParallelSettings())
    outcomes = evaluate(
        simulator, network, genomes, np.zeros((1, 1), np.int64), np.array([1], np.uint64)
    )
    assert np.isnan(outcomes.fitness).all()
    assert (
        "agent 'stranger' is not among the environment's possible agents"
        in outcomes.error
    )
