"""Create evolved controllers of every kind, as runs do."""

from typing import Any

import msgspec
import numpy as np

from zswarm.champion.controller import Controller
from zswarm.kernels.random import Stream
from zswarm.plugins import registry as plugins

RANGE = {"minimum": [-50], "maximum": [150]}
KINDS: list[tuple[str, dict[str, Any]]] = [
    *((name, {}) for name in plugins.BUNDLED["representation"]),
    *(
        ("fully-meshed", {"hidden": hidden, "activation": activation, "iterations": 3})
        for hidden, activation in ((0, "tanh"), (9, "relu"), (11, "sigmoid"))
    ),
    ("feed-forward", {"hidden": [], "output_activation": "tanh"}),
    (
        "feed-forward",
        {"hidden": [9, 3, 17], "activation": "relu", "output_activation": "clamp"},
    ),
    ("hebbian", {"plasticity": "one", "hidden": 5}),
    ("neat", {"recurrent": True}),
    ("mealy", {"rows": "product", "thresholds": [2]}),
    ("mealy", {"thresholds": [0, 1, 2, 0], "units": [3], "states": 3, **RANGE}),
    *(
        ("bulk", {"parts": 3, "of": {"kind": kind}})
        for kind in ("ctrnn", "feed-forward", "hebbian", "mealy", "three-layer")
    ),
]


def named(kind: tuple[str, dict[str, Any]]) -> str:
    """Return a test's id."""
    return "-".join(
        [kind[0], *(f"{key}={value}" for key, value in kind[1].items())]
    ).replace(" ", "")


def controller(
    kind: str,
    settings: dict[str, Any] | None = None,
    *,
    seed: int = 1,
    inputs: int = 4,
    outputs: int = 3,
) -> Controller:
    """Return a controller with a random genome, mutated sometimes if that changes its structure."""
    part = plugins.load("representation", kind)
    complete = msgspec.convert(settings or {}, part.settings_type)
    network = part(complete, inputs, outputs)
    stream = Stream(seed)
    genomes = network.random(1, stream)
    if kind == "neat":
        for _ in range(40):
            genomes = network.mutate(
                genomes, stream, method=1, severity=0.3, probability=0.7
            )
    return Controller(
        simulator="minisim",
        simulator_settings={"robots": 3},
        representation=kind,
        representation_settings=msgspec.to_builtins(complete),
        inputs=inputs,
        outputs=outputs,
        sensors=[f"sensor {number}" for number in range(inputs)],
        actuators=[f"motor {number}" for number in range(outputs)],
        genome=genomes[0],
        fitness=0.5,
        run="of-a-test",
    )


def observed(inputs: int, steps: int, seed: int = 3) -> np.ndarray:
    """Return (steps, inputs) float32: sensor values, some of them extreme."""
    stream = Stream(seed)
    seen = stream.uniform(-1.0, 2.0, steps * inputs)
    far = stream.uniform(0.0, 1.0, steps * inputs) < 0.02
    return np.where(far, 1e4 * seen, seen).astype(np.float32).reshape(steps, inputs)
