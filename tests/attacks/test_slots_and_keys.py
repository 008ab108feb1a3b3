"""A simulator that goes wrong cannot read the key of its server."""

import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests import lab_keys
from tests.integration import programs
from tests.integration.programs import Optimizer, Server
from zswarm.security.members import new_holder
from zswarm.system import landlock

pytestmark = pytest.mark.attacks

SOURCE = """
import os
import msgspec
import numpy as np
from zswarm.sims.simulator import Outcome, Simulator, Turn

class Settings(msgspec.Struct, frozen=True):
    file: str = ""

class Thief(Simulator):
    settings_type = Settings
    inputs, outputs, owners = 1, 1, (0,)

    def reset(self, seed):
        return Turn((0,), np.ones((1, 1), np.float32))

    def step(self, actions):
        return None

    def outcome(self):
        try:
            return Outcome([float(len(open(self.settings.file).read()))], [])
        except PermissionError:
            return Outcome([-1.0], [])
"""
EXPERIMENT = """
name = "thief"
seed = 1
generations = 1
[problem]
simulator = "thief"
settings = {{ file = "{file}" }}
[representation]
kind = "fully-meshed"
[optimizer]
kind = "random"
population = 4
"""


@pytest.fixture
def home() -> Iterator[Path]:
    """Make a folder for keys that is below none in which everyone writes."""
    made = Path(tempfile.mkdtemp(prefix="zs-", dir=Path.home()))
    if landlock._is_shared(made) or not landlock.supported():
        pytest.skip("no Landlock in this kernel, or everyone may write above the home")
    yield made
    shutil.rmtree(made)


@pytest.mark.parametrize("file", ["key.pem", "free"])
def test_a_slot_reads_other_files_but_not_the_key(
    file: str, home: Path, tmp_path: Path
) -> None:
    """The server itself uses the key: it serves over TLS."""
    holders = new_holder("ss", "lab-01"), new_holder("ot", "alice")
    bundles = lab_keys.issued(home / "authority", *holders)
    server_keys = lab_keys.installed(home / "lab-01" / "keys", bundles[0])
    users_keys = lab_keys.installed(home / "alice" / "keys", bundles[1])
    (home / "free").write_text("free")
    wanted = home / "free" if file == "free" else server_keys / file
    (tmp_path / "thief.toml").write_text(EXPERIMENT.format(file=wanted))
    path = programs.install(
        tmp_path, "zswarm_thief", SOURCE, "thief = zswarm_thief:Thief"
    )
    server = Server(
        tmp_path, "lab-01", protocol="tls", PYTHONPATH=path, ZSWARM_KEYS=str(server_keys)
    )
    try:
        server.ready()
        where = ["--servers", "1", "--connect", server.endpoint, "--json"]
        run = Optimizer(
            tmp_path,
            "ot",
            ["run", "thief.toml", *where],
            PYTHONPATH=path,
            ZSWARM_KEYS=str(users_keys),
        )
        assert run.wait() == 0, run.err.read_text()
    finally:
        server.close()
    import zswarm

    read = zswarm.read(tmp_path / "runs" / "thief").table()
    assert {row["best"] for row in read} == {4.0 if file == "free" else -1.0}


def test_a_server_says_once_that_its_slots_can_read_its_keys(tmp_path: Path) -> None:
    """Here because everyone may write in /tmp; on old kernels because they have no Landlock."""
    (bundle,) = lab_keys.issued(tmp_path / "authority", new_holder("ss", "lab-01"))
    keys = str(lab_keys.installed(tmp_path / "lab" / "keys", bundle))
    server = Server(tmp_path, "lab-01", capacity=2, protocol="tls", ZSWARM_KEYS=keys)
    try:
        (line,) = server.ready().events("keys_not_hidden")
        assert "everyone may write in a folder above" in line["reason"]
    finally:
        server.close()
