"""A server's side of the network, without one: what it takes, refuses and drops."""

import time
from typing import Any

import msgspec
import pytest

from zswarm.protocol import codec, keys
from zswarm.protocol.messages import Refused, Renew
from zswarm.ss import network
from zswarm.ss.network import Inbox, PeerQuery, Presence
from zswarm.ss.slots import events


class Payload(bytes):
    """What a query carries."""

    def to_bytes(self) -> bytes:  # type: ignore[override]
        return bytes(self)


class Query:
    """A query of zenoh's that notes how it ends."""

    def __init__(self, body: bytes, verb: str = "renew") -> None:
        self.key_expr = f"zswarm/v1/default/ss/lab-1/ot/ada/run-1/{verb}"
        self.payload = Payload(body)
        self.replies: list[bytes] = []
        self.dropped = False

    def reply(self, key: str, body: bytes) -> None:
        assert key == self.key_expr
        self.replies.append(body)

    def drop(self) -> None:
        self.dropped = True

    def ended(self) -> bool:
        end = time.monotonic() + 60.0
        while not self.dropped and time.monotonic() < end:
            time.sleep(0.005)
        return self.dropped


def presence() -> Presence:
    return Presence("default", "lab-1", Inbox(), private=True)


def queries(server: Presence) -> list[PeerQuery]:
    return [item for item in server.inbox.take() if isinstance(item, PeerQuery)]


def test_queries_beyond_the_bytes_that_may_wait_are_dropped(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(network, "MAX_INBOX_BYTES", 100)
    server = presence()
    sent: list[Any] = [Query(bytes(40)) for _ in range(3)]
    for query in sent:
        server._on_query(query)
    assert [query.dropped for query in sent] == [False, False, True]
    for waiting in queries(server):
        assert server.decode(waiting) is None  # zeros are not a message
    more: Any = Query(bytes(100))
    server._on_query(more)
    assert not more.dropped
    server.finish(60.0)


def of(user: str, size: int = 10) -> Any:
    query = Query(bytes(size))
    query.key_expr = f"zswarm/v1/default/ss/lab-1/ot/{user}/run-1/evaluate"
    return query


def test_a_user_who_sends_much_leaves_room_for_others(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(network, "SHARE_BYTES", 100)
    monkeypatch.setattr(network, "SHARE", 3)
    server = presence()
    large, small = [of("mallory", 60) for _ in range(2)], [of("eve") for _ in range(4)]
    honest = of("ada", 60)
    for query in [*large, *small, honest]:
        server._on_query(query)
    assert [query.dropped for query in large] == [False, True]
    assert [query.dropped for query in small] == [False, False, False, True]
    assert not honest.dropped
    order = [query.key.split("/")[6] for query in queries(server)]
    assert order == ["mallory", "eve", "ada", "eve", "eve"], "users take turns"
    again = of("mallory", 100)
    server._on_query(again)
    assert not again.dropped, "what was taken does not count any more"


def test_a_request_too_large_for_its_verb_is_answered_with_the_reason(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    server = presence()
    large: Any = Query(bytes(1 << 20))
    server._on_query(large)
    (waiting,) = queries(server)
    monkeypatch.setattr(PeerQuery, "body", None)  # it is not even copied
    assert server.decode(waiting) is None
    assert large.ended()
    refused = codec.decode_reply(large.replies[0])
    assert isinstance(refused, Refused)
    assert refused.code == "malformed"
    assert refused.reason.startswith("a request to renew has 1,048,576 bytes")
    server.finish(60.0)


def test_tokens_of_runs_take_the_share_of_their_user(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(network, "SHARE", 2)
    inbox = Inbox()
    gone = events.HolderAlive("eve", "run", alive=False)
    assert [inbox.put_of("eve", gone) for _ in range(3)] == [True, True, False]
    inbox.put(15)
    assert list(inbox.take()) == [15, gone, gone], "signals come first"
    assert not inbox


def test_a_request_of_a_later_program_is_refused_as_unsupported() -> None:
    server = presence()
    body = msgspec.msgpack.encode({"type": "migrate", "lease": bytes(16)})
    asked: Any = Query(body, "migrate")
    server._on_query(asked)
    (query,) = queries(server)
    assert server.decode(query) is None
    assert asked.ended()
    refused = codec.decode_reply(asked.replies[0])
    assert isinstance(refused, Refused)
    assert (refused.code, "'migrate'" in refused.reason) == ("unsupported", True)
    server.finish(60.0)


def test_an_answer_that_cannot_be_sent_is_logged_and_the_next_one_is_sent(
    capsys: pytest.CaptureFixture[str],
) -> None:
    server = presence()
    sent: list[Any] = [Query(codec.encode(Renew(lease=bytes(16)))) for _ in range(2)]
    sent[0].reply = None  # to call it raises
    for query in sent:
        server._on_query(query)
    for waiting in queries(server):
        assert (event := server.decode(waiting)) is not None
        assert (event.user, event.run) == ("ada", "run-1")
        server.answer(waiting, b"answer")
    assert sent[1].ended()
    assert sent[0].dropped
    assert sent[1].replies == [b"answer"]
    server.finish(60.0)
    assert "sending_failed" in capsys.readouterr().err


def test_the_keys_of_a_version_differ_in_the_version_alone() -> None:
    for build in (keys.offer, keys.requests, keys.alive):
        assert build("r", "s", "v7") == build("r", "s").replace("/v1/", "/v7/")
