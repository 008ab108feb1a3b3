"""The game of two teams in minisim agrees with a second writing of its data sheet, and is fair."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from tests import examples
from tests.parameters import some
from tests.sims.naive_duel import NaiveDuel
from zswarm.errors import ConfigError
from zswarm.evaluate import build, evaluate
from zswarm.kernels.random import Stream
from zswarm.nets.networks import Networks
from zswarm.nets.representation import Representation
from zswarm.ot.replay import held_out as unseen
from zswarm.sims.minisim import Minisim, MinisimSettings
from zswarm.sims.turns import play_turns
from zswarm.testing import check_simulator

UNUSUAL: list[dict[str, int]] = [
    {},
    {"steps": 60, "width": 9, "height": 31, "robots": 5, "robot_sight": 3},
    {"steps": 40, "width": 2, "height": 2, "robots": 3, "reach": 0},
    {"steps": 40, "width": 7, "height": 3, "robots": 1, "reach": 0},
    {"steps": 50, "width": 15, "robots": 17, "reach": 2},
]
SEEDS = np.array([0, 3, 2**64 - 1], np.uint64)


def built(settings: dict[str, int]) -> tuple[Minisim, Representation]:
    simulator, network = build(
        "minisim", {"teams": 2, "defenders": 0, **settings}, "fully-meshed", {"hidden": 2}
    )
    assert isinstance(simulator, Minisim)
    return simulator, network


def steer(direction: np.ndarray) -> np.ndarray:
    return (0.5 + 0.5 * np.sign(direction) * (np.abs(direction) > 0.25)).astype(
        np.float32
    )


def greedy(observations: np.ndarray) -> np.ndarray:
    return steer(np.sign(observations[:, 0:2]))


def guarding(observations: np.ndarray) -> np.ndarray:
    """Keep the first two robots at their own flag, chasing visible opponents; the others attack."""
    actions, guards = greedy(observations), observations[:2]
    seen = guards[:, 3:5].any(axis=1, keepdims=True)
    actions[:2] = steer(np.where(seen, np.sign(guards[:, 3:5]), guards[:, 9:11]))
    return actions


def deciding(
    network: Representation, parameters: np.ndarray, robots: int
) -> Callable[[int, np.ndarray], np.ndarray]:
    """Return a policy in which each team decides by its parameters."""
    states = np.zeros((2 * robots, network.state_size), np.float32)

    def decide(robot: int, observation: np.ndarray) -> np.ndarray:
        action = np.empty(2, np.float32)
        network.step(parameters[robot // robots], states[robot], observation, action)
        return action

    return decide


@pytest.mark.parametrize("settings", some(UNUSUAL, *UNUSUAL[1:-1]))
def test_kernel_turns_and_a_naive_reference_have_the_same_bits(
    settings: dict[str, int],
) -> None:
    simulator, network = built(settings)
    genomes = network.random(8, Stream(7))
    participants = np.array([[0, 1], [2, 3], [4, 5], [6, 7]]).repeat(len(SEEDS), axis=0)
    seeds = np.tile(SEEDS, 4)
    outcomes = evaluate(simulator, network, genomes, participants, seeds)
    parameters = network.parameters(genomes)
    for trial, (pair, seed) in enumerate(zip(participants, seeds, strict=True)):
        told = np.concatenate([outcomes.fitness[trial], outcomes.metrics[trial]])
        fitness, metrics = np.zeros(2), np.zeros(3)
        controllers = Networks(network, parameters[pair])
        play_turns(simulator, controllers, int(seed), fitness, metrics)
        assert told.tobytes() == np.concatenate([fitness, metrics]).tobytes()
        decide = deciding(network, parameters[pair], simulator.settings.robots)
        assert told.tolist() == list(
            NaiveDuel(simulator.settings, int(seed)).play(decide)
        )
    assert outcomes.fitness.any(), "something was compared"


def test_observations_agree_with_the_naive_reference_at_every_step() -> None:
    """Flags are carried and robots tagged in it, on both sides."""
    settings = MinisimSettings(teams=2, defenders=0, robots=5)
    simulator, naive = Minisim(settings), NaiveDuel(settings, 11)

    def act(observations: np.ndarray) -> np.ndarray:
        # A team each.
        return np.concatenate([greedy(observations[:5]), guarding(observations[5:])])

    turn = simulator.reset(11)
    observations = [turn.observations]
    while turn is not None:
        turn = simulator.step(act(turn.observations))
        observations += [turn.observations] if turn else []
    seen: list[np.ndarray] = []

    def decide(robot: int, observation: np.ndarray) -> np.ndarray:
        seen.append(observation)
        if robot < 5:
            return greedy(observation[None])[0]
        return guarding(np.stack([observation] * 3))[0 if robot < 7 else 2]

    told = naive.play(decide)
    assert np.concatenate(observations).tobytes() == np.array(seen).tobytes()
    outcome = simulator.outcome()
    assert (*outcome.fitness, *outcome.metrics) == told
    assert np.array(seen)[:, [7, 8, 12, 13]].any(axis=0).all(), (
        "somebody carried a flag, somebody intruded"
    )
    assert all(outcome.metrics), "captures, steals and tagged robots were compared"


def test_swapping_sides_does_not_change_fitness() -> None:
    """Whoever changes sides has the same fitness, bit for bit; a team that plays itself ties."""
    simulator, network = built({})
    genomes = network.random(30, Stream(1))
    one, other, seeds = (
        np.arange(30),
        np.roll(np.arange(30), 1),
        np.arange(30, dtype=np.uint64),
    )
    fitness, turned, alone = (
        evaluate(simulator, network, genomes, np.stack(pair, axis=1), seeds).fitness
        for pair in ((one, other), (other, one), (one, one))
    )
    assert fitness.tobytes() == turned[:, ::-1].tobytes()
    assert len(set(fitness.ravel().tolist())) > 10
    assert alone[:, 0].tobytes() == alone[:, 1].tobytes()


def played(policies: list[Callable[[np.ndarray], np.ndarray]], trials: int) -> np.ndarray:
    """(trials, 2) fitness of controllers written by hand."""
    simulator = Minisim(MinisimSettings(teams=2, defenders=0))
    found = []
    for seed in range(trials):
        turn: Any = simulator.reset(seed)
        while turn is not None:
            halves = zip(
                policies, (turn.observations[:8], turn.observations[8:]), strict=True
            )
            turn = simulator.step(
                np.concatenate([policy(half) for policy, half in halves])
            )
        found.append(simulator.outcome().fitness)
    return np.array(found)


def test_two_guards_beat_a_team_that_only_attacks() -> None:
    fitness = played([guarding, greedy], 20)
    assert (fitness[:, 0] > fitness[:, 1]).sum() > 15


@pytest.mark.long
@pytest.mark.parametrize("seed", [1, 2])
def test_later_champions_of_the_example_beat_earlier_ones(seed: int) -> None:
    """Champions of generations 0, 10 and 30 play 100 unseen starts, some seconds for each."""
    champions = {}
    for generation in (0, 10, 30):
        changes = [f"seed={seed}", f"generations={generation + 1}"]
        (problem, optimizer), _ = examples.played("minisim-duel", changes)
        champions[generation] = problem.controller(*optimizer.best(), "")
    last = champions[30]
    assert unseen.play(last, 100, 0, champions[0]).score()["won"] > 80
    assert unseen.play(last, 100, 0, champions[10]).score()["won"] > 50


def test_the_contract_holds() -> None:
    check_simulator(Minisim, {"teams": 2, "defenders": 0})


def test_the_frame_shows_two_teams_on_one_field() -> None:
    simulator, stream = (
        Minisim(MinisimSettings(teams=2, defenders=0, width=11, height=7, robots=2)),
        Stream(5),
    )
    simulator.reset(5)
    frame = simulator.frame()
    x, y = 10 - stream.integer(5), stream.integer(7)
    rows = [stream.integer(7) for _ in range(2)]
    assert [(place.kind, place.x, place.y) for place in frame.places] == [
        ("home", 0, 0),
        ("opponents' home", 10, 0),
        ("flag's stand", 10 - x, 6 - y),
        ("opponents' flag's stand", x, y),
    ]
    expected = [("robot", 0, row) for row in rows] + [
        ("opponent", 10, 6 - row) for row in rows
    ]
    assert [(body.kind, body.x - 0.5, body.y - 0.5) for body in frame.bodies] == expected


def test_defenders_with_two_teams_are_refused() -> None:
    with pytest.raises(ConfigError) as refusal:
        build("minisim", {"teams": 2}, "fully-meshed", {})
    assert (
        str(refusal.value)
        == "minisim: two teams guard their flags themselves; give defenders = 0 with teams = 2"
    )
