"""A server that cannot prepare a problem now is used when it can."""

from pathlib import Path

import pytest

from tests.integration import programs
from tests.integration.programs import Optimizer, Server, query, wait_until

pytestmark = pytest.mark.faults

SOURCE = """
import errno
import os
import msgspec
import numpy as np
from zswarm.sims.simulator import Outcome, Simulator, Turn

class Settings(msgspec.Struct, frozen=True):
    pass

class Hoarder(Simulator):
    settings_type = Settings
    inputs, outputs, owners = 1, 1, (0,)

    def __init__(self, settings):
        super().__init__(settings)
        if os.path.exists(os.environ.get("FULL", "")):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def reset(self, seed):
        return Turn((0,), np.ones((1, 1), np.float32))

    def step(self, actions):
        return None

    def outcome(self):
        return Outcome([1.0], [])
"""
EXPERIMENT = """
name = "hoarder"
seed = 1
generations = 2
[problem]
simulator = "hoarder"
[representation]
kind = "fully-meshed"
[optimizer]
kind = "random"
population = 4
"""


def test_a_server_whose_disk_is_full_when_it_prepares_is_used_when_it_has_room(
    tmp_path: Path,
) -> None:
    (tmp_path / "hoarder.toml").write_text(EXPERIMENT)
    full = tmp_path / "full"
    full.touch()
    path = programs.install(
        tmp_path, "zswarm_hoarder", SOURCE, "hoarder = zswarm_hoarder:Hoarder"
    )
    server = Server(tmp_path, "ss", PYTHONPATH=path, FULL=str(full)).ready()
    reach = ["--servers", "1", "--no-multicast", f"--connect={server.endpoint}"]
    optimizer = Optimizer(
        tmp_path, "ot", ["run", "hoarder.toml", "--json", *reach], PYTHONPATH=path
    )
    words = "cannot prepare the problem: simulator 'hoarder' cannot be set up: OSError: "
    try:
        wait_until(lambda: words in optimizer.err.read_text(), "it is reported")
        full.unlink()
        assert optimizer.done()["generations"] == 2
    finally:
        optimizer.close()
        server.close()
    events = "SELECT text, count FROM events WHERE event = 'server_unprepared'"
    text, seconds = query(tmp_path / "runs" / "hoarder", events)[0]
    assert "No space left on device" in str(text)
    assert seconds == 5
