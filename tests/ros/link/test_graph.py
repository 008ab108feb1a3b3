"""Where programs meet in ROS."""

import socket

import pytest

from zswarm.ros.link.graph import RosGraph


def master(uri: str) -> str:
    return RosGraph(link="rospy", master=uri).identity().master


def test_one_master_has_one_identity_however_it_is_spelled(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("ROS_MASTER_URI", "http://localhost:11411/")
    names = (
        "",
        "http://127.0.0.1:11411",
        "http://localhost:11411",
        "http://LOCALHOST:11411",
    )
    assert {master(uri) for uri in names} == {"http://127.0.0.1:11411"}


def test_an_address_of_this_machine_is_loopback(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(socket, "gethostbyname", lambda _: "127.0.1.1")
    assert master("http://lab7:11311") == "http://127.0.0.1:11311"


def test_two_masters_have_two_identities(monkeypatch: pytest.MonkeyPatch) -> None:
    found = set()
    for port in (11311, 11411):
        monkeypatch.setenv("ROS_MASTER_URI", f"http://127.0.0.1:{port}")
        found.add(master(""))
    monkeypatch.delenv("ROS_MASTER_URI")
    assert found == {master(""), "http://127.0.0.1:11411"}


def test_a_master_of_another_machine_keeps_its_address(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(socket, "gethostbyname", lambda _: "192.0.2.7")  # of documents
    assert master("http://lab7:11311") == "http://192.0.2.7:11311"


def test_the_name_of_an_unknown_host_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    def unknown(name: str) -> str:
        raise socket.gaierror(f"{name} is not known")

    monkeypatch.setattr(socket, "gethostbyname", unknown)
    assert master("http://lab7:11311") == "http://lab7:11311"
