"""With the rule in deploy/nftables, connections of strangers do not keep members out."""

import os
import shutil
import socket
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests import lab_keys
from tests.integration.lab import Host, Lab
from tests.integration.programs import Program, Server
from tests.repository import REPOSITORY
from zswarm import session
from zswarm.security import keyring

pytestmark = pytest.mark.attacks

RULE = REPOSITORY / "deploy" / "nftables" / "zswarm.nft"
PORT = 7467
FLOOD_S = 5.0  # before the member connects
PAUSE_S = 4.0  # between attempts to dial; they were 2 s apart
LONGEST_S = 90.0
UNKNOWN_CA = bytes.fromhex("15 0303 0002 02 30")  # a fatal alert of TLS
CONNECTED_S = 15.0  # generous: on an idle machine it takes less than two


class Site:
    """A server, a member and an attacker, each on its own host of one network."""

    def __init__(self, lab: Lab, folder: Path) -> None:
        network = lab.network()
        self.folder = folder
        self.server, self.member, self.attacker = (lab.host(network) for _ in range(3))
        holders = [lab_keys.of("ss", "lab-01"), lab_keys.of("ot", "alice")]
        contents = lab_keys.issued(folder / "authority", *holders)
        self.keys = [
            str(lab_keys.unpacked(folder / holder.name, content))
            for holder, content in zip(holders, contents, strict=True)
        ]
        self.programs: list[Program] = []

    def serve(self) -> None:
        server = Server(
            self.folder,
            "lab-01",
            capacity=1,
            port=PORT,
            address=self.server.address,
            protocol="tls",
            inside=self.server.inside,
            ZSWARM_KEYS=self.keys[0],
            ZSWARM_PLAIN="1",
        )
        self.programs.append(server)
        server.ready()

    def dial(self, host: Host, how: str, *more: str) -> Program:
        command = ["-m", "tests.attacks.dial", how, self.server.address, str(PORT), *more]
        path = os.pathsep.join([str(REPOSITORY), os.environ.get("PYTHONPATH", "")])
        environment = {"ZSWARM_KEYS": self.keys[1], "PYTHONPATH": path}
        name = f"{how}-{len(self.programs)}"
        program = Program(self.folder, name, command, host.inside, **environment)
        self.programs.append(program)
        return program

    def connect_s(self) -> float:
        """Return the seconds until a member sees the server; infinity: it does not."""
        dialling = self.dial(self.member, "member")
        assert dialling.wait() == 0, dialling.err.read_text()
        return float(dialling.out.read_text() or "inf")


@pytest.fixture
def site(tmp_path: Path) -> Iterator[Site]:
    if shutil.which("nft") is None:
        pytest.skip("needs the program nft (Debian: apt install nftables)")
    with Lab() as lab:
        made = Site(lab, tmp_path)
        try:
            yield made
        finally:
            for program in made.programs:
                program.close()


@pytest.mark.parametrize("flood", [("garbage", "200"), ("half", "900")])
def test_members_connect_during_a_flood_of_connections(
    site: Site, flood: tuple[str, str]
) -> None:
    """Without the rule, they do not for as long as it lasts, or a minute."""
    if "WITHOUT_RULE" not in os.environ:  # to see what it is for
        site.server.run("nft", "-f", str(RULE))
    site.serve()
    attacker = site.dial(site.attacker, *flood)
    time.sleep(FLOOD_S)
    connected_s = site.connect_s()
    print(f"{' '.join(flood)}: a member connected within {connected_s:.2f} s")
    assert attacker.process.poll() is None, attacker.err.read_text()
    assert connected_s < CONNECTED_S


def test_the_rule_limits_one_source_and_not_the_others(site: Site) -> None:
    """Ten at once and five a second: as many as a workstation's runs need."""
    site.server.run("nft", "-f", str(RULE))
    site.server.run("nft", "-f", str(RULE))  # again, as after a change
    site.serve()
    site.dial(site.attacker, "garbage", "100")
    time.sleep(1.0)
    seen = site.server.run("nft", "list", "set", "inet", "zswarm", "sources")
    assert site.attacker.address in seen
    assert site.connect_s() < CONNECTED_S


def test_an_optimizer_whose_keys_are_refused_dials_less_and_less(tmp_path: Path) -> None:
    """A dozen of them would be a flood."""
    (content,) = lab_keys.issued(tmp_path / "authority", lab_keys.of("ot", "alice"))
    lab_keys.unpacked(tmp_path / "alice", content)
    ring = keyring.load(tmp_path / "alice", "ot")
    with socket.create_server(("127.0.0.1", 0)) as listening:
        listening.settimeout(LONGEST_S)
        at = f"tls/127.0.0.1:{listening.getsockname()[1]}"
        opened = session.open_optimizer(session.Reach([at], False, keyring=ring))
        begun = dialled = time.monotonic()
        try:
            while time.monotonic() - dialled < PAUSE_S:
                dialled = time.monotonic()
                assert dialled - begun < LONGEST_S, "it keeps dialling"
                with listening.accept()[0] as link:
                    link.recv(2000)
                    link.sendall(UNKNOWN_CA)
        finally:
            session.close(opened)
