"""Test controllers as JSON: a reader needs docs/export.md and nothing of zswarm."""

import base64
import json
import re
from typing import Any

import msgspec
import numpy as np
import pytest

from tests.repository import REPOSITORY
from tests.robots.controllers import KINDS, controller, named, observed
from zswarm.robots.json_file import as_json

PAGE = REPOSITORY / "docs" / "export.md"
LISTS = (
    *("fully-meshed", "hebbian", "ctrnn", "feed-forward", "three-layer"),
    "chocolate",
)


def read(
    kind: str, settings: dict[str, Any] | None = None, **sizes: int
) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(
        as_json(controller(kind, settings, **sizes), "x")["zs_x.json"]
    )
    return found


def decide(
    read: dict[str, Any], outputs_before: np.ndarray, observation: np.ndarray
) -> np.ndarray:
    """Compute a step as the document says: "A fully-meshed network by hand"."""
    settings, table = (
        read["representation_settings"],
        np.array(read["networks"][0]["neurons"], np.float32),
    )
    inputs, zero, one = read["inputs"], np.float32(0), np.float32(1)
    outputs = outputs_before
    for _ in range(settings["iterations"]):
        fresh = []
        for row in table:
            total = zero
            for number in range(inputs):
                total = total + row[number] * observation[number]
            for number, value in enumerate(outputs):
                total = total + row[inputs + number] * value
            total = row[-1] + total
            if settings["activation"] == "clamp":
                total = min(max(total, zero), one)
            else:
                assert settings["activation"] == "relu"
                total = max(total, zero)
            fresh.append(total)
        outputs = np.array(fresh, np.float32)
    return outputs


@pytest.mark.parametrize(
    ("seed", "activation", "hidden"), [(1, "clamp", 2), (2, "relu", 0), (5, "clamp", 9)]
)
def test_a_fully_meshed_network_is_played_by_the_document(
    seed: int, activation: str, hidden: int
) -> None:
    evolved = controller(
        "fully-meshed",
        {"activation": activation, "hidden": hidden, "weight_range": 0.4},
        seed=seed,
    )
    found = json.loads(as_json(evolved, "x")["zs_x.json"])
    outputs, driver = np.zeros(hidden + 3, np.float32), evolved.driver()
    acted = set()
    for observation in observed(4, 80):
        outputs = decide(found, outputs, observation)
        assert outputs[-found["outputs"] :].tobytes() == driver.act(observation).tobytes()
        acted.add(outputs.tobytes())
    assert len(acted) > 20


def test_the_check_is_what_the_network_decides() -> None:
    found = read("fully-meshed", {"activation": "relu"})
    outputs = np.zeros(5, np.float32)
    for observation, action in zip(
        found["check_observations"], found["check_actions"], strict=True
    ):
        outputs = decide(found, outputs, np.array(observation, np.float32))
        assert outputs[-3:].tolist() == action


@pytest.mark.parametrize("kind", KINDS, ids=named)
def test_numbers_are_those_of_the_genome(kind: tuple[str, dict[str, Any]]) -> None:
    """Every bit, in its order; what is no list of numbers is there as bytes."""
    found = read(*kind)
    assert base64.b64decode(found["genome"]) == controller(*kind).genome
    listed = kind[0] in LISTS or (
        kind[0] == "bulk" and found["representation_settings"]["of"]["kind"] in LISTS
    )
    parts = [
        np.concatenate([*each["neurons"], each["others"]]) for each in found["networks"]
    ]
    assert b"".join(part.astype("<f4").tobytes() for part in parts) == (
        controller(*kind).genome if listed else b""
    )
    assert len(found["networks"]) == (
        found["representation_settings"].get("parts", 1) if listed else 0
    )
    assert as_json(controller(*kind), "x") == as_json(controller(*kind), "x")


def test_every_field_is_documented_in_its_order() -> None:
    section = re.search(
        r"^## JSON$(.*?)^## ", PAGE.read_text(encoding="utf-8"), re.S | re.M
    )
    assert section
    rows = [
        re.findall(r"`([^`]+)`", line.split("|")[1])
        for line in section[1].splitlines()
        if line.startswith("| `")
    ]
    assert [name for row in rows for name in row] == list(read("ctrnn"))


def test_numbers_that_json_lacks_become_null() -> None:
    evolved = msgspec.structs.replace(
        controller("mealy"), fitness=float("nan"), simulator_settings={"x": float("inf")}
    )
    text = as_json(evolved, "x")["zs_x.json"]
    found = json.loads(text, parse_constant=pytest.fail)
    assert (found["fitness"], found["simulator_settings"]) == (None, {"x": None})
    assert text.isascii()
