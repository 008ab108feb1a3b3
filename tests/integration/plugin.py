"""An installed simulator plug-in that misbehaves in its second trial on demand."""

from pathlib import Path

from tests.integration import programs

SOURCE = '''
import ctypes
import os
import time
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np

from zswarm.sims.simulator import Outcome, Simulator, Turn


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    how: Literal[
        "fine", "raises", "hangs", "exits", "exits-once", "segfault", "segfault-once", "leaks",
        "hoards", "refuses", "too-large",
        "slow",
    ] = "fine"
    marker: str = ""


left_behind = []


class Rough(Simulator):
    """Observation: the seed. Action: one number. Fitness: it. One agent, one turn."""

    settings_type = Settings
    inputs, outputs, owners = 1, 1, (0,)

    def __init__(self, settings):
        super().__init__(settings)
        if settings.how == "refuses":
            raise RuntimeError("no licence found")
        if settings.how == "too-large":
            self.map = bytearray(600 << 20)

    def fixed_seeds(self, trials):
        return range(trials)

    def reset(self, seed):
        # A broken machine: ROUGH_WRONG concerns a run's trials, or the probe, with large seeds.
        self.wrong = os.environ.get("ROUGH_WRONG") == ("trials" if seed < 1000 else "probe")
        if self.settings.how == "slow":
            time.sleep(0.02)
        if self.settings.how == "leaks":
            left_behind.append(bytearray(20 << 20))
        if seed == 1:
            if self.settings.how == "raises":
                raise ZeroDivisionError("the gripper broke")
            if self.settings.how == "hangs":
                time.sleep(3600)
            if self.settings.how == "exits":
                os._exit(7)
            if self.settings.how == "segfault":
                ctypes.string_at(0)
            if self.settings.how == "hoards":
                bytearray(600 << 20)
            if self.settings.how.endswith("-once") and not Path(self.settings.marker).exists():
                Path(self.settings.marker).touch()
                if self.settings.how == "segfault-once":
                    ctypes.string_at(0)
                os._exit(7)
        return Turn((0,), np.full((1, 1), seed, np.float32))

    def step(self, actions):
        self.action = float(actions[0, 0])
        return None

    def outcome(self):
        return Outcome([self.action + self.wrong], [])
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
trial_memory_mb = 512
"""


def install(folder: Path) -> str:
    """Install the plug-in into a folder and return the PYTHONPATH to use."""
    return programs.install(
        folder,
        "zswarm_rough",
        SOURCE,
        "rough = zswarm_rough:Rough\nbroken = zswarm_nowhere:X",
    )


def experiment(folder: Path, how: str) -> Path:
    file = folder / f"{how}.toml"
    file.write_text(EXPERIMENT.format(how=how, marker=folder / "marker"))
    return file
