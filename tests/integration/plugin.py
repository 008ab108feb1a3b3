"""A simulator plug-in as a user would install one, that behaves badly in its second trial when told to."""

from pathlib import Path

SOURCE = '''
import os
import time
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np

from zswarm.sims.simulator import Outcome, Simulator, Turn


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    how: Literal["fine", "raises", "hangs", "exits", "exits-once", "refuses"] = "fine"
    marker: str = ""


class Rough(Simulator):
    """Observation: the seed. Action: one number. Fitness: it. One agent, one turn."""

    settings_type = Settings
    inputs, outputs, owners = 1, 1, (0,)

    def __init__(self, settings):
        super().__init__(settings)
        if settings.how == "refuses":
            raise RuntimeError("no licence found")

    def fixed_seeds(self, trials):
        return range(trials)

    def reset(self, seed):
        if seed == 1:
            if self.settings.how == "raises":
                raise ZeroDivisionError("the gripper broke")
            if self.settings.how == "hangs":
                time.sleep(3600)
            if self.settings.how == "exits":
                os._exit(7)
            if self.settings.how == "exits-once" and not Path(self.settings.marker).exists():
                Path(self.settings.marker).touch()
                os._exit(7)
        return Turn((0,), np.full((1, 1), seed, np.float32))

    def step(self, actions):
        self.action = float(actions[0, 0])
        return None

    def outcome(self):
        return Outcome([self.action], [])
'''

EXPERIMENT = """
name = "rough"
seed = 1
generations = 3
[problem]
simulator = "rough"
trials = 3
[problem.settings]
how = "{how}"
marker = "{marker}"
[representation]
kind = "fully-meshed"
[optimizer]
kind = "nnga"
population = 10
[cluster]
trial_timeout_s = 1.0
"""


def install(folder: Path) -> str:
    """Install the plug-in into a folder; what PYTHONPATH must be to have it."""
    (folder / "zswarm_rough.py").write_text(SOURCE)
    metadata = folder / "zswarm_rough-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: zswarm-rough\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text("[zswarm.simulators]\nrough = zswarm_rough:Rough\nbroken = zswarm_nowhere:X\n")
    return str(folder)


def experiment(folder: Path, how: str) -> Path:
    file = folder / f"{how}.toml"
    file.write_text(EXPERIMENT.format(how=how, marker=folder / "marker"))
    return file
