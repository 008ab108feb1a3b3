"""What cannot be sent to a server is refused before a run begins."""

import pytest

import zswarm
from zswarm.errors import ConfigError
from zswarm.ot import problem
from zswarm.protocol import codec, messages

LARGEST = {"kind": "fully-meshed", "hidden": 1000}


def test_the_largest_network_of_the_settings_can_be_sent() -> None:
    built = zswarm.problem(simulator="minisim", representation=LARGEST)
    assert built.genes is not None
    assert 1_000_000 < built.genes < messages.MAX_GENOME // 4


def test_a_genome_that_no_message_takes_is_refused_with_its_size(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(problem, "MAX_GENOME", 4_000_000)
    with pytest.raises(
        ConfigError,
        match=r"representation: fully-meshed has 1,0[\d,]+ parameters with these settings, a genome"
        r" of 4,0[\d,]+ bytes; at most 4,000,000 can be sent to a server",
    ):
        zswarm.problem(simulator="minisim", representation=LARGEST)
    monkeypatch.setattr(problem, "MAX_GENOME", 16_000_000)
    monkeypatch.setattr(problem, "MAX_MESSAGE", 4_000_000)
    with pytest.raises(
        ConfigError,
        match=r"and a trial of minisim has [0-9]+ participants?; at most 4,000,000 bytes can be",
    ):
        zswarm.problem(simulator="minisim", representation=LARGEST)


def test_genomes_that_stay_at_the_optimizer_may_be_larger(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(problem, "MAX_GENOME", 1000)
    loaded = zswarm.load("stadium", {"representation.hidden": 30})
    with pytest.raises(ConfigError, match="at most 1,000 can be sent"):
        zswarm.problem(loaded)
    there = zswarm.load(loaded, {"cluster.controller": "optimizer"})
    assert zswarm.problem(there).genes


def test_settings_that_no_server_takes_are_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(messages, "MAX_MESSAGE", 60)
    with pytest.raises(
        ConfigError, match=r"problem\.settings: cannot be sent to servers: a message has"
    ):
        zswarm.problem(simulator="minisim")


def test_settings_larger_than_servers_take_are_refused_with_their_sizes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    loaded = zswarm.load("minisim")
    sizes = r"[0-9]+ and [0-9]+ bytes as they are sent; at most 60 together can be sent to servers"
    monkeypatch.setattr(problem, "MAX_SETTINGS", 60)
    with pytest.raises(
        ConfigError, match=r"problem\.settings and representation: " + sizes
    ):
        zswarm.problem(loaded)
    monkeypatch.setattr(messages, "MAX_VALUES", 3)
    with pytest.raises(ConfigError, match=r"settings have more than 3 values"):
        zswarm.problem(loaded)


def test_settings_at_their_limit_fit_into_each_request() -> None:
    """With the longest names, and more versions than any simulator has."""
    most = {"text": "x" * (messages.MAX_SETTINGS - 20)}
    versions = {f"code of simulator {number}": "x" * 100 for number in range(100)}
    asked = messages.Requirements(settings=most, versions=versions)
    reserve = messages.Reserve(
        nonce=bytes(16),
        epoch=messages.MAX_EPOCH,
        slots=messages.MAX_SLOTS,
        simulator=messages.Part("x" * 500, most),
        representation=messages.Part("x" * 500, {}),
        version_hash="x" * 500,
        trial_timeout_s=1.0,
        proof=bytes(32),
    )
    for message in (asked, reserve):
        codec.check_size(messages.verb(message), len(codec.encode(message)))
