"""A controller as JSON for third-party programs; docs/export.md describes its fields."""

import base64
import itertools
from collections.abc import Iterator
from typing import Any

from zswarm.champion.controller import Controller
from zswarm.config.decode import to_json
from zswarm.nets.bulk import Bulk
from zswarm.nets.representation import Representation
from zswarm.nets.vector import VectorRepresentation
from zswarm.robots.c.reference_steps import check_steps, sha256
from zswarm.system import version

VERSION = 1
# Fields of the controller that are written as they are, in this order.
COPIED = (
    "run fitness trials simulator simulator_settings representation representation_settings "
    "inputs outputs sensors actuators"
).split()


def as_json(controller: Controller, name: str) -> dict[str, str]:
    """Return the file ``zs_<name>.json``: ASCII, one field a line."""
    network, parameters = controller.network()
    steps = check_steps(controller)
    fields = {
        "format": "zswarm-controller",
        "version": VERSION,
        "zswarm": version.VERSION,
        "name": f"zs_{name}",
        **{name: getattr(controller, name) for name in COPIED},
        "genome": base64.b64encode(controller.genome).decode(),
        "sha256": sha256(parameters),
        "networks": [_numbers(*part) for part in _networks(network, controller.genome)],
        "check_observations": steps.observations.tolist(),
        "check_actions": steps.actions.tolist(),
    }
    lines = (to_json({key: value})[1:-1] for key, value in fields.items())
    return {f"zs_{name}.json": "{\n" + ",\n".join(lines) + "\n}\n"}


def _networks(
    network: Representation, genome: bytes
) -> Iterator[tuple[VectorRepresentation, bytes]]:
    """Yield the network, or its parts, if their genomes are lists of numbers."""
    if isinstance(network, Bulk):
        size = len(genome) // network.settings.parts
        for begin in range(0, len(genome), size):
            yield from _networks(network.part, genome[begin : begin + size])
    elif isinstance(network, VectorRepresentation):
        yield network, genome


def _numbers(network: VectorRepresentation, genome: bytes) -> dict[str, Any]:
    """Return a genome's numbers: a row for each neuron, and those after the last."""
    vector = network.vectors([genome])[0]
    rows = [
        vector[begin:end].tolist() for begin, end in itertools.pairwise(network.blocks)
    ]
    return {"neurons": rows, "others": vector[network.blocks[-1] :].tolist()}
