"""Messages come through whole, and any bytes end in a message or in ``RemoteProtocolError``."""

import json
import os
import struct
import unicodedata
from collections.abc import Callable
from typing import Any, TypeVar

import msgspec
import numpy as np
import pytest
import structlog
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.ot.cluster.dispatching import terms
from zswarm.errors import RemoteProtocolError, UnknownMessageError
from zswarm.ot.cluster.discovery import Found, Survey
from zswarm.ot.cluster.dispatch import Dispatch
from zswarm.ot.cluster.events import Answered, Ask, Gone, Seen
from zswarm.ot.cluster.matching import Choice
from zswarm.ot.commands import servers
from zswarm.ot.notes import Note
from zswarm.protocol import codec, keys, messages
from zswarm.protocol.messages import (
    LABEL_NAME,
    LABEL_VALUE,
    MAX_GENOMES,
    MAX_MESSAGE,
    MAX_TEXT,
    MAX_TRIALS,
    Evaluate,
    Outcomes,
    Part,
    Reserve,
)
from zswarm.system.text import clean

T = TypeVar("T")
# The same every time, and fewer where CI is not set.
FUZZ = settings(derandomize=True, max_examples=500 if os.environ.get("CI") else 100)
pack = msgspec.msgpack.encode
# Characters that clean() leaves as they are.
SHOWN = st.text(st.characters(categories=("L", "N", "P", "S", "Zs")), max_size=40)
TOKENS = st.binary(min_size=16, max_size=16)
COUNTS = st.integers(0, 2**53)
SECONDS = st.just(0.0) | st.floats(messages.MIN_SECONDS, messages.MAX_SECONDS)
SLOTS = st.integers(0, messages.MAX_SLOTS)
TRIALS = st.integers(0, MAX_TRIALS - 1)
PLAIN = st.recursive(
    st.one_of(
        st.booleans(),
        st.integers(-(2**63), 2**64 - 1),
        st.floats(allow_nan=False, allow_infinity=False),
        SHOWN,
    ),
    lambda inner: st.one_of(
        st.lists(inner, max_size=3), st.dictionaries(SHOWN, inner, max_size=3)
    ),
    max_leaves=5,
)
PARTS = st.builds(Part, SHOWN, st.dictionaries(SHOWN, PLAIN, max_size=3))
REQUESTS = {
    messages.Requirements: {
        **dict.fromkeys(("simulator", "representation", "version_hash"), SHOWN),
        "trial_memory_mb": st.integers(0, 2**40),
        "settings": st.dictionaries(SHOWN, PLAIN, max_size=3),
        "versions": st.dictionaries(SHOWN, SHOWN, max_size=3),
    },
    Reserve: {
        "nonce": TOKENS,
        "epoch": st.integers(0, messages.MAX_EPOCH),
        "slots": st.integers(1, messages.MAX_SLOTS),
        "simulator": PARTS,
        "representation": PARTS,
        "version_hash": SHOWN,
        "trial_timeout_s": st.floats(messages.MIN_SECONDS, messages.MAX_SECONDS),
        "trial_memory_mb": st.integers(0, 2**40),
        "asks": st.sampled_from(["", "turn", "agent"]),
        "proof": st.binary(max_size=32),
    },
    messages.Renew: {"lease": TOKENS, "known_ready": st.integers(-1, messages.MAX_SLOTS)},
    Evaluate: {
        "lease": TOKENS,
        "batch": COUNTS,
        "genomes": st.lists(st.binary(max_size=30), max_size=4),
        "participants": st.binary(max_size=30),
        "seeds": st.binary(max_size=30),
    },
    messages.Cancel: {"lease": TOKENS, "batches": st.lists(COUNTS, max_size=4)},
    messages.Release: {"lease": TOKENS},
}
TOLD = {
    "batch": COUNTS,
    **dict.fromkeys(("trials", "fitness", "metrics"), st.binary(max_size=30)),
    "seconds": SECONDS,
    "error": SHOWN,
    "left": SHOWN,
}
REPLIES = {
    messages.Offer: {
        **dict.fromkeys(("server", "program", "machine", "mismatch"), SHOWN),
        **dict.fromkeys(("capacity", "free"), SLOTS),
        "leases": COUNTS,
        **dict.fromkeys(
            ("simulators", "representations", "limits", "features"),
            st.lists(SHOWN, max_size=4),
        ),
        "labels": st.dictionaries(
            *(st.from_regex(rf"\A{rule}\Z") for rule in (LABEL_NAME, LABEL_VALUE)),
            max_size=4,
        ),
    },
    messages.Lease: {
        "lease": TOKENS,
        "state": st.sampled_from(["waiting", "preparing", "ready", "failed"]),
        **dict.fromkeys(("slots", "ready"), SLOTS),
        **dict.fromkeys(("compiling", "probe_begun", "probe_trials", "kernels"), COUNTS),
        "trial_s": SECONDS,
        "probe": st.binary(max_size=64),
        "reason": SHOWN,
        "passing": st.booleans(),
    },
    Outcomes: TOLD,
    messages.Running: {"done": TRIALS, "given": st.booleans(), **TOLD},
    messages.Fault: {
        **TOLD,
        "kind": st.sampled_from(["crashed", "timeout", "memory"]),
        "trial": TRIALS,
        "reason": SHOWN,
    },
    messages.Refused: {
        "code": st.sampled_from(
            "malformed superseded lease-lost busy draining mismatch cancelled".split()
        ),
        "reason": SHOWN,
    },
    messages.Done: {},
}
SENSORS = {
    **dict.fromkeys(("lease", "play"), TOKENS),
    **dict.fromkeys(("batch", "number"), COUNTS),
    "trial": TRIALS,
    **dict.fromkeys(("agents", "participants", "observations"), st.binary(max_size=30)),
}
ACTUATORS = {"actions": st.binary(max_size=30)}
ANY_SENSORS = st.builds(messages.Sensors, **SENSORS)
ANY_REACTION = st.one_of(
    st.builds(messages.Actuators, **ACTUATORS),
    st.builds(messages.Refused, **REPLIES[messages.Refused]),
)
ANY_REQUEST = st.one_of([st.builds(kind, **fields) for kind, fields in REQUESTS.items()])
ANY_REPLY = st.one_of([st.builds(kind, **fields) for kind, fields in REPLIES.items()])
ANY = st.one_of(ANY_REQUEST, ANY_REPLY, ANY_SENSORS, ANY_REACTION)


OFFER = messages.Offer(
    server="lab-1",
    program="0.1.0",
    machine="",
    capacity=1,
    free=1,
    leases=0,
    simulators=[],
    representations=[],
    labels={"gpu": "yes", "cores": "8"},
    limits=["arena.robots 100 at most"],
)


def reserve(**changes: Any) -> Reserve:
    fields: dict[str, Any] = {
        "nonce": bytes(16),
        "epoch": 1,
        "slots": 2,
        "simulator": Part("minisim", {}),
        "representation": Part("fully-meshed", {}),
        "version_hash": "",
        "trial_timeout_s": 1.0,
    }
    return Reserve(**(fields | changes))


def evaluate(**changes: Any) -> Evaluate:
    fields: dict[str, Any] = {
        "lease": bytes(16),
        "batch": 1,
        "genomes": [b"a", b"b"],
        "participants": struct.pack("<2I", 0, 1),
        "seeds": struct.pack("<2Q", 5, 6),
    }
    return Evaluate(**(fields | changes))


def refusal(body: bytes, decode: Any = codec.decode_request) -> str:
    with pytest.raises(RemoteProtocolError) as refused:
        decode(body)
    return str(refused.value)


def changed(message: Any, **changes: Any) -> bytes:
    """Return the bytes of a message with fields that no message may have."""
    return pack(msgspec.to_builtins(message, builtin_types=(bytes,)) | changes)


# ---- what comes through


def test_every_message_is_tested() -> None:
    assert set(REQUESTS) == set(messages.Request.__args__)
    assert set(REPLIES) == set(messages.Reply.__args__)
    assert {messages.Actuators, messages.Refused} == set(messages.Reaction.__args__)
    for kind, fields in {
        **REQUESTS,
        **REPLIES,
        messages.Sensors: SENSORS,
        messages.Actuators: ACTUATORS,
    }.items():
        assert set(fields) == set(kind.__struct_fields__)


@given(ANY_REQUEST)
def test_a_request_round_trips(message: messages.Request) -> None:
    assert codec.decode_request(codec.encode(message)) == message


@given(ANY_REPLY)
def test_a_reply_round_trips(message: messages.Reply) -> None:
    assert codec.decode_reply(codec.encode(message)) == message


@given(ANY_SENSORS, ANY_REACTION)
def test_sensors_and_their_answers_round_trip(
    sensors: messages.Sensors, reaction: messages.Reaction
) -> None:
    assert codec.decode_sensors(codec.encode(sensors)) == sensors
    assert codec.decode_reaction(codec.encode(reaction)) == reaction
    for body, decode in (
        (codec.encode(sensors), codec.decode_reaction),
        (codec.encode(reaction), codec.decode_sensors),
    ):
        assert safe_to_show(refusal(body, decode))


@given(ANY_REQUEST, ANY_REPLY)
def test_requests_are_no_replies_and_replies_no_requests(
    request: messages.Request, reply: messages.Reply
) -> None:
    assert safe_to_show(refusal(codec.encode(request), codec.decode_reply))
    assert safe_to_show(refusal(codec.encode(reply), codec.decode_request))


def test_a_message_cannot_be_changed() -> None:
    for kind in REQUESTS | REPLIES:
        assert kind.__struct_config__.frozen


def test_a_message_is_a_map_with_its_type_and_without_defaults() -> None:
    """Programs in other languages rely on these names and types."""
    assert msgspec.msgpack.decode(codec.encode(evaluate())) == {
        "type": "evaluate",
        "lease": bytes(16),
        "batch": 1,
        "genomes": [b"a", b"b"],
        "participants": b"\0\0\0\0\x01\0\0\0",
        "seeds": b"\x05\0\0\0\0\0\0\0\x06\0\0\0\0\0\0\0",
    }
    assert msgspec.msgpack.decode(codec.encode(messages.Done())) == {
        "type": "done",
    }


# ---- any bytes


def dangerous(text: str) -> set[str]:
    """Return the categories of characters that a terminal or a log may act on."""
    return {unicodedata.category(character) for character in text} & {
        "Cc",
        "Cf",
        "Cs",
        "Co",
        "Cn",
    }


def safe_to_show(text: str) -> bool:
    return not dangerous(text) and len(text) <= MAX_TEXT + 20


def ending(decode: Callable[..., T], *arguments: Any) -> T | str:
    """Return what is decoded, or the words of the refusal; nothing else may be raised."""
    try:
        return decode(*arguments)
    except RemoteProtocolError as error:
        return str(error)


def ends_well(body: bytes, decode: Callable[[bytes], messages.Message]) -> bool:
    """Return whether a body is a message that round-trips or is refused in safe words."""
    found = ending(decode, body)
    return (
        safe_to_show(found)
        if isinstance(found, str)
        else decode(codec.encode(found)) == found
    )


def ends_well_all_ways(body: bytes) -> bool:
    """Return whether a body ends well as each kind of request, reply, question and answer."""
    ways = (
        codec.decode_request,
        codec.decode_reply,
        codec.decode_sensors,
        codec.decode_reaction,
    )
    return all(ends_well(body, decode) for decode in ways)


@FUZZ
@given(st.binary(max_size=200))
def test_any_bytes_decode_to_a_message_or_raise_a_remote_error(body: bytes) -> None:
    assert ends_well_all_ways(body)


HOSTILE = [
    # Four thousand million of it.
    *(bytes([header]) + b"\xff\xff\xff\xff" for header in (0xC6, 0xC9, 0xDB, 0xDD, 0xDF)),
    *(b"\xdc\xff\xff", b"\xde\xff\xff", b"\xd9\xff", b"\xc4\xff"),
    *(b"\x91" * 3000, b"\x81\xa1a" * 3000, b"\x81" * 3000),
    *(
        pack(number)
        for number in (
            2**64 - 1,
            -(2**63),
            2**53 + 1,
            float("nan"),
            float("inf"),
            -0.0,
            1e308,
        )
    ),
    *(
        b"\xd3" + b"\xff" * 8,
        b"\xcf" + b"\xff" * 8,
        b"\xcb\x7f\xf8" + bytes(6),
        b"\xca\x7f\xc0\0\0",
        b"\xc7\x0c\xff" + b"\xff" * 12,
    ),
    *(
        pack(None),
        pack(True),
        pack(""),
        pack(b""),
        pack([]),
        pack({}),
        pack("\x1b]0;x\x07"),
        b"\xa1\xff",
        b"\xa3\xed\xa0\x80",
        b"\xc1",
    ),
]


@st.composite
def damaged(draw: st.DrawFn, message: st.SearchStrategy[messages.Message]) -> bytes:
    """Return a message's bytes with flipped bits, cut, with foreign bytes, or with a key twice."""
    body = bytearray(codec.encode(draw(message)))
    for _ in range(draw(st.integers(1, 3))):
        place = draw(st.integers(0, len(body)))
        match draw(st.sampled_from(["flip", "cut", "other", "put", "twice"])):
            case "flip" if place < len(body):
                body[place] ^= 1 << draw(st.integers(0, 7))
            case "cut":
                del body[place:]
            case "other":
                body[place : place + draw(st.integers(0, 6))] = draw(
                    st.binary(max_size=6)
                )
            case "put":
                body[place : place + draw(st.integers(0, 9))] = draw(
                    st.sampled_from(HOSTILE)
                )
            case "twice" if body and 0x80 <= body[0] < 0x8F:
                body[0] += 1
                body += pack(
                    draw(st.sampled_from(["type", "lease", "batch", "simulator"]))
                ) + draw(st.sampled_from(HOSTILE))
    return bytes(body)


@FUZZ
@given(damaged(ANY))
def test_a_damaged_message_decodes_or_raises_a_remote_error(body: bytes) -> None:
    assert ends_well_all_ways(body)


VALUES = st.recursive(
    st.one_of(
        st.none(),
        st.integers(-(2**63), 2**64 - 1),
        st.floats(),
        st.text(max_size=8),
        st.binary(max_size=18),
    ),
    lambda inner: st.one_of(
        st.lists(inner, max_size=3),
        st.dictionaries(st.text(max_size=8), inner, max_size=3),
    ),
    max_leaves=4,
)


@FUZZ
@given(ANY, st.data())
def test_any_value_in_a_field_decodes_or_raises_a_remote_error(
    message: messages.Message, data: st.DataObject
) -> None:
    key = data.draw(
        st.one_of(
            st.sampled_from(["type", *message.__struct_fields__]), st.text(max_size=6)
        )
    )
    assert ends_well_all_ways(changed(message, **{key: data.draw(VALUES)}))


SENSED = messages.Sensors(
    lease=bytes(16),
    batch=1,
    trial=0,
    play=bytes(16),
    number=0,
    agents=struct.pack("<2I", 4, 0),
    participants=struct.pack("<2I", 1, 0),
    observations=struct.pack("<4f", 1, 2, 3, 4),
)


def test_sensors_are_read_as_they_were_written() -> None:
    agents, participants, observations = codec.sensed(SENSED, 2, 2)
    assert (agents, participants, observations.tolist()) == (
        [4, 0],
        [1, 0],
        [[1, 2], [3, 4]],
    )
    assert observations.flags.writeable, "compiled controllers take no others"


@pytest.mark.parametrize(
    ("changes", "participants", "inputs", "words"),
    [
        (
            {"agents": b"", "participants": b"", "observations": b""},
            2,
            2,
            "at least one agent",
        ),
        ({"agents": struct.pack("<2I", 0, 65_536)}, 2, 2, "each below 65536"),
        ({"agents": b"abc"}, 2, 2, "not a whole number"),
        ({}, 1, 2, "2 agents need as many participants, each below 1"),
        (
            {"participants": struct.pack("<I", 0)},
            2,
            2,
            "2 agents need as many participants",
        ),
        ({}, 2, 3, "2 agents of 3 inputs need 6 numbers, not 4"),
        ({"observations": struct.pack("<4f", 1, 2, float("nan"), 4)}, 2, 2, "not finite"),
    ],
)
def test_sensors_that_do_not_fit_are_refused(
    changes: dict[str, bytes], participants: int, inputs: int, words: str
) -> None:
    with pytest.raises(RemoteProtocolError, match=words):
        codec.sensed(msgspec.structs.replace(SENSED, **changes), participants, inputs)


def test_actions_are_those_of_all_agents() -> None:
    told = messages.Actuators(actions=struct.pack("<4f", 1, 2, 3, 4))
    assert codec.decided(told, 2, 2).tolist() == [[1, 2], [3, 4]]
    with pytest.raises(
        RemoteProtocolError, match="3 agents of 2 outputs need 6 numbers, not 4"
    ):
        codec.decided(told, 3, 2)


def test_bytes_after_the_message_are_refused() -> None:
    assert "trailing" in refusal(codec.encode(evaluate()) + b"\0")


def test_a_message_that_is_too_large_is_refused_unread() -> None:
    body = codec.encode(evaluate(genomes=[bytes(12_000_000)] * 3))
    assert (
        refusal(body)
        == f"a message has {len(body)} bytes; at most {MAX_MESSAGE} are taken"
    )
    assert codec.decode_request(codec.encode(evaluate(genomes=[bytes(3_000_000)] * 2)))


# ---- what comes to a server

PARTS_OF_KEYS = st.sampled_from(
    [
        "zswarm",
        "v1",
        "v2",
        "default",
        "ss",
        "lab-1",
        "ot",
        "ada",
        "run-1",
        "",
        "*",
        "**",
        "$*",
        "..",
        "A",
    ]
)
KEYS = st.one_of(
    st.just(keys.offer("default", "lab-1")),
    st.sampled_from(
        [
            keys.request("default", "lab-1", "ada", "run-1", verb)
            for verb in keys.RunRequest
        ]
    ),
    st.lists(PARTS_OF_KEYS, min_size=5, max_size=10).map("/".join),
    st.text(max_size=40),
)


@FUZZ
@given(
    KEYS,
    st.one_of(
        st.binary(max_size=100), ANY_REQUEST.map(codec.encode), damaged(ANY_REQUEST)
    ),
)
def test_any_key_with_any_bytes_decodes_or_raises_a_remote_error(
    key: str, body: bytes
) -> None:
    decoded = ending(codec.decode_query, key, body)
    if isinstance(decoded, str):
        assert safe_to_show(decoded)
        return
    parts, message = decoded
    assert all(keys.is_id(part) for part in (parts.realm, parts.server, parts.verb))
    if isinstance(message, messages.Requirements):
        assert parts.verb == "offer"
    else:
        assert parts.verb == type(message).__struct_config__.tag
        assert keys.is_id(parts.user)
        assert keys.is_id(parts.run)


@FUZZ
@given(ANY_REQUEST, st.data())
def test_a_message_is_accepted_only_under_its_own_key(
    message: messages.Request, data: st.DataObject
) -> None:
    tag = str(type(message).__struct_config__.tag)
    urls = {
        verb: keys.request("default", "lab-1", "ada", "run-1", verb)
        for verb in keys.RunRequest
    }
    urls["requirements"] = keys.offer("default", "lab-1")
    parts, received = codec.decode_query(urls.pop(tag), codec.encode(message))
    assert received == message
    assert (parts.user, parts.run) == (
        ("", "") if tag == "requirements" else ("ada", "run-1")
    )
    other = data.draw(st.sampled_from(sorted(urls.values())))
    with pytest.raises(RemoteProtocolError, match="was sent to"):
        codec.decode_query(other, codec.encode(message))


# ---- settings

MARK = "a place to put other bytes"


def with_settings(raw: bytes, which: str) -> bytes:
    """Return a reserve with raw bytes as the value of a setting."""
    return codec.encode(reserve(**{which: Part("x", {"key": MARK})})).replace(
        pack(MARK), raw
    )


@pytest.mark.parametrize("which", ["simulator", "representation"])
@pytest.mark.parametrize(
    ("raw", "text"),
    [
        # Headers that promise four thousand million of something.
        (b"\xdd\xff\xff\xff\xff", "truncated"),
        (b"\xdf\xff\xff\xff\xff", "truncated"),
        (b"\xc6\xff\xff\xff\xff", "truncated"),
        (b"\xdb\xff\xff\xff\xff", "truncated"),
        (b"\xc9\xff\xff\xff\xff\x05", "truncated"),
        (b"\x91" * 100_000 + b"\xc0", "recursion depth"),
        (b"\x81\xa1a" * 100_000 + b"\xc0", "recursion depth"),
        (pack(float("nan")), "a setting is not finite"),
        (pack(float("inf")), "a setting is not finite"),
        (b"\xca" + struct.pack(">f", float("-inf")), "a setting is not finite"),
        (pack([1, {"a": [float("nan")]}]), "a setting is not finite"),
        (pack(None), "a setting is of type NoneType"),
        (pack(b"raw"), "a setting is of type bytes"),
        (pack(msgspec.msgpack.Ext(5, b"x")), "a setting is of type Ext"),
        (b"\xd6\xff\0\0\0\0", "a setting is of type datetime"),
        (pack({1: 2}), "a key of settings is not a text, or too long"),
        (pack({"k" * (MAX_TEXT + 1): 2}), "a key of settings is not a text, or too long"),
        (b"\x81\x91\x01\x01", "a key of settings is not a text, or too long"),
        (b"\x81\x80\x01", "map keys must be hashable"),
        (b"\xa1\xff", "utf-8"),
        (b"\xa3\xed\xa0\x80", "utf-8"),
        (b"\xc1", "malformed"),
        (b"\xd7\xff" + b"\xff" * 8, "timestamp"),
    ],
)
def test_settings_hold_plain_finite_values_only(
    which: str, raw: bytes, text: str
) -> None:
    assert text in refusal(with_settings(raw, which)).replace("UTF-8", "utf-8")


def test_settings_have_a_limited_number_of_values() -> None:
    for many in (
        {"a": [0] * messages.MAX_VALUES},
        {"a": [{"b": [""] * 99} for _ in range(messages.MAX_VALUES // 100)]},
    ):
        for which in ("simulator", "representation"):
            assert "more than 10,000 values" in refusal(with_settings(pack(many), which))
        asked = messages.Requirements(settings=many)
        assert "more than 10,000 values" in refusal(codec.encode(asked))
    most = {"a": [0] * (messages.MAX_VALUES - 1)}
    assert codec.decode_request(codec.encode(messages.Requirements(settings=most)))


@pytest.mark.parametrize("verb", list(messages.MAX_REQUEST))
def test_a_request_too_large_for_its_verb_is_refused_before_it_is_decoded(
    verb: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    limit = messages.MAX_REQUEST[verb]
    key = keys.request("r", "ss", "ada", "run", verb)
    with pytest.raises(RemoteProtocolError, match="not a message"):
        codec.decode_query(key, bytes(limit))
    monkeypatch.setattr(codec, "_decode", None)
    with pytest.raises(RemoteProtocolError) as refused:
        codec.decode_query(key, bytes(limit + 1))
    text = f"a request to {verb} has {limit + 1:,} bytes; at most {limit:,} are taken"
    assert str(refused.value) == text


def test_every_verb_has_a_limit_that_its_largest_honest_message_keeps() -> None:
    assert set(messages.MAX_REQUEST) == set(messages.VERBS.values())
    token, many = bytes(16), [2**53] * MAX_TRIALS
    for message in (
        messages.Cancel(lease=token, batches=many),
        messages.Renew(lease=token, known_ready=messages.MAX_SLOTS),
        messages.Release(lease=token),
        evaluate(genomes=[bytes(messages.MAX_GENOME)] * 2),
    ):
        verb = messages.verb(message)
        codec.check_size(verb, len(codec.encode(message)))


def test_a_proof_differs_between_servers_and_shows_no_secret() -> None:
    secret = bytes(range(16))
    here, there = (messages.proof(secret, name) for name in ("lab-1", "lab-2"))
    assert len({here, there, secret, messages.proof(bytes(16), "lab-1")}) == 4
    assert messages.proof(b"", "lab-1") == b""


def test_settings_are_nested_eight_deep_at_most() -> None:
    for depth, fits in (
        (codec.MAX_DEPTH - 2, True),
        (codec.MAX_DEPTH - 1, False),
        (300, False),
    ):
        for nest in (lambda inner: [inner], lambda inner: {"a": inner}):
            value: Any = 1
            for _ in range(depth):
                value = nest(value)
            body = codec.encode(reserve(simulator=Part("x", {"key": value})))
            if fits:
                assert codec.decode_request(body) == reserve(
                    simulator=Part("x", {"key": value})
                )
            else:
                assert refusal(body) == "settings are nested deeper than 8"


# ---- fields


@pytest.mark.parametrize(
    ("message", "changes"),
    [
        (reserve(), {"nonce": bytes(15)}),
        (reserve(), {"nonce": bytes(17)}),
        (reserve(), {"nonce": "0" * 16}),
        (reserve(), {"slots": 0}),
        (reserve(), {"slots": messages.MAX_SLOTS + 1}),
        (reserve(), {"slots": 1.0}),
        (reserve(), {"epoch": -1}),
        (reserve(), {"epoch": 2**53 + 1}),
        (reserve(), {"trial_timeout_s": 0.0}),
        (reserve(), {"trial_timeout_s": float("nan")}),
        (reserve(), {"trial_timeout_s": float("inf")}),
        (reserve(), {"trial_memory_mb": -1}),
        (reserve(), {"trial_memory_mb": 2**40 + 1}),
        (reserve(), {"version_hash": "a" * (MAX_TEXT + 1)}),
        (reserve(), {"simulator": ["x", {}]}),
        (reserve(), {"simulator": {"kind": "x"}}),
        (evaluate(), {"genomes": [b""] * (MAX_GENOMES + 1)}),
        (evaluate(), {"genomes": [bytes(messages.MAX_GENOME + 1)]}),
        (evaluate(), {"batch": True}),
        (
            messages.Cancel(lease=bytes(16), batches=[]),
            {"batches": [0] * (MAX_TRIALS + 1)},
        ),
        (messages.Renew(lease=bytes(16)), {"known_ready": -2}),
        (messages.Requirements(), {"settings": {"key": {"key": [float("nan")]}}}),
        (messages.Requirements(), {"settings": {"key": b"raw"}}),
        (messages.Requirements(), {"versions": {"numpy": 2}}),
        (
            messages.Requirements(),
            {"versions": {str(number): "" for number in range(messages.MAX_PARTS + 1)}},
        ),
    ],
)
def test_a_field_beyond_its_bounds_is_refused(
    message: Any, changes: dict[str, Any]
) -> None:
    assert codec.decode_request(changed(message)) == message
    assert safe_to_show(refusal(changed(message, **changes)))


def test_fields_of_a_reply_beyond_their_bounds_are_refused() -> None:
    lease = messages.Lease(lease=bytes(16), state="ready", slots=1, ready=1)
    for changes in (
        {"state": "gone"},
        {"trial_s": float("nan")},
        {"trial_s": -1.0},
        {"compiling": -1},
        {"probe": bytes(65)},
        {"trial_s": float("inf")},
        {"reason": "a" * (MAX_TEXT + 1)},
    ):
        (field,) = changes
        assert field in refusal(changed(lease, **changes), codec.decode_reply)
    for changes in (
        {"labels": {"gpu": "yes\n"}},
        {"labels": {"gpu": "\x1b[31m"}},
        {"labels": {"gpu": "[bold]"}},
        {"labels": {"gpu": ""}},
        {"labels": {"gpu": "y" * 64}},
        {"labels": {"gpu": 1}},
        {"labels": {"": "yes"}},
        {"labels": {"Gpu": "yes"}},
        {"labels": {"g" * 64: "yes"}},
        {"labels": {"gpu\n": "yes"}},
        {
            "labels": {
                f"label{number}": "yes" for number in range(messages.MAX_LABELS + 1)
            }
        },
        {"limits": ["arena.robots"] * (messages.MAX_PARTS + 1)},
        {"limits": ["a" * (MAX_TEXT + 1)]},
    ):
        (field,) = changes
        assert field in refusal(changed(OFFER, **changes), codec.decode_reply)
    outcomes = Outcomes(batch=1, fitness=b"", metrics=b"", seconds=1.0)
    assert "seconds" in refusal(
        changed(outcomes, seconds=float("nan")), codec.decode_reply
    )
    faulted = messages.Fault(batch=1, kind="crashed", trial=0, reason="")
    assert "tired" in refusal(changed(faulted, kind="tired"), codec.decode_reply)


def test_a_message_of_an_unknown_type_is_reported_regardless_of_its_contents() -> None:
    for body in (pack({"type": "invented"}), pack({"type": "invented", "lease": {}})):
        for decode in (codec.decode_request, codec.decode_reply, codec.decode_sensors):
            with pytest.raises(
                UnknownMessageError, match="of type 'invented' are unknown"
            ):
                decode(body)
    key = keys.request("default", "lab-1", "ada", "run-1", "renew") + "-later"
    with pytest.raises(UnknownMessageError):
        codec.decode_query(key, pack({"type": "invented"}))
    with pytest.raises(RemoteProtocolError, match="a Renew was sent to renew-later"):
        codec.decode_query(key, codec.encode(messages.Renew(lease=bytes(16))))


def test_unknown_fields_are_ignored_in_every_message() -> None:
    """A program with further optional fields works with one that lacks them."""
    for message in (
        reserve(),
        evaluate(),
        messages.Requirements(simulator="minisim"),
        messages.Renew(lease=bytes(16)),
    ):
        assert codec.decode_request(changed(message, more=[1])) == message
    for reply in (OFFER, messages.Done(), messages.Refused(code="busy", reason="")):
        assert codec.decode_reply(changed(reply, more={"a": 1})) == reply
    part = {"kind": "x", "settings": {}, "more": 1}
    known = messages.Part("x", {})
    decoded = codec.decode_request(changed(reserve(), simulator=part))
    assert decoded == reserve(simulator=known)


def test_refusals_with_unknown_codes_are_read() -> None:
    refused = messages.Refused(code="invented", reason="")
    assert codec.decode_reply(codec.encode(refused)) == refused


# ---- texts

DIRTY = "\x1b[31mred\x07\nline\r\x00 \u202eevil\u2066 \x9b \u200b\ufeff \U000e0041"


@pytest.mark.parametrize(
    ("text", "cleaned"),
    [
        ("plain text 1", "plain text 1"),
        ("Grüße, 世界 ∞", "Grüße, 世界 ∞"),
        ("\x1b[2J", "\\x1b[2J"),
        ("a\nb\tc\r", "a\\x0ab\\x09c\\x0d"),
        ("\x9b1m", "\\x9b1m"),
        ("\u202egpj.exe", "\\x202egpj.exe"),
        ("\u2066a\u2069", "\\x2066a\\x2069"),
        ("zero\u200bwidth", "zero\\x200bwidth"),
        ("\U000e0041", "\\xe0041"),
        ("\ue000", "\\xe000"),
        ("", ""),
    ],
)
def test_a_text_is_shown_with_its_dangerous_characters_spelt_out(
    text: str, cleaned: str
) -> None:
    assert clean(text) == cleaned


@given(st.text())
def test_a_clean_text_holds_no_control_or_format_character_and_stays_clean(
    text: str,
) -> None:
    cleaned = clean(text)
    assert len(cleaned) <= MAX_TEXT
    assert not dangerous(cleaned)
    assert clean(cleaned) == cleaned
    cleaned.encode()


def test_a_long_text_is_cut() -> None:
    assert clean("x" * 600) == "x" * MAX_TEXT
    assert len(clean("\x1b" * 500)) == MAX_TEXT


NASTY = [
    DIRTY,
    "\x1b]0;title\x07\x1b[2J\x1b[31m",
    "\x9b31m\x9d8;;http://x\x9c",
    "\u202egnp.exe\u2066\u200f",
    "two\nlines\r\n\x0bof\x0c\x85text\u2028and\u2029more",
    "nul\0 in it",
    "x" * MAX_TEXT,
    "\u202e" * MAX_TEXT,
    "[red]no[/red][link=file:///etc/passwd]",
    "=cmd()|' /C calc'!A0",
    '<script>alert(1)</script> & "quoted" {braces} %s %(x)s',
    "\U000e0041\ufeff\ue000\ufffe\U0010ffff",
    "e\u0301" * 20,
]


def lines_of_a_log(text: str) -> list[str]:
    """Return what a log shows of a text, in both forms."""
    event = {"event": "malformed", "reason": text}
    return [
        str(structlog.processors.JSONRenderer()(None, "info", dict(event))),
        str(structlog.dev.ConsoleRenderer(colors=False)(None, "info", dict(event))),
    ]


@pytest.mark.parametrize("text", NASTY)
def test_a_nasty_text_is_harmless_in_a_log(text: str) -> None:
    in_json, on_a_terminal = lines_of_a_log(clean(text))
    assert json.loads(in_json)["reason"] == clean(text)
    for line in (in_json, on_a_terminal):
        assert len(line.splitlines()) == 1
        assert not dangerous(line)


@pytest.mark.parametrize("text", NASTY)
def test_a_nasty_text_is_harmless_in_a_table(
    text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """The text is that of a received message; brackets are not markup."""
    offer = messages.Offer(
        server=text,
        program=text,
        machine=text,
        capacity=1,
        free=1,
        leases=0,
        simulators=[text],
        representations=[text],
        mismatch=text,
    )
    received = codec.decode_reply(codec.encode(offer))
    assert isinstance(received, messages.Offer)
    survey = Survey([Found("lab-1", received), Found("lab-2", None, clean(text))], {}, [])
    servers.show(survey, "default", Choice())
    shown = capsys.readouterr().out
    assert not dangerous(shown.replace("\n", ""))
    for character in "[=<{":
        assert shown.count(character) >= 2 * text.count(character)


@pytest.mark.parametrize("text", NASTY)
def test_a_nasty_text_is_harmless_in_a_note(text: str) -> None:
    """Notes to the user and in the record quote the texts of a server."""
    state = Dispatch(terms())
    offer = messages.Offer(
        server="lab-1",
        program="",
        machine="",
        capacity=1,
        free=1,
        leases=0,
        simulators=[],
        representations=[],
        mismatch=text,
    )
    for reply in (offer, messages.Refused(code="mismatch", reason=text)):
        state.handle(Gone("lab-1"), 0.0)
        (ask,) = (
            command
            for command in state.handle(Seen("lab-1"), 0.0)
            if isinstance(command, Ask)
        )
        (note,) = state.handle(
            Answered(ask.question, codec.decode_reply(codec.encode(reply))), 0.0
        )
        assert isinstance(note, Note)
        assert note.text == clean(text)
        assert not dangerous(note.text)


def test_a_lone_surrogate_is_refused_on_input_and_escaped_in_our_texts() -> None:
    assert clean("a\ud800") == "a\\xd800"
    body = pack({"type": "refused", "code": "busy", "reason": "?"}).replace(
        b"\xa1?", b"\xa3\xed\xa0\x80"
    )
    assert "utf-8" in refusal(body, codec.decode_reply).lower()


@pytest.mark.parametrize("text", NASTY)
@pytest.mark.parametrize("kind", [messages.Requirements, Reserve])
def test_every_name_in_a_request_is_cleaned_where_it_comes_in(
    kind: type[messages.Request], text: str
) -> None:
    if kind is Reserve:
        message: messages.Request = reserve(
            simulator=Part(text, {}), representation=Part(text, {}), version_hash=text
        )
    else:
        message = messages.Requirements(
            simulator=text, representation=text, version_hash=text, versions={text: text}
        )
    received = codec.decode_request(codec.encode(message))
    if isinstance(received, messages.Requirements):
        assert received.versions == {clean(text): clean(text)}
    for name in ("simulator", "representation", "version_hash"):
        value = getattr(received, name)
        assert (value.kind if isinstance(value, Part) else value) == clean(text)


@pytest.mark.parametrize("text", NASTY)
@pytest.mark.parametrize("kind", REPLIES)
def test_every_text_of_a_reply_is_cleaned_where_it_comes_in(
    kind: type[messages.Message], text: str
) -> None:
    """Each field that takes any text is sent dirty; fields of fixed words cannot be."""
    plain = {
        messages.Offer: dict.fromkeys(("capacity", "free", "leases"), 1),
        messages.Lease: {
            "lease": bytes(16),
            "state": "failed",
            "slots": 0,
            "ready": 0,
        },
        Outcomes: {"batch": 1, "fitness": b"", "metrics": b"", "seconds": 1.0},
        messages.Running: {"batch": 1, "done": 1},
        messages.Fault: {"batch": 1, "kind": "crashed", "trial": 1},
        messages.Refused: {"code": "busy"},
        messages.Done: {},
    }[kind]
    texts = {name: text for name, strategy in REPLIES[kind].items() if strategy is SHOWN}
    lists = {
        name: [text]
        for name in ("simulators", "representations", "limits")
        if name in REPLIES[kind]
    }
    received = codec.decode_reply(codec.encode(kind(**plain, **texts, **lists)))
    for name in texts:
        assert getattr(received, name) == clean(text)
        assert getattr(received, name).isprintable()
    for name in lists:
        assert getattr(received, name) == [clean(text)]


# ---- arrays


@FUZZ
@given(
    st.binary(max_size=70), st.binary(max_size=70), st.integers(0, 4), st.integers(1, 3)
)
def test_any_arrays_of_a_batch_fit_or_raise_a_remote_error(
    seeds: bytes, participants: bytes, genomes: int, k: int
) -> None:
    batch = evaluate(seeds=seeds, participants=participants, genomes=[b""] * genomes)
    decoded = ending(codec.trials, batch, k)
    if isinstance(decoded, str):
        assert safe_to_show(decoded)
        return
    who, drawn = decoded
    assert who.shape == (len(drawn), k)
    assert 0 <= who.min() <= who.max() < genomes
    assert drawn.tobytes() == seeds


@FUZZ
@given(
    st.lists(
        st.one_of(st.floats(), st.sampled_from([float("nan"), float("inf"), -0.0])),
        max_size=8,
    ),
    st.binary(max_size=40),
    st.integers(0, 3),
    st.integers(0, 2),
    st.integers(0, 2),
)
def test_any_outcomes_fit_without_infinities_or_raise_a_remote_error(
    fitness: list[float], metrics: bytes, count: int, k: int, m: int
) -> None:
    reply = Outcomes(
        batch=1, fitness=np.array(fitness, "<f8").tobytes(), metrics=metrics, seconds=0.0
    )
    decoded = ending(codec.outcomes, reply, count, k, m)
    if isinstance(decoded, str):
        assert safe_to_show(decoded)
        return
    _, told, measured = decoded
    assert (told.shape, measured.shape) == ((count, k), (count, m))
    assert not np.isinf(told).any()
    assert not np.isinf(measured).any()


@FUZZ
@given(st.lists(st.integers(0, 6), max_size=5), st.integers(0, 6))
def test_any_reported_trials_are_in_order_or_raise_a_remote_error(
    numbers: list[int], count: int
) -> None:
    running = messages.Running(
        batch=1, done=0, trials=codec.indices(numbers), fitness=bytes(8 * len(numbers))
    )
    decoded = ending(codec.outcomes, running, count, 1, 0)
    in_order = numbers == sorted(set(numbers)) and all(
        number < count for number in numbers
    )
    assert in_order != isinstance(decoded, str)
    if in_order:
        assert decoded[0].tolist() == numbers


def test_a_part_of_a_batch_has_its_trials_and_the_genomes_that_they_need() -> None:
    batch = evaluate(
        genomes=[b"a", b"b", b"c"],
        participants=struct.pack("<6I", 0, 0, 2, 1, 1, 2),
        seeds=struct.pack("<3Q", 5, 6, 7),
    )
    part = codec.cut(batch, 1, 3)
    participants, seeds = codec.trials(part, 2)
    assert (part.genomes, participants.tolist(), seeds.tolist()) == (
        [b"b", b"c"],
        [[1, 0], [0, 1]],
        [6, 7],
    )
    assert codec.cut(batch, 0, 3) == batch


def test_a_part_of_a_batch_with_an_unknown_participant_is_refused() -> None:
    batch = evaluate(participants=struct.pack("<2I", 0, 7))
    with pytest.raises(RemoteProtocolError, match="is not among 0 genomes"):
        codec.trials(codec.cut(batch, 1, 2), 1)


@FUZZ
@given(st.binary(max_size=40), st.sampled_from(["<u4", "<u8", "<f4", "<f8"]))
def test_any_bytes_are_an_array_or_raise_a_remote_error(raw: bytes, dtype: str) -> None:
    try:
        assert codec.array(raw, dtype).tobytes() == raw
    except RemoteProtocolError:
        assert len(raw) % np.dtype(dtype).itemsize


def test_the_arrays_of_a_batch_are_read_in_order() -> None:
    participants, seeds = codec.trials(evaluate(), 1)
    assert (participants.tolist(), participants.dtype) == ([[0], [1]], np.int64)
    assert (seeds.tolist(), seeds.dtype) == ([5, 6], np.uint64)
    two, _ = codec.trials(evaluate(participants=struct.pack("<4I", 0, 1, 1, 0)), 2)
    assert two.tolist() == [[0, 1], [1, 0]]
    _, largest = codec.trials(evaluate(seeds=struct.pack("<2Q", 2**64 - 1, 0)), 1)
    assert largest.tolist() == [2**64 - 1, 0]


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"seeds": b""}, f"a batch holds 1 to {MAX_TRIALS} trials, not 0"),
        (
            {"seeds": bytes(8 * (MAX_TRIALS + 1))},
            f"a batch holds 1 to {MAX_TRIALS} trials, not {MAX_TRIALS + 1}",
        ),
        ({"seeds": bytes(15)}, "15 bytes are not a whole number of <u8"),
        ({"participants": bytes(7)}, "7 bytes are not a whole number of <u4"),
        ({"participants": bytes(4)}, "2 trials of 1 participants need 2 indices, not 1"),
        ({"participants": bytes(12)}, "2 trials of 1 participants need 2 indices, not 3"),
        ({"participants": b""}, "2 trials of 1 participants need 2 indices, not 0"),
        (
            {"participants": struct.pack("<2I", 0, 2)},
            "participant 2 is not among 2 genomes",
        ),
        (
            {"participants": struct.pack("<2I", 0, 2**32 - 1)},
            "participant 4294967295 is not among 2 genomes",
        ),
        ({"genomes": []}, "participant 1 is not among 0 genomes"),
    ],
)
def test_arrays_of_a_batch_that_do_not_fit_are_refused(
    changes: dict[str, Any], text: str
) -> None:
    with pytest.raises(RemoteProtocolError) as refused:
        codec.trials(evaluate(**changes), 1)
    assert str(refused.value) == text


def outcomes(fitness: list[float], metrics: list[float]) -> Outcomes:
    fitness_bytes, metrics_bytes = (
        np.array(numbers, "<f8").tobytes() for numbers in (fitness, metrics)
    )
    return Outcomes(batch=1, fitness=fitness_bytes, metrics=metrics_bytes, seconds=0.0)


def test_outcomes_are_read_in_order() -> None:
    _, fitness, metrics = codec.outcomes(
        outcomes([1.5, float("nan"), 3, 4], [5, 6, 7, 8, 9, 10]), 2, 2, 3
    )
    assert np.array_equal(fitness, [[1.5, np.nan], [3, 4]], equal_nan=True)
    assert metrics.tolist() == [[5, 6, 7], [8, 9, 10]]
    trials, fitness, metrics = codec.outcomes(outcomes([1, 2], []), 2, 1, 0)
    assert trials.tolist() == [0, 1]
    assert fitness.shape == (2, 1)
    assert metrics.shape == (2, 0)


@pytest.mark.parametrize(
    ("fitness", "metrics"),
    [([1], [1, 2]), ([1, 2, 3], [1, 2]), ([1, 2], [1]), ([1, 2], [1, 2, 3]), ([], [])],
)
def test_outcomes_of_a_wrong_size_are_refused(
    fitness: list[float], metrics: list[float]
) -> None:
    with pytest.raises(
        RemoteProtocolError, match="2 trials need 2 fitness numbers and 2 metrics, not"
    ):
        codec.outcomes(outcomes(fitness, metrics), 2, 1, 1)


@pytest.mark.parametrize("large", [float("inf"), float("-inf"), 1.1e300, -1.7e308])
def test_outcomes_are_refused_whose_sums_could_overflow(large: float) -> None:
    for fitness, metrics in (([large, 0], [0, 0]), ([0, 0], [0, large])):
        with pytest.raises(RemoteProtocolError, match=r"an outcome is beyond 1e\+300"):
            codec.outcomes(outcomes(fitness, metrics), 2, 1, 1)
    most = messages.MAX_OUTCOME
    trials, *_ = codec.outcomes(outcomes([most, -most], [most, -most]), 2, 1, 1)
    assert trials.tolist() == [0, 1]


LEASE = messages.Lease(lease=bytes(16), state="ready", slots=1, ready=1)
TOO_MUCH: list[tuple[messages.Message, dict[str, float]]] = [
    *((LEASE, {"trial_s": time}) for time in (5e-324, 9.9e-10, -1.0, 1.1e9)),
    *((LEASE, {name: 2**16}) for name in ("slots", "ready")),
    *((OFFER, {name: 2**16}) for name in ("capacity", "free")),
    *((outcomes([], []), {"seconds": time}) for time in (5e-324, float("nan"), 2e9)),
    (messages.Running(batch=1, done=0), {"seconds": 1e-310}),
    (messages.Running(batch=1, done=0), {"done": MAX_TRIALS + 1}),
    (
        messages.Fault(batch=1, kind="crashed", trial=0, reason=""),
        {"trial": MAX_TRIALS},
    ),
]


@pytest.mark.parametrize(("message", "fields"), TOO_MUCH)
def test_a_number_of_a_server_beyond_its_range_is_refused(
    message: messages.Message, fields: dict[str, float]
) -> None:
    (name,) = fields
    assert name in refusal(changed(message, **fields), codec.decode_reply)


@pytest.mark.parametrize(
    ("name", "number"),
    [("epoch", 2**53), ("epoch", -1), ("slots", 2**16), ("trial_timeout_s", 5e-324)],
)
def test_a_number_of_an_optimizer_beyond_its_range_is_refused(
    name: str, number: float
) -> None:
    assert name in refusal(changed(reserve(), **{name: number}))


def test_outcomes_cut_in_a_number_are_refused() -> None:
    cut = msgspec.structs.replace(outcomes([1, 2], [3, 4]), fitness=bytes(15))
    with pytest.raises(
        RemoteProtocolError, match="15 bytes are not a whole number of <f8"
    ):
        codec.outcomes(cut, 2, 1, 1)
