"""Replay FREVO's recordings of small problems, with the same networks in our simulators."""

import json
from typing import Any

import numpy as np

from tests.repository import REPOSITORY
from zswarm.evaluate import TrialOutcomes, build, evaluate

PROBLEMS: dict[str, Any] = json.loads(
    (REPOSITORY / "tests" / "golden" / "problems.json").read_text()
)
ACTIVATIONS = {"LINEAR": "clamp", "SIGMOID": "sigmoid", "RELU": "relu"}


def play(
    simulator: str, settings: dict[str, Any], net: dict[str, Any], seeds: list[int]
) -> TrialOutcomes:
    """Play a recorded network on some seeds."""
    shape = {
        "hidden": net["hidden"],
        "iterations": net["iterations"],
        "activation": ACTIVATIONS[net["activation"]],
    }
    table = [
        [*weights, bias]
        for weights, bias in zip(net["weights_into"], net["bias"], strict=True)
    ]
    genome = np.array(table, "<f4").tobytes()
    built = build(simulator, settings, "fully-meshed", shape)
    return evaluate(
        *built, [genome], np.zeros((len(seeds), 1), np.int64), np.array(seeds, np.uint64)
    )
