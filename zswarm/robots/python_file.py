"""A controller as one Python file that needs numpy alone: the plain form of its network's kernel, and its parameters.

It decides the same bits as in evolution: the functions are the same source (``gather.py``), and numpy rounds ``+ - * /`` and
square roots as every processor does.
"""

import numpy as np

import zswarm
from zswarm.controller import Controller
from zswarm.robots import gather, original

TEMPLATE = '''"""The controller @NAME@, made by zswarm @VERSION@: Python 3.8 or newer, and numpy.

    from @NAME@ import Controller

    controller = Controller()                  # each robot needs its own
    action = controller.act(observation)       # numbers in the order of SENSORS, and of ACTUATORS

``python @NAME@.py`` plays stored steps, and says whether this machine decides the same bits.
"""

import base64
import hashlib
import sys

import numpy as np

NAME = "@NAME@"
SHA256 = "@SHA256@"  # of PARAMETERS
RUN = @RUN@
SIMULATOR = @SIMULATOR@
REPRESENTATION = @REPRESENTATION@
SENSORS = @SENSORS@
ACTUATORS = @ACTUATORS@
INPUTS, OUTPUTS, STATE = @INPUTS@, @OUTPUTS@, @STATE@


class Controller:
    """One robot's network with its memory."""

    inputs, outputs = INPUTS, OUTPUTS

    def __init__(self):
        self._state = np.zeros(STATE, np.float32)

    def reset(self):
        """Forget all of before, as at the start of a trial."""
        self._state[:] = 0

    def act(self, observation):
        """The decision, (OUTPUTS,) float32, on an observation of INPUTS numbers."""
        seen = np.ascontiguousarray(observation, np.float32)
        if seen.shape != (INPUTS,):
            raise ValueError("observation: expected shape (%d,), not %r" % (INPUTS, seen.shape))
        decided = np.empty(OUTPUTS, np.float32)
        with np.errstate(all="ignore"):
            @STEP@(PARAMETERS, self._state, seen, decided)
        return decided


def selftest():
    """How many of the stored steps are decided differently here, to the bit; 0 on a machine to be trusted."""
    if hashlib.sha256(PARAMETERS.astype("<f4").tobytes()).hexdigest() != SHA256:
        return len(ACTIONS)
    controller = Controller()
    decided = [controller.act(observation) for observation in OBSERVATIONS]
    return sum(one.tobytes() != other.tobytes() for one, other in zip(decided, ACTIONS))


# ---- the network
@KERNEL@

# ---- its parameters, and steps to check it by

PARAMETERS = @PARAMETERS@
OBSERVATIONS = @OBSERVATIONS@.reshape(-1, INPUTS)
ACTIONS = @ACTIONS@.reshape(-1, OUTPUTS)

if __name__ == "__main__":
    different = selftest()
    print("%s: %d of %d steps have the same bits" % (NAME, len(ACTIONS) - different, len(ACTIONS)))
    sys.exit(different != 0)
'''


def python(controller: Controller, name: str) -> dict[str, str]:
    """The file ``zs_<name>.py``.

    Args:
        name: as ``names.folded`` gives it.

    Raises:
        ConfigError: as ``Controller.network``; a plug-in's network is not made of functions and numbers.
    """
    network, parameters = controller.network()
    steps = original.check_steps(controller)
    parts = {
        "NAME": f"zs_{name}",
        "VERSION": zswarm.__version__,
        "SHA256": original.sha256(parameters),
        "INPUTS": str(controller.inputs),
        "OUTPUTS": str(controller.outputs),
        "STATE": str(network.state_size),
        "STEP": gather.plain(network.step).__name__,
        "KERNEL": gather.functions([network.step]).rstrip(),
        "PARAMETERS": gather.packed(np.asarray(parameters)),
        "OBSERVATIONS": gather.packed(steps.observations),
        "ACTIONS": gather.packed(steps.actions),
        # Behind all others: nothing is looked for in what others wrote.
        "RUN": ascii(controller.run),
        "SIMULATOR": ascii(controller.simulator),
        "REPRESENTATION": ascii(controller.representation),
        "SENSORS": ascii(controller.sensors),
        "ACTUATORS": ascii(controller.actuators),
    }
    text = TEMPLATE
    for key, part in parts.items():
        text = text.replace(f"@{key}@", part)
    return {f"zs_{name}.py": text}
