"""What every export says of the controller it is made of: a hash, and steps by which a copy checks itself."""

import hashlib
from typing import NamedTuple

import numpy as np

from zswarm.controller import Controller
from zswarm.draws import Stream, derive_seed

STEPS = 16  # of a check
REACH = 2.0  # of what is observed in it: sensors give 0 to 1 or -1 to 1, and some more must do no harm


class Steps(NamedTuple):
    """What a controller decides, step after step from the start of a trial.

    Attributes:
        observations: (steps, inputs) float32.
        actions: (steps, outputs) float32.
    """

    observations: np.ndarray
    actions: np.ndarray


def sha256(parameters: np.ndarray) -> str:
    """The hash of what a network's ``step`` reads, 64 hex digits: of its float32 numbers, little-endian.

    Args:
        parameters: (P,) float32.
    """
    return hashlib.sha256(parameters.astype("<f4").tobytes()).hexdigest()


def check_steps(controller: Controller, steps: int = STEPS) -> Steps:
    """Steps by which a copy is compared with the controller, bit for bit; the same controller has the same.

    Raises:
        ConfigError: as ``Controller.network``.
    """
    driver = controller.driver()
    stream = Stream(derive_seed(0, "check steps", controller.inputs, controller.outputs))
    observations = stream.uniform(-REACH, REACH, steps * controller.inputs).reshape(steps, -1).astype(np.float32)
    observations[0] = 0.0
    observations[1::3] = np.abs(observations[1::3])  # what most sensors give
    return Steps(observations, np.stack([driver.act(observation) for observation in observations]))
