"""Minisim agrees with a second writing of its data sheet, and it is a game worth evolving for."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.parameters import some
from tests.sims.naive_minisim import NaiveMinisim
from zswarm.errors import ConfigError
from zswarm.evaluate import TrialOutcomes, build, evaluate
from zswarm.kernels.random import Stream
from zswarm.nets.fully_meshed import FullyMeshed
from zswarm.nets.networks import Networks
from zswarm.sims.minisim import Minisim, MinisimSettings
from zswarm.sims.turns import play_turns

CHAMPION = json.loads(Path(__file__).with_name("minisim_champion.json").read_text())
UNSEEN = np.arange(10**9, 10**9 + 100, dtype=np.uint64)
UNUSUAL = [
    {},
    {"steps": 60, "width": 9, "height": 31, "robots": 5, "defenders": 1, "rest": 2},
    {"steps": 40, "width": 2, "height": 2, "robots": 3, "defenders": 1, "reach": 0},
    {
        "steps": 40,
        "width": 7,
        "height": 3,
        "robots": 4,
        "defenders": 6,
        "rest": 0,
        "reach": 0,
        "robot_sight": 3,
    },
    {"steps": 50, "width": 12, "height": 5, "defenders": 0, "robot_sight": 1},
    {
        "steps": 50,
        "width": 15,
        "robots": 20,
        "defenders": 3,
        "rest": 2,
        "reach": 2,
        "defender_sight": 4,
    },
]


def built(settings: dict[str, int], hidden: int = 2) -> tuple[Minisim, FullyMeshed]:
    simulator, network = build("minisim", settings, "fully-meshed", {"hidden": hidden})
    assert isinstance(simulator, Minisim)
    assert isinstance(network, FullyMeshed)
    return simulator, network


def champion() -> bytes:
    return np.array(CHAMPION["genome"], "<f4").tobytes()


def play(
    simulator: Minisim, network: FullyMeshed, genomes: list[bytes], seeds: np.ndarray
) -> TrialOutcomes:
    """Play every genome on every seed."""
    participants = np.repeat(np.arange(len(genomes)), len(seeds))[:, None]
    return evaluate(
        simulator, network, genomes, participants, np.tile(seeds, len(genomes))
    )


def play_policy(
    policy: Callable[[np.ndarray], np.ndarray], seeds: np.ndarray
) -> tuple[float, float]:
    """Mean fitness and captures of a hand-written controller, through the turns."""
    simulator = Minisim(MinisimSettings())
    outcomes = []
    for seed in seeds:
        turn = simulator.reset(int(seed))
        while turn is not None:
            turn = simulator.step(policy(turn.observations))
        outcomes.append(simulator.outcome())
    return float(np.mean([o.fitness[0] for o in outcomes])), float(
        np.mean([o.metrics[0] for o in outcomes])
    )


def steer(direction: np.ndarray) -> np.ndarray:
    """Return actions towards a direction, (robots, 2)."""
    return (0.5 + 0.5 * np.sign(direction) * (np.abs(direction) > 0.25)).astype(
        np.float32
    )


def greedy(observations: np.ndarray) -> np.ndarray:
    return steer(np.sign(observations[:, 0:2]))


def careful(observations: np.ndarray) -> np.ndarray:
    return steer(observations[:, 0:2] - 0.9 * observations[:, 3:5])


@pytest.mark.parametrize("settings", some(UNUSUAL, *UNUSUAL[1:-1]))
def test_the_kernel_agrees_with_a_naive_reference_bit_for_bit(
    settings: dict[str, int],
) -> None:
    simulator, network = built(settings)
    genomes = [champion(), *network.random(6, Stream(7))]
    seeds = np.array([0, 3, 2**64 - 1], np.uint64)
    outcomes = play(simulator, network, genomes, seeds)
    trial = 0
    for parameters in network.parameters(genomes):
        for seed in seeds:
            states = np.zeros((simulator.settings.robots, network.state_size), np.float32)

            def decide(
                robot: int, observation: np.ndarray, states=states, parameters=parameters
            ) -> np.ndarray:
                action = np.empty(2, np.float32)
                network.step(parameters, states[robot], observation, action)
                return action

            expected = NaiveMinisim(simulator.settings, int(seed)).play(decide)
            assert (outcomes.fitness[trial, 0], *outcomes.metrics[trial]) == expected
            trial += 1
    seen = outcomes.metrics.sum(axis=0)
    assert seen.all() if not settings else seen.any(), (
        "captures, steals and tagged robots were compared"
    )


def test_observations_agree_with_the_naive_reference_at_every_step() -> None:
    simulator, naive = Minisim(MinisimSettings()), NaiveMinisim(MinisimSettings(), 11)
    turn = simulator.reset(11)
    observations = [turn.observations]
    while turn is not None:
        turn = simulator.step(careful(turn.observations))
        observations += [turn.observations] if turn else []
    seen = []

    def decide(robot: int, observation: np.ndarray) -> np.ndarray:
        seen.append(observation)
        return careful(observation[None])[0]

    naive.play(decide)
    assert np.concatenate(observations).tobytes() == np.array(seen).tobytes()
    assert np.array(seen)[:, 7].any(), "somebody carried the flag"


@pytest.mark.parametrize("settings", UNUSUAL)
def test_turns_give_the_same_bits_as_the_kernel(settings: dict[str, int]) -> None:
    simulator, network = built(settings, hidden=3)
    genomes = network.random(6, Stream(8))
    seeds = np.array([1, 2**63], np.uint64)
    outcomes = play(simulator, network, genomes, seeds)
    trial = 0
    for parameters in network.parameters(genomes):
        for seed in seeds:
            fitness, metrics = np.zeros(1), np.zeros(3)
            controllers = Networks(network, parameters[None])
            play_turns(simulator, controllers, int(seed), fitness, metrics)
            assert fitness.tobytes() == outcomes.fitness[trial].tobytes()
            assert metrics.tobytes() == outcomes.metrics[trial].tobytes()
            trial += 1


def test_a_seed_determines_the_trial_independently_of_earlier_trials() -> None:
    simulator, network = built({})
    alone = play(simulator, network, [champion()], UNSEEN[7:8])
    after_others = play(simulator, network, [champion()], UNSEEN[:8])
    assert after_others.fitness[7] == alone.fitness[0]
    assert len(set(after_others.fitness[:, 0])) > 4, (
        "different seeds are different trials"
    )
    first, again, other = (simulator.reset(seed).observations for seed in (1, 1, 2))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_the_start_is_drawn_by_the_streams_of_zswarm() -> None:
    """All robots are at home, the flag is in the far half, and defenders stand on it."""
    for seed in (0, 77, 2**64 - 1):
        simulator, stream = Minisim(MinisimSettings(width=11, height=7)), Stream(seed)
        simulator.reset(seed)
        frame = simulator.frame()
        home, stand = frame.places
        assert (home.kind, *home[1:]) == ("home", 0, 0, 1, 7)
        assert (stand.kind, stand.x, stand.y) == (
            "flag's stand",
            10 - stream.integer(5),
            stream.integer(7),
        )
        cells = [(body.kind, body.x - 0.5, body.y - 0.5) for body in frame.bodies]
        assert cells[:8] == [("robot", 0, stream.integer(7)) for _ in range(8)]
        assert cells[8:] == [("defender", stand.x, stand.y)] * 2


def test_outputs_that_are_nan_move_no_robot() -> None:
    simulator = Minisim(MinisimSettings())
    simulator.reset(4)
    before = simulator.frame().bodies
    simulator.step(np.full((8, 2), np.nan, np.float32))
    assert simulator.frame().bodies[:8] == before[:8]


def test_random_controllers_capture_almost_nothing() -> None:
    simulator, network = built({})
    outcomes = play(simulator, network, network.random(200, Stream(3)), UNSEEN[:10])
    assert outcomes.metrics[:, 0].mean() < 0.1
    draws = Stream(9)
    _, captures = play_policy(
        lambda seen: draws.uniform(0, 1, 2 * len(seen)).reshape(-1, 2).astype(np.float32),
        UNSEEN[:20],
    )
    assert captures < 0.1


def test_a_greedy_controller_captures_something_and_a_careful_one_more() -> None:
    assert 0.3 < play_policy(greedy, UNSEEN)[1] < play_policy(careful, UNSEEN)[1] < 2


def test_an_evolved_controller_beats_both_on_unseen_seeds() -> None:
    """How the champion was made stands in its file."""
    simulator, network = built(CHAMPION["settings"], CHAMPION["hidden"])
    evolved = play(simulator, network, [champion()], UNSEEN)
    for policy in (greedy, careful):
        fitness, captures = play_policy(policy, UNSEEN)
        assert evolved.fitness.mean() > 1.3 * fitness
        assert evolved.metrics[:, 0].mean() > 1.5 * captures


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        (
            {"steps": 19},
            "minisim: no flag can be captured in 19 steps; width 20 takes 20",
        ),
        (
            {"reach": 7},
            "minisim: reach 7 must not exceed defender_sight 6: "
            "a defender cannot tag what it does not see",
        ),
        (
            {"rest": 1},
            "minisim: rest 1 keeps the defenders on the flag for ever; "
            "give 0 (no rest) or 2 and more",
        ),
        ({"robots": 0}, "problem.settings: robots: expected int >= 1"),
        ({"width": 1}, "problem.settings: width: expected int >= 2"),
        ({"robot": 3}, "problem.settings: unknown key 'robot' (did you mean 'robots'?)"),
    ],
)
def test_impossible_settings_are_refused_in_one_clear_line(
    settings: dict[str, int], text: str
) -> None:
    with pytest.raises(ConfigError) as refusal:
        built(settings)
    assert str(refusal.value).startswith(text)
    assert "\n" not in str(refusal.value)
