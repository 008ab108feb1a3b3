"""Nothing on the wire, and nothing in another's folder, moves a robot or dials an address."""

import secrets
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest
import tomli_w
import zenoh

from tests.integration.programs import Server, wait_until
from tests.robots.packed import evolved
from zswarm import evaluate, session
from zswarm.errors import EvaluationError
from zswarm.ot.replay import trace
from zswarm.ot.report.champion import sections
from zswarm.plugins.version_hash import version_hash
from zswarm.protocol import codec, keys, messages

pytestmark = pytest.mark.attacks

NAME = "turtlebot-exit-ros"
SETTINGS = {"robots": 1, "steps": 20, "map": "open"}
LONGEST_S = 120.0
DECIDED = ("ready", "failed")


@pytest.fixture
def robot() -> Iterator[socket.socket]:
    """Listen where somebody else's robot would be dialled."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        listening.setblocking(False)
        yield listening


def dialled(robot: socket.socket) -> bool:
    try:
        robot.accept()[0].close()
    except BlockingIOError:
        return False
    return True


def file(folder: Path, robot: socket.socket) -> dict[str, str]:
    """Write a machine's file that names the robot; return the environment for it."""
    endpoint = f"tcp/127.0.0.1:{robot.getsockname()[1]}"
    where = {"link": "zenoh", "profile": "stage_ros2", "connect": [endpoint]}
    (folder / "ros").mkdir()
    (folder / "ros" / "stage.toml").write_text(tomli_w.dumps(where))
    return {"ZSWARM_ROS": str(folder / "ros")}


def asked(
    server: Server, settings: dict[str, Any], enough: Callable[[], bool] = lambda: False
) -> messages.Lease | messages.Refused:
    """Ask a server for a lease as a stranger, until it is prepared, or ``enough``."""
    opened = session.open_optimizer(session.Reach([server.endpoint], multicast=False))
    name, run = str(server.events("server_ready")[0]["server"]), secrets.token_hex(4)

    def answer(verb: str, message: messages.Message) -> Any:
        key = keys.request("default", name, "mallory", run, verb)

        def answers() -> list[bytes]:
            got = opened.get(
                key,
                payload=codec.encode(message),
                target=zenoh.QueryTarget.ALL,
                timeout=20.0,
            )
            return [reply.ok.payload.to_bytes() for reply in got if reply.ok is not None]

        return codec.decode_reply(wait_until(answers, f"{server.endpoint} answers")[0])

    part = messages.Part
    reserve = messages.Reserve(
        nonce=secrets.token_bytes(16),
        epoch=0,
        slots=1,
        simulator=part(NAME, settings),
        representation=part("fully-meshed", {}),
        version_hash=version_hash(NAME, "fully-meshed"),
        trial_timeout_s=60.0,
    )
    try:
        lease = answer("reserve", reserve)
        while isinstance(lease, messages.Lease) and lease.state not in DECIDED:
            if enough():
                break
            lease = answer("renew", messages.Renew(lease=lease.lease, known_ready=-1))
        assert isinstance(lease, messages.Lease | messages.Refused)
        return lease
    finally:
        session.close(opened)


def test_a_reserve_cannot_say_whom_to_dial_or_what_to_read(
    robot: socket.socket, tmp_path: Path
) -> None:
    """The settings of the attack, those that are left, and names that look like paths.

    The server's file for a robot is there: it alone says where one is.
    """
    (tmp_path / "mine.toml").write_text('password = "x"')
    server = Server(tmp_path, "lab-01", capacity=1, **file(tmp_path, robot))
    address = f"127.0.0.1:{robot.getsockname()[1]}"
    attacks: list[dict[str, Any]] = [
        {"launch": "running", "connect": [f"tcp/{address}"]},
        {"launch": "running", "link": "rospy", "master": f"http://{address}"},
        {"connect": [f"tcp/{address}"]},
        {"profile": str(tmp_path / "mine.toml")},
        {"simulation": str(tmp_path / "ros" / "stage")},
        {"simulation": f"tcp/{address}"},
        {"simulation": "arena"},
    ]
    try:
        server.ready()
        for settings in attacks:
            answer = asked(server, SETTINGS | settings)
            assert not (isinstance(answer, messages.Lease) and answer.state == "ready")
            assert "password" not in answer.reason, settings
            assert str(tmp_path / "ros") not in answer.reason.replace(
                str(settings.get("simulation")), ""
            )
            assert not dialled(robot), settings
        # What the administrator's file allows is dialled: the listener above can tell.
        asked(server, SETTINGS | {"simulation": "stage"}, lambda: dialled(robot))
    finally:
        server.close()


def test_reading_a_champion_of_somebody_else_dials_nothing(
    robot: socket.socket, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As ``evaluate``, ``report``, ``replay`` and the dashboard do, though a file names a robot."""
    for name, value in file(tmp_path, robot).items():
        monkeypatch.setenv(name, value)
    plain = evolved(robots=1, steps=20, map="open")
    champion = msgspec.structs.replace(
        plain,
        simulator=NAME,
        simulator_settings=plain.simulator_settings | {"simulation": "stage"},
    )
    (tmp_path / "champion.zsc").write_bytes(msgspec.msgpack.encode(champion))
    command = [sys.executable, "-m", "zswarm.ot", "evaluate", "champion.zsc"]
    done = subprocess.run(
        [*command, "--trials", "1"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=LONGEST_S,
        check=False,
    )
    assert done.returncode != 0
    assert "driven by slots of servers only" in " ".join(done.stderr.split())
    assert "played" not in sections(champion, 1)
    simulator, network = evaluate.build(
        champion.simulator,
        champion.simulator_settings,
        champion.representation,
        champion.representation_settings,
    )
    with pytest.raises(EvaluationError, match="driven by slots of servers only"):
        trace.record(simulator, network, [champion.genome], 1)
    assert not dialled(robot)
