"""A controller as one Python file that needs only numpy: its network's kernel, and its parameters.

It decides the bits of evolution: the source of the functions is the same, and numpy rounds ``+ - *
/`` and square roots as every processor does.
"""

import numpy as np

from zswarm.champion.controller import Controller
from zswarm.robots.c import kernel_source
from zswarm.robots.c.kernel_function import plain
from zswarm.robots.c.quoting import Code, python_literal
from zswarm.robots.c.reference_steps import check_steps, sha256
from zswarm.robots.c.templates import fill
from zswarm.system.version import VERSION


def python(controller: Controller, name: str) -> dict[str, str]:
    """Return the file ``zs_<name>.py``."""
    network, parameters = controller.network()
    steps = check_steps(controller)
    code = {
        "kernel": kernel_source.functions([network.step]).rstrip(),
        "parameters": kernel_source.packed(np.asarray(parameters)),
        "observations": kernel_source.packed(steps.observations),
        "actions": kernel_source.packed(steps.actions),
    }
    words: dict[str, object] = {
        "unit": f"zs_{name}",
        "version": VERSION,
        "sha256": sha256(parameters),
        "inputs": controller.inputs,
        "outputs": controller.outputs,
        "state": network.state_size,
        "step": plain(network.step).__name__,
    } | {name: Code("python", text) for name, text in code.items()}
    for key in ("run", "simulator", "representation", "sensors", "actuators"):
        words[key] = python_literal(getattr(controller, key))
    return {f"zs_{name}.py": fill("python/controller.py.in", words)}
