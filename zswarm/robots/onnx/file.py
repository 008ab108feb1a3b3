"""A controller as an ONNX model of one step, with its memory as an input and an output.

Its last bits differ from those of evolution, since a runtime may add in any order: see the greatest
differences in docs/export.md.
"""

import json

import numpy as np

from zswarm.champion.controller import Controller
from zswarm.robots.c.reference_steps import check_steps, sha256
from zswarm.robots.onnx import networks
from zswarm.robots.onnx.graph import OnnxGraph, OnnxValue
from zswarm.system.extras import need
from zswarm.system.version import VERSION


def model(controller: Controller, name: str) -> dict[str, bytes]:
    """Return the file ``zs_<name>.onnx``."""
    onnx = need("onnx", "onnx", "--to onnx")
    network, parameters = controller.network()
    memory, graph = networks.memory(network), OnnxGraph(onnx)
    observation = OnnxValue(graph, "observation", np.float32)
    before = OnnxValue(graph, "memory", memory.dtype)
    decided = networks.decide(network, controller.genome, observation, before)
    inputs = {"observation": (np.float32, controller.inputs)}
    outputs = {"action": (decided.action, controller.outputs)}
    if memory.length:
        inputs["memory"] = (memory.dtype, memory.length)
        outputs["next_memory"] = (decided.memory, memory.length)
    made = graph.model(f"zs_{name}", inputs, outputs)
    made.producer_name, made.producer_version = "zswarm", VERSION
    steps = check_steps(controller)
    about = {
        "run": controller.run,
        "simulator": controller.simulator,
        "representation": controller.representation,
        "sensors": json.dumps(controller.sensors),
        "actuators": json.dumps(controller.actuators),
        "sha256": sha256(parameters),
        "check_observations": json.dumps(steps.observations.tolist()),
        "check_actions": json.dumps(steps.actions.tolist()),
    }
    onnx.helper.set_model_props(made, about)
    onnx.checker.check_model(made)
    return {f"zs_{name}.onnx": made.SerializeToString(deterministic=True)}
