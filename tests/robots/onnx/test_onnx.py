"""An ONNX model of a controller decides nearly the same, step after step."""

import json
import sys
from typing import Any

import msgspec
import numpy as np
import onnx
import onnxruntime
import pytest
from click.testing import CliRunner

from tests.robots.controllers import KINDS, controller, named, observed
from zswarm.champion.controller import Controller
from zswarm.errors import ConfigError
from zswarm.ot import cli
from zswarm.robots.onnx.file import model
from zswarm.robots.onnx.graph import IR, OPSET

# As docs/export.md says: of the greatest difference, or of its share of a larger number.
TOLERANCES = {
    "feed-forward": 1e-5,
    "three-layer": 1e-5,
    "fully-meshed": 1e-4,
    "ctrnn": 1e-4,
    "hebbian": 5e-3,
    "neat": 1e-6,
    "mealy": 0.0,
}
GROWING = 1e-2  # with relu nothing bounds the outputs of a recurrent network
LARGEST = 1e30  # beyond it a sum may leave float32 in one order and not in another
TYPES = {"tensor(float)": np.float32, "tensor(double)": np.float64}

KNOWN = [kind for kind in KINDS if kind[0] != "chocolate"]


class Running:
    """A model in onnxruntime, with its memory."""

    def __init__(self, content: bytes) -> None:
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        self._session = onnxruntime.InferenceSession(
            content, options, providers=["CPUExecutionProvider"]
        )
        self._memory = {
            one.name: np.zeros(one.shape, TYPES[one.type])
            for one in self._session.get_inputs()[1:]
        }

    def act(self, observation: np.ndarray) -> np.ndarray:
        action, *after = self._session.run(
            ["action", *(f"next_{name}" for name in self._memory)],
            {"observation": observation, **self._memory},
        )
        self._memory = dict(zip(self._memory, after, strict=True))
        decided: np.ndarray = action
        return decided


def tolerance(evolved: Controller) -> float:
    settings = evolved.representation_settings
    kind = (
        settings["of"]["kind"]
        if evolved.representation == "bulk"
        else evolved.representation
    )
    return (
        GROWING
        if kind == "fully-meshed" and settings.get("activation") == "relu"
        else TOLERANCES[kind]
    )


def compare(kind: tuple[str, dict[str, Any]], seed: int, steps: int) -> None:
    evolved = controller(*kind, seed=seed)
    running, driver = Running(model(evolved, "x")["zs_x.onnx"]), evolved.driver()
    near, actions, expected = tolerance(evolved), [], []
    for observation in observed(evolved.inputs, steps, seed):
        action = driver.act(observation).copy()
        if np.abs(action).max() > LARGEST:
            break
        expected.append(action)
        actions.append(running.act(observation))
    np.testing.assert_allclose(actions, expected, rtol=near, atol=near)
    assert len({action.tobytes() for action in expected}) > 1


@pytest.mark.parametrize("kind", KNOWN, ids=named)
def test_a_model_decides_like_the_network_within_the_tolerance(
    kind: tuple[str, dict[str, Any]],
) -> None:
    compare(kind, 1, 100)


@pytest.mark.robots
@pytest.mark.parametrize("seed", [1, 2, 3, 4])
@pytest.mark.parametrize("kind", KNOWN, ids=named)
def test_a_model_stays_within_the_tolerance_for_a_thousand_steps(
    kind: tuple[str, dict[str, Any]], seed: int
) -> None:
    compare(kind, seed, 1000)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 3e9, -3e9])
def test_a_machine_takes_what_no_sensor_should_give(value: float) -> None:
    """Cut as in evolution, whether inputs have thresholds or not."""
    evolved = controller(
        *next(kind for kind in KINDS if kind[1].get("thresholds") == [0, 1, 2, 0])
    )
    running, driver = Running(model(evolved, "x")["zs_x.onnx"]), evolved.driver()
    for number in range(4):
        observation = np.full(4, 0.3, np.float32)
        observation[number] = value
        assert running.act(observation).tobytes() == driver.act(observation).tobytes()


def test_a_model_has_metadata_and_reproducible_bytes() -> None:
    evolved = controller("ctrnn")
    content = model(evolved, "x")["zs_x.onnx"]
    assert content == model(evolved, "x")["zs_x.onnx"]
    found = onnx.load_from_string(content)
    assert (
        found.ir_version,
        [(one.domain, one.version) for one in found.opset_import],
    ) == (
        IR,
        [("", OPSET)],
    )
    about = {one.key: one.value for one in found.metadata_props}
    assert json.loads(about["sensors"]) == evolved.sensors
    running = Running(content)
    for observation, action in zip(
        json.loads(about["check_observations"]),
        json.loads(about["check_actions"]),
        strict=True,
    ):
        np.testing.assert_allclose(
            running.act(np.array(observation, np.float32)), action, atol=1e-5
        )


def test_a_network_without_memory_has_no_input_for_it() -> None:
    found = onnx.load_from_string(model(controller("feed-forward"), "x")["zs_x.onnx"])
    assert [one.name for one in found.graph.input] == ["observation"]
    assert [one.name for one in found.graph.output] == ["action"]


def test_a_plugins_network_is_refused_in_one_line(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from zswarm.nets.representation import Representation
    from zswarm.robots.onnx import networks as onnx_networks

    class Other(Representation):
        pass

    monkeypatch.setattr(Other, "__abstractmethods__", frozenset())
    with pytest.raises(
        ConfigError,
        match=r"knows the bundled networks except chocolate, .* not this Other; python and "
        "c99 may know it",
    ):
        onnx_networks.memory(Other(msgspec.defstruct("S", [])(), 1, 1))


def test_a_missing_package_is_named_with_the_command_that_installs_it(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Any
) -> None:
    monkeypatch.setitem(sys.modules, "onnx", None)
    (tmp_path / "c.zsc").write_bytes(msgspec.msgpack.encode(controller("ctrnn")))
    done = CliRunner().invoke(
        cli.command,
        ["export", str(tmp_path / "c.zsc"), "--to", "onnx", "--out", str(tmp_path / "f")],
    )
    assert isinstance(done.exception, ConfigError)
    assert str(done.exception).startswith("--to onnx needs onnx: ")
    assert str(done.exception).endswith(" install onnx")
    assert not (tmp_path / "f").exists()
