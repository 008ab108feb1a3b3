"""Keys round-trip, and nothing from the network can widen one or leave a folder."""

import os
import re

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from zswarm.errors import LocalProtocolError, RemoteProtocolError
from zswarm.protocol import keys
from zswarm.protocol.keys import ServerKey

IDS = st.from_regex(r"[a-z0-9][a-z0-9-]{0,62}", fullmatch=True)
NO_IDS = [
    "",
    "-a",
    "A",
    "a_b",
    "a/b",
    "a b",
    "*",
    "**",
    "$*",
    "a*",
    "..",
    ".",
    "a.b",
    "ä",
    "a\n",
    "a\0",
    "a" * 64,
    "a?",
    "#",
]
VERBS = ["reserve", "renew", "evaluate", "cancel", "release"]


@given(IDS)
def test_an_id_is_a_safe_file_name(text: str) -> None:
    assert keys.is_id(text)
    assert "/" not in text
    assert text not in (".", "..")


@pytest.mark.parametrize("text", NO_IDS)
def test_an_invalid_id_is_reported(text: str) -> None:
    assert not keys.is_id(text)


@given(st.text())
def test_any_text_folds_to_an_id_that_a_server_can_be_named_by(text: str) -> None:
    folded = keys.fold(text)
    assert keys.is_id(folded)
    assert keys.is_id(keys.new_server_id(folded))
    assert keys.fold(folded) == folded


@pytest.mark.parametrize(
    ("text", "folded"),
    [
        ("Lab-PC.example.org", "lab-pc-example-org"),
        ("__", "x"),
        ("", "x"),
        ("Ünal", "nal"),
        ("a" * 99, "a" * 54),
    ],
)
def test_a_host_name_folds_to_the_nearest_id(text: str, folded: str) -> None:
    assert keys.fold(text) == folded


def test_a_restarted_server_is_another_one() -> None:
    first, second = keys.new_server_id("lab"), keys.new_server_id("lab")
    assert re.fullmatch("lab-[0-9a-f]{8}", first)
    assert first != second


def test_the_keys_are_those_of_the_protocol() -> None:
    assert keys.alive("r", "s") == "zswarm/v1/r/ss/s/alive"
    assert keys.alive("r", "*") == "zswarm/v1/r/ss/*/alive"
    assert keys.any_version_alive("r") == "zswarm/*/r/ss/*/alive"
    assert keys.offer("r", "s") == "zswarm/v1/r/ss/s/offer"
    assert keys.requests("r", "s") == "zswarm/v1/r/ss/s/ot/**"
    assert keys.run_alive("r", "u", "n") == "zswarm/v1/r/ot/u/n/alive"
    assert keys.run_alive("r", "*", "*") == "zswarm/v1/r/ot/*/*/alive"
    for verb in VERBS:
        assert keys.request("r", "s", "u", "n", verb) == f"zswarm/v1/r/ss/s/ot/u/n/{verb}"


@given(IDS, IDS, IDS, IDS, st.sampled_from(VERBS))
def test_a_key_of_a_server_is_taken_apart_as_it_was_built(
    realm: str, server: str, user: str, run: str, verb: str
) -> None:
    parsed = keys.parse_server_key(keys.request(realm, server, user, run, verb))
    assert parsed == ServerKey("v1", realm, server, verb, user, run)
    assert keys.parse_server_key(keys.alive(realm, server)) == ServerKey(
        "v1", realm, server, "alive"
    )
    assert keys.parse_server_key(keys.offer(realm, server)) == ServerKey(
        "v1", realm, server, "offer"
    )
    assert keys.parse_run_key(keys.run_alive(realm, user, run)) == (user, run)


def test_a_server_of_another_version_can_be_named() -> None:
    assert keys.parse_server_key("zswarm/v2/r/ss/s/alive") == ServerKey(
        "v2", "r", "s", "alive"
    )


@pytest.mark.parametrize("bad", NO_IDS)
def test_an_invalid_id_never_becomes_part_of_a_key(bad: str) -> None:
    """A star would widen a key; only the two that ask for all servers or runs take one."""
    builders = [
        lambda: keys.alive(bad, "s"),
        lambda: keys.any_version_alive(bad),
        lambda: keys.offer(bad, "s"),
        lambda: keys.offer("r", bad),
        lambda: keys.requests(bad, "s"),
        lambda: keys.requests("r", bad),
        lambda: keys.request(bad, "s", "u", "n", "renew"),
        lambda: keys.request("r", bad, "u", "n", "renew"),
        lambda: keys.request("r", "s", bad, "n", "renew"),
        lambda: keys.request("r", "s", "u", bad, "renew"),
        lambda: keys.request("r", "s", "u", "n", bad),
        lambda: keys.run_alive(bad, "u", "n"),
        lambda: keys.new_server_id(bad),
    ]
    if bad != "*":
        builders += [
            lambda: keys.alive("r", bad),
            lambda: keys.run_alive("r", bad, "n"),
            lambda: keys.run_alive("r", "u", bad),
        ]
    for build in builders:
        with pytest.raises(LocalProtocolError):
            build()


@pytest.mark.parametrize(
    "key",
    [
        "",
        "zswarm",
        "zswarm/v1/r/ss",
        "zswarm/v1/r/ss/s",
        "zswarm/v1/r/ss/s/",
        "zswarm/v1/r/ss//alive",
        "zswarm/v1//ss/s/alive",
        "zswarm/v1/r/ss/S/alive",
        "zswarm/v1/r/ss/*/alive",
        "zswarm/v1/**/ss/s/alive",
        "zswarm/v1/r/ss/s/other",
        "zswarm/v1/r/ss/s/alive/more",
        "zswarm/v1/r/ot/s/alive",
        "other/v1/r/ss/s/alive",
        "zswarm/v1/r/ss/s/ot/u/n",
        "zswarm/v1/r/ss/s/ot/u/n/alive",
        "zswarm/v1/r/ss/s/ot/u/n/Shutdown",
        "zswarm/v1/r/ss/s/ot/u/*/renew",
        "zswarm/v1/r/ss/s/ot/../n/renew",
        "zswarm/v1/r/ss/s/ot/u/\x1b[2J/renew",
        "zswarm/v1/r/ss/s/ot/u/n/renew/",
        "zswarm/v1/r/ss/s/xx/u/n/renew",
    ],
)
def test_an_invalid_server_key_is_a_remote_protocol_error(key: str) -> None:
    with pytest.raises(RemoteProtocolError) as refusal:
        keys.parse_server_key(key)
    assert str(refusal.value).isprintable()


@pytest.mark.parametrize(
    "key",
    [
        "",
        "zswarm/v1/r/ot/u/n",
        "zswarm/v1/r/ot/u/n/other",
        "zswarm/v1/r/ot/*/n/alive",
        "zswarm/v1/r/ot/u//alive",
        "zswarm/v1/r/ot/u/N/alive",
        "zswarm/v1/r/ot/u/n/alive/more",
        "zswarm/v1/r/ss/u/n/alive",
    ],
)
def test_an_invalid_run_key_is_a_remote_protocol_error(key: str) -> None:
    with pytest.raises(RemoteProtocolError):
        keys.parse_run_key(key)


PARTS = st.lists(
    st.one_of(
        st.text(max_size=8),
        IDS,
        st.sampled_from(["zswarm", "v1", "ss", "ot", "alive", *VERBS]),
    ),
    max_size=9,
)


@settings(derandomize=True, max_examples=500 if os.environ.get("CI") else 100)
@given(st.one_of(st.text(), PARTS.map("/".join)))
def test_any_text_parses_as_a_key_or_raises_a_remote_error(text: str) -> None:
    for parse, count in ((keys.parse_server_key, 6), (keys.parse_run_key, 2)):
        try:
            parsed = parse(text)
        except RemoteProtocolError:
            continue
        assert len(parsed) == count
        realm_and_below = parsed[1:] if count == 6 else parsed
        assert all(part == "" or keys.is_id(part) for part in realm_and_below)


def test_a_control_key_names_the_server_that_asks() -> None:
    key = keys.control("default", "ann", "run-1", "lab-1-00000000")
    assert key == "zswarm/v1/default/ot/ann/run-1/control/lab-1-00000000"
    assert keys.parse_control_key(key) == "lab-1-00000000"
    assert keys.control("default", "ann", "run-1", "*").endswith("/control/*")


@pytest.mark.parametrize(
    "key",
    [
        "zswarm/v1/default/ot/ann/run-1/alive",
        "zswarm/v1/default/ot/ann/run-1/control",
        "zswarm/v1/default/ot/ann/run-1/control/*",
        "zswarm/v1/default/ot/ann/run-1/control/Lab",
        "zswarm/x2/default/ot/ann/run-1/control/lab",
        "zswarm/v1/default/ss/ann/run-1/control/lab",
        "zswarm/v1/default/ot/ann/run-1/control/lab/more",
    ],
)
def test_other_keys_are_no_control_keys(key: str) -> None:
    with pytest.raises(RemoteProtocolError):
        keys.parse_control_key(key)
