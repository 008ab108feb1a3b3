"""What every export says of the controller it is made of: a name for files, a hash, and steps by which a copy checks itself."""

import hashlib
import re
import unicodedata
from typing import NamedTuple

import numpy as np

from zswarm.controller import Controller
from zswarm.draws import Stream, derive_seed

STEPS = 16  # of a check
LOW, HIGH = -1.0, 2.0  # what is observed in it: sensors give 0 to 1 or -1 to 1, and some more must do no harm
LONGEST = 40  # characters of a name


class Steps(NamedTuple):
    """What a controller decides, step after step from the start of a trial.

    Attributes:
        observations: (steps, inputs) float32.
        actions: (steps, outputs) float32.
    """

    observations: np.ndarray
    actions: np.ndarray


def identifier(name: str) -> str:
    """The nearest to any name that may stand in those of files, ROS packages and C functions, behind ``zs_``.

    That is a-z, 0-9 and single _ between them; ``controller`` where nothing is left.
    """
    plain = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode().lower()
    return re.sub(r"[^a-z0-9]+", "_", plain).strip("_")[:LONGEST].strip("_") or "controller"


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
    observations = stream.uniform(LOW, HIGH, steps * controller.inputs).reshape(steps, -1).astype(np.float32)
    return Steps(observations, np.stack([driver.act(observation) for observation in observations]))
