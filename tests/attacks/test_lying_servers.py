"""One server among others that lies ends no run, hangs none, and changes no history."""

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.attacks import liar
from tests.attacks.liar import Liar
from tests.integration.programs import Optimizer, Server, wait_until
from tests.repository import REPOSITORY
from zswarm.protocol import codec
from zswarm.protocol.messages import Evaluate, Fault, Message, Verb

pytestmark = pytest.mark.attacks

Answers = dict[Verb, Callable[[Message], bytes]]
RUN = ("run", str(REPOSITORY / "examples" / "xor.toml"), "--json", "--no-multicast")
SHORT = ("--set", "generations=3", "--out", "runs")


def fault(message: Message, trial: int) -> bytes:
    assert isinstance(message, Evaluate)
    answer = Fault(
        batch=message.batch, kind="crashed", trial=trial, reason="\x1b]0;pwned\x07 you"
    )
    return codec.encode(answer)


LIES: dict[str, Answers] = {
    "a time that is divided by": {"reserve": lambda _: liar.lease(trial_s=5e-324)},
    "a time of outcomes": {
        "reserve": lambda _: liar.lease(trial_s=0.0),
        "evaluate": lambda asked: liar.outcomes(asked, 0.5, seconds=5e-324),
    },
    "fitness beyond all sums": {"evaluate": lambda asked: liar.outcomes(asked, 1.7e308)},
    "infinite fitness": {"evaluate": lambda asked: liar.outcomes(asked, float("inf"))},
    "another size": {"evaluate": lambda asked: liar.outcomes(asked, 1.0, metrics=b"1")},
    "a trial that no batch has": {"evaluate": lambda asked: fault(asked, 2**53)},
    "taken over": {
        "reserve": lambda _: liar.refused("superseded", "the run was taken over")
    },
    "lease lost": {
        "reserve": lambda _: liar.refused("lease-lost", "the run was taken over")
    },
    "lease lost for every batch": {
        "evaluate": lambda _: liar.refused("lease-lost", "no such lease")
    },
    "cancelled": {"evaluate": lambda _: liar.refused("cancelled", "asked again")},
    "nothing of sense": {"evaluate": lambda _: b"\x93" * 1000},
    "runs for ever": {},
    "a problem that cannot be prepared": {
        "reserve": lambda _: liar.lease(state="failed", reason="disk full", passing=True)
    },
}


@pytest.fixture(scope="module")
def right(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return the history hash of a run that nobody disturbs."""
    folder = tmp_path_factory.mktemp("right")
    alone = Optimizer(folder, "ot", [*RUN, *SHORT, "--servers", "local"])
    return str(alone.done()["history_hash"])


@pytest.fixture
def lying(request: pytest.FixtureRequest) -> Iterator[Liar]:
    lying = Liar(LIES[request.param])
    yield lying
    lying.close()


@pytest.mark.parametrize("lying", LIES, indirect=True)
def test_a_run_beside_a_lying_server_has_the_right_history(
    lying: Liar, right: str, tmp_path: Path
) -> None:
    """The liar is there before this machine's slots are ready: it is asked first."""
    beside = ["--servers", "auto", f"--connect={lying.endpoint}"]
    optimizer = Optimizer(tmp_path, "ot", [*RUN, *SHORT, *beside])
    try:
        assert optimizer.done()["history_hash"] == right
    finally:
        optimizer.close()
    assert lying.asked["reserve"]
    assert "Traceback" not in optimizer.err.read_text()


def test_a_server_by_the_name_of_this_machines_has_no_authority(
    right: str, tmp_path: Path
) -> None:
    """Its refusal ended the run, with a text of its choice."""
    name = "local-00000000"
    lost = codec.encode(liar.offer(name, "you lose"))
    stranger = Liar({"offer": lambda _: lost}, name=name)
    beside = ["--servers", "auto", f"--connect={stranger.endpoint}"]
    optimizer = Optimizer(tmp_path, "ot", [*RUN, *SHORT, *beside])
    try:
        assert optimizer.done()["history_hash"] == right
    finally:
        optimizer.close()
        stranger.close()
    assert stranger.asked["offer"]


def test_a_server_that_runs_for_ever_is_not_asked_as_fast_as_it_answers(
    right: str, tmp_path: Path
) -> None:
    """Alone it keeps the run waiting; an honest one that comes ends it."""
    lying, server = Liar({}), Server(tmp_path, "honest", capacity=2)
    beside = [f"--connect={one.endpoint}" for one in (lying, server)]
    server.close()
    optimizer = Optimizer(tmp_path, "ot", [*RUN, *SHORT, "--servers", "1", *beside])
    try:
        wait_until(lambda: lying.asked["evaluate"] >= 2, "it has batches")
        begun, before = time.monotonic(), lying.asked["evaluate"]
        wait_until(lambda: time.monotonic() > begun + 5.0, "some seconds passed")
        took_s = time.monotonic() - begun
        batches = 2 * liar.SLOTS
        assert lying.asked["evaluate"] - before <= batches * (took_s + 1.0)
        port = int(server.endpoint.rpartition(":")[2])
        server = Server(tmp_path, "honest", capacity=2, port=port)
        assert optimizer.done()["history_hash"] == right
    finally:
        for program in (optimizer, server):
            program.close()
        lying.close()
