"""A controller as a model of ONNX: one step, with what it remembers as an input and an output.

The last bits differ from those of evolution, for a run-time may add in any order; docs/export.md says by how much.
"""

import json

import numpy as np

import zswarm
from zswarm.controller import Controller
from zswarm.extras import need
from zswarm.robots import onnx_networks, original
from zswarm.robots.onnx_graph import Graph


def model(controller: Controller, name: str) -> dict[str, bytes]:
    """The file ``zs_<name>.onnx``.

    Args:
        name: as ``names.folded`` gives it.

    Raises:
        ConfigError: onnx is not installed, the network is none of those that are bundled, or as ``Controller.network``.
    """
    onnx = need("onnx", "onnx", "--to onnx")
    network, parameters = controller.network()
    memory, graph = onnx_networks.memory(network), Graph(onnx)
    decided = onnx_networks.decide(graph, network, controller.genome, "observation", "memory")
    inputs = {"observation": (np.float32, controller.inputs)}
    outputs = {"action": (decided.action, np.float32, controller.outputs)}
    if memory.length:
        inputs["memory"] = (memory.dtype, memory.length)
        outputs["next_memory"] = (decided.memory, memory.dtype, memory.length)
    made = graph.finished(f"zs_{name}", inputs, outputs)
    made.producer_name, made.producer_version = "zswarm", zswarm.__version__
    steps = original.check_steps(controller)
    about = {
        "run": controller.run,
        "simulator": controller.simulator,
        "representation": controller.representation,
        "sensors": json.dumps(controller.sensors),
        "actuators": json.dumps(controller.actuators),
        "sha256": original.sha256(parameters),
        "check_observations": json.dumps(steps.observations.tolist()),
        "check_actions": json.dumps(steps.actions.tolist()),
    }
    onnx.helper.set_model_props(made, about)
    onnx.checker.check_model(made)
    return {f"zs_{name}.onnx": made.SerializeToString(deterministic=True)}
