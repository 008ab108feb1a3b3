"""A controller as JSON, for programs of others: docs/export.md says what each field means."""

import base64
import itertools
from collections.abc import Iterator
from typing import Any

import zswarm
from zswarm.controller import Controller
from zswarm.nets.bulk import Bulk
from zswarm.nets.representation import Representation
from zswarm.nets.vector import VectorRepresentation
from zswarm.robots import original
from zswarm.strict import to_json

VERSION = 1


def as_json(controller: Controller, name: str) -> dict[str, str]:
    """The file ``zs_<name>.json``: ASCII, a field a line.

    Args:
        name: as ``names.folded`` gives it.

    Raises:
        ConfigError: as ``Controller.network``.
    """
    network, parameters = controller.network()
    steps = original.check_steps(controller)
    fields = {
        "format": "zswarm-controller",
        "version": VERSION,
        "zswarm": zswarm.__version__,
        "name": f"zs_{name}",
        "run": controller.run,
        "fitness": controller.fitness,
        "simulator": controller.simulator,
        "simulator_settings": controller.simulator_settings,
        "representation": controller.representation,
        "representation_settings": controller.representation_settings,
        "inputs": controller.inputs,
        "outputs": controller.outputs,
        "sensors": controller.sensors,
        "actuators": controller.actuators,
        "genome": base64.b64encode(controller.genome).decode(),
        "sha256": original.sha256(parameters),
        "networks": [_numbers(part, genome) for part, genome in _networks(network, controller.genome)],
        "check_observations": steps.observations.tolist(),
        "check_actions": steps.actions.tolist(),
    }
    lines = (to_json({key: value})[1:-1] for key, value in fields.items())
    return {f"zs_{name}.json": "{\n" + ",\n".join(lines) + "\n}\n"}


def _networks(network: Representation, genome: bytes) -> Iterator[tuple[VectorRepresentation, bytes]]:
    """The network, or the parts that it consists of, if their genomes are lists of numbers."""
    if isinstance(network, Bulk):
        size = len(genome) // network.settings.parts
        for begin in range(0, len(genome), size):
            yield from _networks(network.part, genome[begin : begin + size])
    elif isinstance(network, VectorRepresentation):
        yield network, genome


def _numbers(network: VectorRepresentation, genome: bytes) -> dict[str, Any]:
    """The genome's numbers, those of each neuron in a row, and those behind the last neuron."""
    vector = network.vectors([genome])[0]
    rows = [vector[begin:end].tolist() for begin, end in itertools.pairwise(network.blocks)]
    return {"neurons": rows, "others": vector[network.blocks[-1] :].tolist()}
