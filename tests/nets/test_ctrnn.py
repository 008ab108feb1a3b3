"""Continuous-time networks follow Beer's equation, by Euler's method, in every form."""

import math
from typing import Any

import numpy as np
import pytest

from zswarm.config.decode import convert
from zswarm.errors import ConfigError
from zswarm.kernels.jit import interpreted
from zswarm.kernels.random import Stream
from zswarm.nets.ctrnn import CTRNN, CtrnnSettings
from zswarm.testing import check_representation


def network(hidden: int = 3, inputs: int = 3, outputs: int = 2, **settings: Any) -> CTRNN:
    return CTRNN(CtrnnSettings(hidden=hidden, **settings), inputs, outputs)


def decide(built: CTRNN, genome: bytes, observations: Any) -> np.ndarray:
    state, parameters = (
        np.zeros(built.state_size, np.float32),
        built.parameters([genome])[0],
    )
    actions = np.empty((len(observations), built.outputs), np.float32)
    for observation, action in zip(
        np.array(observations, np.float32), actions, strict=True
    ):
        built.step(parameters, state, observation, action)
    return actions


def logistic(x: float) -> float:
    return 1 / (1 + math.exp(-x))


def integrated(
    built: CTRNN, genome: bytes, observations: np.ndarray, finer: int = 1
) -> np.ndarray:
    """Compute the same with Beer's equation in float64, in many more steps."""
    table = np.frombuffer(genome, "<f4").astype(float).reshape(built.neurons, -1)
    from_inputs, inner, bias, gene = (
        table[:, : built.inputs],
        table[:, built.inputs : -2],
        table[:, -2],
        table[:, -1],
    )
    settings = built.settings
    tau = (
        settings.tau_min
        + (settings.tau_max - settings.tau_min) * (np.clip(gene, -1, 1) + 1) / 2
    )
    steps = settings.iterations * finer
    y, outputs = np.zeros(built.neurons), []
    for observation in observations:
        for _ in range(steps):
            firing = 1 / (1 + np.exp(-(y + bias)))
            y = y + (-y + inner @ firing + from_inputs @ observation) / tau / steps
        outputs.append(1 / (1 + np.exp(-(y + bias)))[-built.outputs :])
    return np.array(outputs)


@pytest.mark.parametrize("hidden", [0, 3, 9])
@pytest.mark.parametrize("iterations", [1, 4])
def test_decisions_follow_the_equation_compiled_and_plain(
    hidden: int, iterations: int
) -> None:
    built = network(hidden, iterations=iterations)
    observations = Stream(2).uniform(-2.0, 2.0, 90).reshape(30, 3)
    for genome in built.random(5, Stream(hidden)):
        decided = decide(built, genome, observations)
        assert np.abs(decided - integrated(built, genome, observations)).max() < 2e-4
        with interpreted():
            plain = decide(built, genome, observations[:5])
        assert plain.tobytes() == decided[:5].tobytes()


def test_more_iterations_come_nearer_to_the_continuous_network() -> None:
    observations = Stream(2).uniform(-2.0, 2.0, 90).reshape(30, 3)
    (genome,) = network().random(1, Stream(4))
    exact = integrated(network(iterations=1), genome, observations, finer=1000)
    errors = [
        np.abs(decide(network(iterations=iterations), genome, observations) - exact).max()
        for iterations in (1, 4, 16)
    ]
    assert errors[0] > 3 * errors[1] > 9 * errors[2]


def test_a_single_neuron_approaches_its_input_with_its_time_constant() -> None:
    """The neuron's value y follows 1 - e^(-t / tau)."""
    built = network(
        hidden=0, inputs=1, outputs=1, iterations=100, tau_min=5.0, tau_max=5.0
    )
    # From the input, to itself, bias, time constant.
    genome = np.array([1, 0, 0, 0], "<f4").tobytes()
    decided = decide(built, genome, [[1.0]] * 20)[:, 0]
    expected = [logistic(1 - math.exp(-t / 5)) for t in range(1, 21)]
    assert np.abs(decided - expected).max() < 1e-3


@pytest.mark.parametrize(("gene", "tau"), [(-1, 2), (0, 5), (1, 8), (-7, 2), (1e30, 8)])
def test_any_number_gives_a_time_constant_within_the_bounds(
    gene: float, tau: float
) -> None:
    built = network(hidden=0, inputs=1, outputs=1, iterations=4, tau_min=2.0, tau_max=8.0)
    parameters = built.parameters([np.array([1, 0, 0, gene], "<f4").tobytes()])[0]
    assert parameters[-8] == np.float32(1 / (4 * tau))


def test_outputs_and_state_stay_bounded_for_every_genome() -> None:
    """A step goes a part of the way to the weighted sum, never beyond it."""
    built = network(hidden=5, tau_min=0.5, tau_max=0.5)
    wild = np.frombuffer(built.random(1, Stream(1))[0], "<f4") * 1000
    decided = decide(
        built,
        wild.astype("<f4").tobytes(),
        Stream(2).uniform(-9.0, 9.0, 600).reshape(200, 3),
    )
    assert np.isfinite(decided).all()
    assert decided.min() >= 0
    assert decided.max() <= 1


def test_the_network_remembers_earlier_inputs() -> None:
    built = network()
    genome = built.random(1, Stream(1))[0]
    quiet, seen = np.zeros((6, 3)), np.zeros((6, 3))
    seen[0] = 3
    assert (decide(built, genome, quiet)[5] != decide(built, genome, seen)[5]).all()


def test_crossover_takes_a_neuron_with_all_its_numbers() -> None:
    built = network()
    mother, father = (np.full(built.genes, value, "<f4").tobytes() for value in (1, 2))
    child = np.frombuffer(built.crossover(mother, father, Stream(1)), "<f4").reshape(
        built.neurons, -1
    )
    assert (child == child[:, :1]).all()
    assert {1, 2} == set(child[:, 0].tolist())


@pytest.mark.parametrize(
    "settings",
    [{"hidden": 0}, {"hidden": 7, "iterations": 3}, {"tau_min": 0.5, "tau_max": 0.5}],
)
def test_other_settings_keep_the_contract(settings: dict[str, Any]) -> None:
    check_representation(CTRNN, settings)


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"tau_min": 0.4}, "tau_min: expected at least 1 / iterations = 0.5, not 0.4"),
        ({"tau_max": 0.9}, "tau_max: expected at least tau_min = 1.0, not 0.9"),
    ],
)
def test_impossible_time_constants_are_refused(
    settings: dict[str, Any], text: str
) -> None:
    with pytest.raises(ConfigError, match=f"representation: {text}"):
        convert(settings, CtrnnSettings, "representation")
