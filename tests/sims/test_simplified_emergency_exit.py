"""Simplified emergency exit gives what FREVO recorded, by its rules."""

from typing import Any

import numpy as np
import pytest

from tests.sims.recorded import PROBLEMS, play
from zswarm.errors import ConfigError
from zswarm.sims.simplified_emergency_exit import (
    SimplifiedEmergencyExit,
    SimplifiedEmergencyExitSettings,
)
from zswarm.testing import check_simulator

OTHER = {
    "agent_x": 3,
    "agent_y": 20,
    "exit_x": 11,
    "exit_y": 5,
    "steps": 12,
    "width": 30,
    "height": 25,
}


@pytest.mark.parametrize(
    "net",
    PROBLEMS["simplified_emergency_exit"],
    ids=lambda net: f"{net['fitness_default']:.4f}",
)
def test_fitness_is_frevos(net: dict[str, Any]) -> None:
    """Bit for bit, in the room that is the default and in another one."""
    assert (
        play("simplified-emergency-exit", {}, net, [1]).fitness[0, 0]
        == net["fitness_default"]
    )
    recorded = net["fitness_agent3_20_exit11_5_steps12_30x25"]
    assert play("simplified-emergency-exit", OTHER, net, [1]).fitness[0, 0] == recorded


@pytest.mark.parametrize(
    "settings",
    [
        {},
        OTHER,
        {
            "steps": 1,
            "width": 1,
            "height": 1,
            "agent_x": 0,
            "agent_y": 0,
            "exit_x": 0,
            "exit_y": 0,
        },
    ],
)
def test_simplified_emergency_exit_keeps_the_contract(settings: dict[str, Any]) -> None:
    check_simulator(SimplifiedEmergencyExit, settings)


@pytest.mark.parametrize(
    ("action", "to"),
    [
        ((1, 1), (2, 1)),  # the lower wall holds it
        ((0, 0), (0, 0)),
        ((2, -5), (2, 0)),
        ((0.999, 0.001), (1, 1)),
        ((0.99999999, 0.5), (2, 1)),  # 1 as float32
        ((np.nan, np.nan), (1, 1)),
    ],
)
def test_only_whole_steps_move_the_robot(
    action: tuple[float, float], to: tuple[int, int]
) -> None:
    simulator = SimplifiedEmergencyExit(
        SimplifiedEmergencyExitSettings(
            steps=1, width=3, height=2, agent_x=1, agent_y=1, exit_x=2, exit_y=0
        )
    )
    assert simulator.reset(1).observations.tolist() == [[1, -1]]
    assert simulator.step(np.array([action], np.float32)) is None
    assert tuple(simulator.outcome().metrics) == to
    assert simulator.outcome().fitness[0] == -(((2 - to[0]) ** 2 + to[1] ** 2) ** 0.5)


@pytest.mark.parametrize(
    "settings",
    [{"agent_x": 100}, {"agent_y": 100}, {"exit_x": 100}, {"height": 99}, {"width": 50}],
)
def test_robot_and_exit_must_lie_in_the_room(settings: dict[str, int]) -> None:
    with pytest.raises(ConfigError, match="must be below width"):
        SimplifiedEmergencyExit(SimplifiedEmergencyExitSettings(**settings))


def test_the_frame_shows_robot_and_exit() -> None:
    simulator = SimplifiedEmergencyExit(SimplifiedEmergencyExitSettings())
    simulator.reset(1)
    frame = simulator.frame()
    assert (frame.width, frame.height) == (100, 100)
    assert [
        (place.kind, place.x + place.width / 2, place.y + place.height / 2)
        for place in frame.places
    ] == [("exit", 99.5, 99.5)]
    assert [(body.kind, body.x, body.y) for body in frame.bodies] == [
        ("robot", 50.5, 50.5)
    ]
