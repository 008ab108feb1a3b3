"""The experiment of tests that need a run to last, and nothing to be computed: its trials sleep."""

from pathlib import Path

from tests.integration import programs
from tests.integration.evacuation import EXPERIMENT

SOURCE = """
import time

import msgspec
import numpy as np

from zswarm.sims.simulator import Outcome, Simulator, Turn


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    pass


class Asleep(Simulator):
    settings_type = Settings
    inputs, outputs, owners = 2, 1, (0,)

    def reset(self, seed):
        self.wanted = seed % 5 / 5
        return Turn((0,), np.array([[seed % 7 / 7, seed % 3 / 3]], np.float32))

    def step(self, actions):
        time.sleep(0.003)
        self.action = float(actions[0, 0])
        return None

    def outcome(self):
        return Outcome([-abs(self.action - self.wanted)], [])
"""
# A run of some seconds, which is long enough to disturb it.
HISTORY = "a4c242424ea75f7345b5c0c050dc2514"


def write(folder: Path, name: str, more: str = "") -> str:
    """Write the experiment into a folder."""
    file = folder / "experiment.toml"
    parts = {"simulator": "asleep", "settings": ""}
    file.write_text(EXPERIMENT.format(name=name, **parts) + more)
    return str(file)


def installed(folder: Path) -> dict[str, str]:
    """Write the simulator into a folder; return the environment of programs that play it.

    Nothing is compiled, and so numba is not loaded.
    """
    path = programs.install(
        folder, "zswarm_asleep", SOURCE, "asleep = zswarm_asleep:Asleep"
    )
    return {"PYTHONPATH": path, "ZSWARM_PLAIN": "1"}
