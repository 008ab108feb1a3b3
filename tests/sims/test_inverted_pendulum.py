"""The inverted pendulum gives what FREVO recorded, by its rules."""

import math
from typing import Any, get_args

import numpy as np
import pytest

from tests.sims.recorded import PROBLEMS, play
from zswarm.sims.inverted_pendulum import (
    FITNESS_MODELS,
    INPUT_MODELS,
    InvertedPendulum,
    InvertedPendulumSettings,
)
from zswarm.testing import check_simulator

NETS = PROBLEMS["inverted_pendulum"]
HALF = np.full((1, 1), 0.5, np.float32)  # no force


def ours(name: str) -> str:
    """How a setting calls what FREVO calls so."""
    return name.lower().replace("_", "-")


def begun(settings: dict[str, Any], **state: float) -> InvertedPendulum:
    """Return a trial that has begun, with other numbers in its state."""
    simulator = InvertedPendulum(InvertedPendulumSettings(**settings))
    simulator.reset(1)
    for number, name in enumerate(("phi", "rod_speed", "cart_speed", "position")):
        simulator.world.state[number] = state.get(name, simulator.world.state[number])
    return simulator


@pytest.mark.parametrize("net", NETS, ids=range(len(NETS)))
def test_fitness_after_200_steps_is_frevos(net: dict[str, Any]) -> None:
    settings = {"steps": 200, "input_model": ours(net["inputmodel"])}
    assert play("inverted-pendulum", settings, net, [1]).fitness[0, 0] == pytest.approx(
        net["fitness_200_steps"], rel=1e-9
    )


@pytest.mark.parametrize("model", NETS[0]["fitness"])
@pytest.mark.parametrize("net", NETS, ids=range(len(NETS)))
def test_fitness_after_10000_steps_is_nearly_frevos(
    net: dict[str, Any], model: str
) -> None:
    """The last bits of sine and cosine change it by 7e-12 at most in ten seconds, as measured."""
    settings = {"input_model": ours(net["inputmodel"]), "fitness_model": ours(model)}
    assert play("inverted-pendulum", settings, net, [1]).fitness[0, 0] == pytest.approx(
        net["fitness"][model], rel=1e-10
    )


def test_the_choices_are_frevos() -> None:
    assert {ours(model) for net in NETS for model in net["fitness"]} == set(
        FITNESS_MODELS
    )
    for field, choices in (
        ("fitness_model", FITNESS_MODELS),
        ("input_model", INPUT_MODELS),
    ):
        assert (
            get_args(get_args(InvertedPendulumSettings.__annotations__[field])[0])
            == choices
        )


@pytest.mark.parametrize(
    "settings",
    [
        {"steps": 30, "input_model": INPUT_MODELS[0]},
        {"steps": 1, "input_model": INPUT_MODELS[3]},
    ],
)
def test_inverted_pendulum_keeps_the_contract(settings: dict[str, Any]) -> None:
    check_simulator(InvertedPendulum, settings)


def test_an_unpushed_pendulum_hangs_and_has_fitness_zero() -> None:
    simulator = begun({"steps": 50, "fitness_model": "angle-pow-2"})
    while simulator.step(HALF) is not None:
        pass
    assert simulator.outcome().fitness[0] == pytest.approx(0.0, abs=1e-12)
    assert list(simulator.outcome().metrics) == pytest.approx([0, 0, 0, 180], abs=1e-9)


@pytest.mark.parametrize(
    ("degrees", "angle"),
    [
        (90, 0),
        (180, 90),
        (270, 180),
        (0, -90),
        (-1, 269),
        (450, 0),
        (-300, -30),
        (-359, -89),
        (-370, -100),
    ],
)
def test_angles_are_converted_as_the_data_sheet_states(
    degrees: float, angle: float
) -> None:
    """Agree up to float32 rounding.

    The last case is FREVO's: its remainder has the sign of the dividend.
    """
    simulator = begun({}, phi=math.radians(degrees))
    assert simulator._turn().observations[0, 0] == pytest.approx(angle, abs=1e-3)


def test_the_controller_senses_what_the_input_model_says() -> None:
    for count, model in enumerate(INPUT_MODELS, start=1):
        simulator = begun(
            {"input_model": model},
            phi=math.pi,
            rod_speed=1.5,
            cart_speed=-2.5,
            position=3.5,
        )
        assert simulator._turn().observations.tolist() == [[90.0, 1.5, -2.5, 3.5][:count]]
        assert (simulator.inputs, len(simulator.sensors)) == (count, count)


def test_a_step_moves_cart_and_mass_by_the_formulas_of_the_data_sheet() -> None:
    simulator = begun(
        {"timestep_ms": 100.0}, phi=1.0, rod_speed=0.5, cart_speed=2.0, position=-1.0
    )
    simulator.step(np.array([[0.75]], np.float32))
    sine, cosine = math.sin(1.0), math.cos(1.0)
    a = (2.5 - 0.01 * 9.81 * sine * cosine + 0.01 * 0.25 * cosine) / (0.1 + 0.01 * cosine)
    speed, mass = 2.0 + a * 0.1, 0.5 + (a * sine - 9.81 * cosine) * 0.1
    assert simulator.world.state[:4].tolist() == pytest.approx(
        [1.0 + mass * 0.1, mass, speed, -1.0 + speed * 0.1]
    )


def test_upright_counts_the_steps_near_the_top() -> None:
    for degrees, share in ((90, 1.0), (79, 1.0), (101, 1.0), (77, 0.0), (103, 0.0)):
        simulator = begun({"steps": 1}, phi=math.radians(degrees))
        assert simulator.step(HALF) is None
        assert simulator.outcome().metrics[0] == share


def test_the_frame_shows_cart_and_mass_and_notes_when_the_cart_is_outside() -> None:
    simulator = begun({}, phi=math.pi, position=1.0)
    cart, mass = simulator.frame().bodies
    (rod,) = simulator.frame().lines
    assert (cart.kind, cart.x, cart.y) == ("cart", 6.0, 1.3)
    assert (mass.kind, mass.x, mass.y) == ("mass", pytest.approx(5.0), pytest.approx(1.3))
    assert rod == ("rod", cart.x, cart.y, mass.x, mass.y)
    cart, *_ = begun({}, position=-1000.0).frame().bodies
    assert (cart.kind, cart.x) == ("cart, out of view", 1.0)
