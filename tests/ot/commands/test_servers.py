"""What ``zswarm-ot servers`` shows of unlike servers."""

import json

import pytest

from zswarm.ot.cluster.discovery import Found, Survey
from zswarm.ot.cluster.matching import Choice
from zswarm.ot.commands import servers
from zswarm.protocol import labels
from zswarm.protocol.messages import Offer


def found(
    name: str,
    *limits: str,
    simulators: str = "arena",
    mismatch: str = "",
    **labels_of_server: str,
) -> Found:
    offer = Offer(
        server=f"{name}-00000000",
        program="0.1.0",
        machine="Linux x86_64",
        capacity=2,
        free=2,
        leases=0,
        simulators=[simulators],
        representations=["fully-meshed"],
        mismatch=mismatch,
        labels={"name": name} | labels_of_server,
        limits=list(limits),
    )
    return Found(offer.server, offer, "", "tcp/127.0.0.1:7467")


LAB = Survey(
    [
        found("a", "arena.robots 100 at most", cores="4"),
        found("b", cores="16", gpu="yes"),
        found("c", cores="64"),
        found("d", cores="4", mismatch="draining"),
        Found("e-00000000", None, "does not answer"),
    ],
    {},
    [],
)
FAST = Choice(
    labels.requirements(["cores>=8"], ""), labels.preferences(["gpu=yes", "cores"], "")
)


def shown(
    capsys: pytest.CaptureFixture[str],
    choice: Choice,
    name: str,
    *,
    as_json: bool = False,
) -> str:
    survey = servers.ranked(LAB, choice) if name else LAB
    servers.show(survey, "default", choice, name, as_json=as_json)
    return capsys.readouterr().out


def test_labels_and_limits_are_shown_with_their_servers(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Servers with the same labels or limits share a line."""
    lines = shown(capsys, Choice(), "").splitlines()
    assert "simulators: arena" in lines
    assert "labels on a-00000000, d-00000000: cores=4" in lines
    assert "labels on b-00000000: cores=16, gpu=yes" in lines
    assert "limits on a-00000000: arena.robots 100 at most" in lines
    assert not [line for line in lines if line.startswith("limits") and "b-0" in line]


def test_matching_servers_come_first_in_the_order_of_the_rank(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each other server is listed with the reason why it is not used."""
    monkeypatch.setenv("COLUMNS", "200")
    text = shown(capsys, FAST, "my.toml")
    assert [line[0] for line in text.splitlines() if "-00000000  " in line] == [
        "b",
        "c",
        "a",
        "d",
        "e",
    ]
    assert (
        "not used for my.toml: a-00000000: the experiment requires cores>=8 (it has cores=4)"
        in text
    )
    assert "not used for my.toml: d-00000000: draining" in text
    assert "not used for my.toml: e-00000000: does not answer" in text
    objects = [
        json.loads(line)
        for line in shown(capsys, FAST, "my.toml", as_json=True).splitlines()
    ]
    assert [line["server"][0] for line in objects] == ["b", "c", "a", "d", "e"]
    assert objects[2]["mismatch"] == "the experiment requires cores>=8 (it has cores=4)"
    assert objects[0]["labels"] == {"name": "b", "cores": "16", "gpu": "yes"}
