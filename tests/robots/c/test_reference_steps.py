"""What every export says of its controller."""

import hashlib

import msgspec
import numpy as np
import pytest

from tests.robots.controllers import KINDS, controller, named
from zswarm.errors import ConfigError
from zswarm.robots.c.reference_steps import STEPS, check_steps, sha256


@pytest.mark.parametrize("kind", KINDS, ids=named)
def test_check_steps_are_what_the_controller_decides(
    kind: tuple[str, dict[str, object]],
) -> None:
    """The same every time, and not all alike."""
    evolved = controller(*kind)
    steps, driver = check_steps(evolved), evolved.driver()
    assert steps.observations.shape == (STEPS, 4)
    for observation, action in zip(steps.observations, steps.actions, strict=True):
        assert driver.act(observation).tobytes() == action.tobytes()
    assert check_steps(evolved).actions.tobytes() == steps.actions.tobytes()
    assert len(np.unique(steps.actions, axis=0)) > 1


def test_the_hash_is_of_what_the_step_reads() -> None:
    """Another activation has another hash, though the genome is the same."""
    evolved = controller("fully-meshed", {"activation": "tanh"})
    _, parameters = evolved.network()
    assert sha256(parameters) == hashlib.sha256(parameters.tobytes()).hexdigest()
    settings = {**evolved.representation_settings, "activation": "relu"}
    _, others = msgspec.structs.replace(
        evolved, representation_settings=settings
    ).network()
    assert sha256(others) != sha256(parameters)


@pytest.mark.parametrize(
    "change",
    [{"genome": b"\0\0\0\0"}, {"inputs": -1}, {"outputs": 0}, {"representation": "none"}],
)
def test_an_invalid_controller_is_refused_in_one_line(change: dict[str, object]) -> None:
    with pytest.raises(ConfigError) as raised:
        check_steps(msgspec.structs.replace(controller("fully-meshed"), **change))
    assert "\n" not in str(raised.value)
