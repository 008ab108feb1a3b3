"""Load the evolved controller in one of three forms; each robot has an instance with its state."""

import ctypes
import json
import struct

INPUTS, OUTPUTS = 10, 2  # of a robot of room.py
FLOAT32 = struct.Struct("f")


def float32(number):
    """Round to the nearest float32, because Python computes in float64."""
    return FLOAT32.unpack(FLOAT32.pack(number))[0]


class FullyMeshed:
    """A fully-meshed network (docs/representations.md) from a list of its numbers."""

    def __init__(self, numbers, inputs, outputs, settings):
        if settings.get("activation", "clamp") != "clamp":
            raise ValueError(
                f"this node knows the activation clamp only, not {settings['activation']}"
            )
        self.inputs, self.outputs, self.iterations = (
            inputs,
            outputs,
            settings["iterations"],
        )
        neurons = settings["hidden"] + outputs
        row = inputs + neurons + 1  # each neuron's weights, then its bias
        if len(numbers) != neurons * row:
            raise ValueError(f"{len(numbers)} numbers; expected {neurons * row}")
        self.rows = [
            [float32(number) for number in numbers[first : first + row]]
            for first in range(0, neurons * row, row)
        ]
        self.state = [0.0] * neurons

    def act(self, observation):
        """Decide: each neuron sums over inputs and neurons in their order, and adds its bias."""
        seen = [float32(number) for number in observation]
        for _ in range(self.iterations):
            sources, state = [*seen, *self.state], []
            for row in self.rows:
                total = 0.0
                for weight, source in zip(row, sources):  # noqa: B905  row also has the bias
                    total = float32(total + float32(weight * source))
                state.append(min(max(float32(row[-1] + total), 0.0), 1.0))
            self.state = state
        return self.state[len(self.state) - self.outputs :]


class Compiled:
    """The C99 controller, compiled into a library with ``src/controller.c``."""

    def __init__(self, library, inputs, outputs):
        self.library = ctypes.CDLL(library)
        self.state = ctypes.create_string_buffer(self.library.controller_size())
        self.observation, self.action = (
            (ctypes.c_float * inputs)(),
            (ctypes.c_float * outputs)(),
        )
        self.library.controller_reset(self.state)

    def act(self, observation):
        """Decide once."""
        self.observation[:] = observation
        self.library.controller_step(self.state, self.observation, self.action)
        return self.action


def load(parameters):
    """Load the controller that the node's parameters name."""
    if "library" in parameters:
        return Compiled(parameters["library"], INPUTS, OUTPUTS)
    if "candidate_file" in parameters:
        with open(parameters["candidate_file"]) as file:
            said = json.load(file)
        kind, settings = said["representation"], said["representation_settings"]
        numbers = [
            number for neuron in said["networks"][0]["neurons"] for number in neuron
        ]
    else:
        settings, numbers = parameters["candidate_network"], parameters["candidate"]
        kind = settings["kind"]
    if kind != "fully-meshed":
        raise ValueError(f"this node knows fully-meshed networks only, not {kind}")
    return FullyMeshed(numbers, INPUTS, OUTPUTS, settings)
