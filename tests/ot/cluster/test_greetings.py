"""What answers to multicast is a stranger: which of its endpoints are dialled."""

import json
import socket
from pathlib import Path

import pytest
import zenoh

from zswarm import session
from zswarm.ot.cluster import diagnosis
from zswarm.session import Reach
from zswarm.system import scouting


@pytest.fixture
def greeting(monkeypatch: pytest.MonkeyPatch) -> dict[str, list[str]]:
    """Return what strangers answer, by their ids, in place of a multicast group."""
    answers: dict[str, list[str]] = {}

    class Hello:
        def __init__(self, zid: str) -> None:
            self.zid, self.locators = zid, answers[zid]

    class Scout:
        def __init__(self) -> None:
            self._rest = list(answers)

        def try_recv(self) -> Hello | None:
            return Hello(self._rest.pop()) if self._rest else None

        def stop(self) -> None:
            pass

    monkeypatch.setattr(zenoh, "scout", lambda **_: Scout())
    monkeypatch.setattr(scouting, "fault", lambda: "")
    monkeypatch.setattr(diagnosis, "SCOUT_S", 0.0)
    return answers


def test_only_tcp_of_a_greeting_is_dialled(
    greeting: dict[str, list[str]], tmp_path: Path
) -> None:
    """Neither sockets of this machine, nor what is no endpoint, which ended the diagnosis."""
    path = tmp_path / "x.sock"
    with socket.socket(socket.AF_UNIX) as there, socket.socket() as free:
        there.bind(str(path))
        there.listen()
        there.setblocking(False)
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
        greeting["1"] = [f"unixsock-stream/{path}", "serial//dev/ttyUSB0#baudrate=9600"]
        greeting["2"] = ["nonsense", f"udp/127.0.0.1:{port}", f"tcp/127.0.0.1:{port}"]
        found = diagnosis.diagnose("default", [], Reach())
        with pytest.raises(BlockingIOError):
            there.accept()
    assert [line.split(": ")[0] for line in found] == [f"tcp/127.0.0.1:{port}"]


def test_with_keys_only_tls_of_a_greeting_is_dialled(
    greeting: dict[str, list[str]],
) -> None:
    greeting["1"] = ["tcp/127.0.0.1:1", "tls/127.0.0.1:1"]
    assert diagnosis._scout("tls", routers=False) == [["tls/127.0.0.1:1"]]


def test_thousands_of_greetings_are_not_all_dialled(
    greeting: dict[str, list[str]],
) -> None:
    greeting.update({str(zid): ["tcp/127.0.0.1:1"] for zid in range(5000)})
    assert len(diagnosis._scout("tcp", routers=False)) == diagnosis.ANSWERS


def test_a_session_dials_no_socket_that_a_peer_names(tmp_path: Path) -> None:
    """Gossip, or an answer to multicast, names one: zenoh refuses the protocol."""
    path = tmp_path / "x.sock"
    with socket.socket(socket.AF_UNIX) as there:
        there.bind(str(path))
        there.listen()
        reach = Reach(["tcp/127.0.0.1:1"], multicast=False)
        config = session._config("peer", [], reach, dial=True, timeout_ms=-1)
        assert config["transport"]["link"]["protocols"] == ["tcp"]
        config["connect"]["endpoints"]["peer"] = [f"unixsock-stream/{path}"]
        config["connect"]["timeout_ms"]["peer"] = 0
        config["connect"]["exit_on_failure"]["peer"] = True
        with pytest.raises(zenoh.ZError):
            zenoh.open(zenoh.Config.from_json5(json.dumps(config)))
        there.setblocking(False)
        with pytest.raises(BlockingIOError):
            there.accept()
