"""What every export stores of its controller: a hash, and steps by which a copy checks itself."""

import hashlib
from typing import NamedTuple

import numpy as np

from zswarm.champion.controller import Controller
from zswarm.kernels.random import Stream, derive_seed

STEPS = 16
# Most sensors give 0 to 1 or -1 to 1; observations in the check reach further.
REACH = 2.0


class Steps(NamedTuple):
    """The decisions of a controller, step after step from the start of a trial.

    Attributes:
        observations: (steps, inputs) float32.
        actions: (steps, outputs) float32.
    """

    observations: np.ndarray
    actions: np.ndarray


def sha256(parameters: np.ndarray) -> str:
    """Return the hash of a network's parameters as little-endian float32, 64 hex digits."""
    return hashlib.sha256(parameters.astype("<f4").tobytes()).hexdigest()


def check_steps(controller: Controller, steps: int = STEPS) -> Steps:
    """Return steps by which a copy is compared, bit for bit; always the same for one controller."""
    driver = controller.driver()
    stream = Stream(derive_seed(0, "check steps", controller.inputs, controller.outputs))
    numbers = stream.uniform(-REACH, REACH, steps * controller.inputs)
    observations = numbers.reshape(steps, -1).astype(np.float32)
    observations[0] = 0.0
    observations[1::3] = np.abs(observations[1::3])  # what most sensors give
    return Steps(
        observations, np.stack([driver.act(observation) for observation in observations])
    )
