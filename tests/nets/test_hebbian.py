"""Hebbian networks decide and learn what FREVO's did, bit for bit; what was broken there works."""

import contextlib
import json
from typing import Any

import numpy as np
import pytest

from tests.repository import REPOSITORY
from zswarm.kernels.jit import interpreted
from zswarm.kernels.random import Stream
from zswarm.nets.hebbian import HEADER, Hebbian, HebbianSettings
from zswarm.testing import check_representation

NETS = json.loads((REPOSITORY / "tests" / "golden" / "hebb.json").read_text())["nets"]


def network(
    hidden: int = 2, inputs: int = 3, outputs: int = 2, **settings: Any
) -> Hebbian:
    return Hebbian(HebbianSettings(hidden=hidden, **settings), inputs, outputs)


def recorded(net: dict[str, Any], plasticity: str) -> tuple[Hebbian, bytes]:
    """A recorded net and its genome, in the one way or the other."""
    built = network(
        net["hidden"],
        net["inputs"],
        net["outputs"],
        iterations=net["stepNumber"],
        plasticity=plasticity,
    )
    ones = [1.0] * built.sources if plasticity == "each" else []
    neurons = [
        [*weights, *ones, bias]
        for weights, bias in zip(net["weights_into"], net["bias"], strict=True)
    ]
    return built, np.array(
        [*np.concatenate(neurons), net["learningrate"]], "<f4"
    ).tobytes()


def learnt(built: Hebbian, state: np.ndarray) -> np.ndarray:
    """(neurons, sources) float32, the weights in a state."""
    row = built.parameters([bytes(built.genome_bytes)]).shape[1] - HEADER
    row //= 2 * built.sources + 1
    return (
        state[2 * row : (2 + built.sources) * row]
        .reshape(built.sources, row)[:, : built.neurons]
        .T
    )


def decide(
    built: Hebbian, genome: bytes, state: np.ndarray, observations: Any
) -> np.ndarray:
    parameters = built.parameters([genome])[0]
    actions = np.empty((len(observations), built.outputs), np.float32)
    for observation, action in zip(
        np.array(observations, np.float32), actions, strict=True
    ):
        built.step(parameters, state, observation, action)
    return actions


def genome_of(built: Hebbian, *, weights: float, plasticity: float, rate: float) -> bytes:
    """All weights alike, all plasticities alike, no biases."""
    neuron = [weights] * built.sources + [plasticity] * built.sources + [0.0]
    return np.array([*(neuron * built.neurons), rate], "<f4").tobytes()


@pytest.mark.parametrize("plasticity", ["one", "each"])
@pytest.mark.parametrize("net", NETS, ids=lambda net: str(net["id"]))
def test_a_recorded_net_decides_and_learns_as_in_frevo_bit_for_bit(
    net: dict[str, Any], plasticity: str
) -> None:
    built, genome = recorded(net, plasticity)
    for compiled_or_plain in (contextlib.nullcontext, interpreted):
        state = np.zeros(built.state_size, np.float32)
        with compiled_or_plain():
            decided = decide(built, genome, state, net["in"])
            after = np.ascontiguousarray(learnt(built, state)).tobytes()
            continued = decide(built, genome, state, net["in"][:3])
        assert decided.tobytes() == np.array(net["out"], np.float32).tobytes()
        expected = np.array(net["weights_into_after_60_steps"], np.float32)
        assert after == expected.tobytes()
        assert continued.tobytes() == np.array(net["out_continued"], np.float32).tobytes()


def test_some_recorded_nets_learn_much() -> None:
    changes = [
        np.abs(np.array(net["weights_into_after_60_steps"]) - net["weights_into"]).max()
        for net in NETS
    ]
    assert max(changes) > 8


def test_a_weight_without_plasticity_stays_and_one_of_half_learns_half() -> None:
    """FREVO never uses plasticities."""
    built = network(iterations=1)
    seen = [[0.9, 0.1, 0.4]]
    changes = {}
    for plasticity in (0.0, 0.5, 1.0):
        state = np.zeros(built.state_size, np.float32)
        decide(
            built,
            genome_of(built, weights=0.25, plasticity=plasticity, rate=0.5),
            state,
            seen,
        )
        changes[plasticity] = learnt(built, state) - np.float32(0.25)
    assert not changes[0.0].any()
    assert changes[1.0].any()
    assert np.allclose(changes[0.5], changes[1.0] / 2, atol=1e-6)


def test_weights_between_active_neurons_grow_most() -> None:
    """A weight between two active nodes grows most, and the mean change is 0."""
    built = network(hidden=0, inputs=2, outputs=1, iterations=1)
    state = np.zeros(built.state_size, np.float32)
    decide(
        built, genome_of(built, weights=1.0, plasticity=1.0, rate=0.1), state, [[1, 0]]
    )
    change = learnt(built, state)[0] - 1
    assert change == pytest.approx([0.025, -0.025, 0]), (
        "0.1 x 1/2 x (1/2, -1/2); not the weight to itself"
    )


def test_every_trial_begins_with_the_genomes_weights() -> None:
    built = network()
    (genome,) = built.random(1, Stream(1))
    observations = Stream(2).uniform(-3.0, 3.0, 60).reshape(20, 3)
    first = decide(built, genome, np.zeros(built.state_size, np.float32), observations)
    assert (
        decide(
            built, genome, np.zeros(built.state_size, np.float32), observations
        ).tobytes()
        == first.tobytes()
    )


@pytest.mark.parametrize(
    "settings", [{"hidden": 0}, {"hidden": 9, "iterations": 3}, {"plasticity": "one"}]
)
def test_other_settings_keep_the_contract(settings: dict[str, Any]) -> None:
    check_representation(Hebbian, settings)


# ---- operators


def test_a_genome_holds_weights_plasticities_bias_per_neuron_and_one_rate() -> None:
    assert network().genes == 4 * (7 + 7 + 1) + 1
    assert network(plasticity="one").genes == 4 * (7 + 1) + 1
    assert network(hidden=0, inputs=1, outputs=1, rate_range=0.5).ranges.tolist() == [
        2,
        2,
        1,
        1,
        2,
        0.5,
    ]


@pytest.mark.parametrize(("method", "reach"), [(1, 0.003), (2, 0.01)])
def test_the_learning_rate_mutates(method: int, reach: float) -> None:
    """FREVO never mutates it: 0 of 12 networks changed."""
    built = network()
    mutants = built.mutate(
        [bytes(built.genome_bytes)] * 500,
        Stream(1),
        method=method,
        severity=0.3,
        probability=1.0,
    )
    rates = np.array([np.frombuffer(mutant, "<f4")[-1] for mutant in mutants])
    assert 0.95 * reach < np.abs(rates).max() <= reach * (1 + 1e-6)
    assert (rates != 0).all()


def test_mutation_2_is_fine_for_plasticities_and_coarse_for_weights_and_biases() -> None:
    built = network(hidden=0, inputs=1, outputs=1)
    mutants = built.mutate(
        [bytes(built.genome_bytes)] * 1000,
        Stream(1),
        method=2,
        severity=0.3,
        probability=1.0,
    )
    reaches = np.abs([np.frombuffer(mutant, "<f4") for mutant in mutants]).max(axis=0)
    assert reaches == pytest.approx([10, 10, 0.1, 0.1, 10, 0.01], rel=0.05)


def test_the_mothers_rate_remains_after_a_crossover() -> None:
    built = network()
    mother, father = (np.full(built.genes, value, "<f4").tobytes() for value in (1, 2))
    stream = Stream(1)
    children = np.array(
        [
            np.frombuffer(built.crossover(mother, father, stream), "<f4")
            for _ in range(200)
        ]
    )
    assert (children[:, -1] == 1).all()
    neurons = children[:, :-1].reshape(200, 4, 15)
    assert (neurons == neurons[:, :, :1]).all(), (
        "a neuron comes with its weights, plasticities and bias"
    )
    assert (neurons == 2).any(axis=(0, 2)).all()
