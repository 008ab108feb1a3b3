"""What cannot be sent to a server is refused before a run begins."""

import pytest

import zswarm
from zswarm.errors import ConfigError
from zswarm.ot import problem
from zswarm.protocol import messages

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
