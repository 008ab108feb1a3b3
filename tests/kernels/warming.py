"""Warm parts up in a program of its own, and count what a trial compiles afterwards."""

import os
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import zswarm

WARM_UP = """
import sys
import numpy as np
from numba.core import event
from zswarm.plugins import registry as plugins
plugins.BUNDLED["simulator"]["lazy"] = "lazy:Lazy"
from zswarm import evaluate
from zswarm.kernels.random import Stream

simulators = sys.argv[1].split(",")
representations = sys.argv[2:] or plugins.names("representation")
parts = [(simulator, network) for simulator in simulators for network in representations]
for simulator, representation in parts:
    with event.install_recorder("numba:compile") as before:
        built, network = evaluate.build(simulator, {}, representation, {})
        evaluate.warm_up(built, network)
    with event.install_recorder("numba:compile") as after:
        genomes = network.random(built.participants, Stream(1))
        participants = np.arange(built.participants).reshape(1, -1)
        evaluate.evaluate(built, network, genomes, participants, np.array([9], np.uint64))
    print(simulator, representation, len(before.buffer) > 0, len(after.buffer))
"""
LAZY = """
import msgspec, numba
import numpy as np
from zswarm.sims.simulator import Outcome, Simulator, Turn

class Settings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    pass

@numba.njit
def double(x):
    return 2.0 * x

class Lazy(Simulator):
    settings_type = Settings
    inputs, outputs, owners = 1, 1, (0,)

    def reset(self, seed):
        return Turn([0], np.ones((1, 1), np.float32))

    def step(self, actions):
        self.fitness = double(float(actions[0, 0]))

    def outcome(self):
        return Outcome([self.fitness], [])
"""


class Warmed(NamedTuple):
    """What warming up two parts did.

    Attributes:
        compiled: whether something was compiled.
        later: how many functions a trial compiled afterwards.
    """

    simulator: str
    representation: str
    compiled: bool
    later: int


def warmed_up(
    simulators: list[str],
    folder: Path,
    cache: Path,
    *representations: str,
    **environment: str,
) -> list[Warmed]:
    """Warm simulators up, each with every representation.

    Args:
        simulators: ``lazy`` is one that has numba compile when it is called.
        folder: for the module of ``lazy``.
        cache: of compiled kernels.
        representations: these only.
    """
    (folder / "lazy.py").write_text(LAZY)
    done = subprocess.run(
        [sys.executable, "-c", WARM_UP, ",".join(simulators), *representations],
        cwd=folder,
        env={
            **os.environ,
            "PYTHONPATH": os.pathsep.join(
                [str(folder), str(Path(zswarm.__file__).parent.parent)]
            ),
            "ZSWARM_CACHE": str(cache),
            "ZSWARM_PLAIN": "",
            **environment,
        },
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    rows = map(str.split, done.stdout.splitlines())
    return [Warmed(row[0], row[1], row[2] == "True", int(row[3])) for row in rows]
