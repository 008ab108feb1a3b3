"""The kernel of finite-state machines.

A decision turns each input into its class, the classes into a row of the table, and reads outputs
and next state there: docs/representations.md.
"""

import numpy as np

from zswarm.kernels.jit import STEP_SIGNATURE, kernel
from zswarm.kernels.portable import to_int

# A row of parameters: states, first state, output units, whether rows are products, scale, where
# the table begins; then the inputs; then the table: next states, then outputs.
HEADER = 6
PER_INPUT = 4  # thresholds, minimum, maximum, units; then the thresholds


@kernel(STEP_SIGNATURE)
def step(parameters, state, observation, output):  # type: ignore[no-untyped-def]  # compiled
    """Make one decision; ``state`` is the machine's state plus 1, or 0 at the start."""
    states, units, product = int(parameters[0]), parameters[2], int(parameters[3])
    current = int(parameters[1]) if state[0] == 0 else int(state[0]) - 1
    table = int(parameters[5])
    row, combinations = product, 1
    at = HEADER
    for index in range(observation.shape[0]):
        value = to_int(np.float64(observation[index] * parameters[4]))
        thresholds = int(parameters[at])
        if thresholds > 0:
            classes, place = thresholds + 1, 0
            while place < thresholds and value >= parameters[at + PER_INPUT + place]:
                place += 1
        else:
            least, most = int(parameters[at + 1]), int(parameters[at + 2])
            value = min(max(value, least), most)
            classes = int(parameters[at + 3]) + 1
            # As in FREVO, in float32: (value - least) units / (most - least), cut.
            place = int(
                np.float32((value - least) * (classes - 1)) / np.float32(most - least)
            )
        row = row * (place + 1) if product else row * classes + place
        combinations *= classes
        at += PER_INPUT + thresholds
    entry = (row - product) * states + current
    state[0] = np.float32(parameters[table + entry] + np.float32(1))
    outputs = table + combinations * states + entry * output.shape[0]
    for index in range(output.shape[0]):
        output[index] = parameters[outputs + index] / units
