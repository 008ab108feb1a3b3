"""Without keys, a stranger who knows a run's name neither ends it nor what resumes it."""

import secrets
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.attacks.peer import Peer, reserve, serving
from tests.integration.programs import Optimizer, Server, query, wait_until
from zswarm.protocol import codec, keys, messages
from zswarm.protocol.messages import Lease, Refused

pytestmark = pytest.mark.attacks

EPOCHS = (1, 900, messages.MAX_EPOCH, 2**53)


@pytest.fixture
def evolve() -> Iterator[Callable[..., Optimizer]]:
    started: list[Optimizer] = []

    def start(*arguments: Any) -> Optimizer:
        started.append(_evolve(*arguments))
        return started[-1]

    yield start
    for program in started:
        program.close()


def _evolve(folder: Path, server: Server, *arguments: str) -> Optimizer:
    options = ["--servers", "1", "--no-multicast", "--connect", server.endpoint]
    if arguments[0] == "resume":
        options = []
    name = f"ot-{secrets.token_hex(2)}"
    return Optimizer(folder, name, [*arguments, "--json", *options])


def attack(stranger: Peer, user: str, run: str, epoch: int) -> messages.Reply | None:
    """Reserve under a run's name with a higher epoch, as its resume would."""
    stranger.user = user
    message = reserve(epoch=min(epoch, messages.MAX_EPOCH), proof=secrets.token_bytes(16))
    body = codec.encode(message)
    if epoch > messages.MAX_EPOCH:
        number = messages.MAX_EPOCH.to_bytes(4, "big")
        body = body.replace(b"\xce" + number, b"\xcf" + epoch.to_bytes(8, "big"))
    ended = stranger.send("reserve", body, run)
    (answer,) = wait_until(lambda: ended, "the query ends")
    return codec.decode_reply(answer) if answer is not None else None


def held(server: Server, folder: Path) -> tuple[str, str]:
    """Return user and run of the lease that a server granted last."""
    granted = wait_until(lambda: server.events("lease_granted"), "a lease is granted")
    return str(granted[-1]["user"]), str(granted[-1]["run"])


def test_a_strangers_epoch_ends_no_run_and_poisons_no_resume(
    tmp_path: Path, evolve: Callable[..., Optimizer]
) -> None:
    with serving(tmp_path) as server, Peer(server, "mallory") as stranger:
        endless = ("--set", "generations=100000")
        run = evolve(tmp_path, server, "run", "xor", *endless)
        user, name = held(server, tmp_path)
        assert (user, keys.is_id(name)) != ("mallory", False)
        for epoch in EPOCHS:  # while it has its lease
            answer = attack(stranger, user, name, epoch)
            assert isinstance(answer, Refused), epoch
        assert run.process.poll() is None
        folder = tmp_path / "runs" / "xor"
        wait_until(lambda: query(folder, "SELECT * FROM generations"), "a generation")
        run.kill(2)
        run.wait()
        ended = wait_until(
            lambda: server.events("lease_released"), "the run's lease ends"
        )
        assert len(ended) == 1
        answer = attack(stranger, user, name, 900)  # it may use a name that is free
        assert isinstance(answer, Lease)
        stranger.ask(messages.Release(lease=answer.lease), name)
        resumed = evolve(tmp_path, server, "resume", "runs/xor")
        wait_until(
            lambda: len(server.events("lease_granted")) == 3 or resumed.process.poll(),
            "the resumed run has a lease",
        )
        for epoch in EPOCHS:
            assert isinstance(attack(stranger, user, name, epoch), Refused), epoch
        assert resumed.process.poll() is None, resumed.err.read_text()
        resumed.kill(2)
        resumed.wait()
        assert "taken over" not in run.err.read_text() + resumed.err.read_text()


def test_the_runs_own_resume_takes_it_over(
    tmp_path: Path, evolve: Callable[..., Optimizer]
) -> None:
    """The record has the secret: another workstation, or a killed program's folder, has it, too."""
    with serving(tmp_path) as server:
        run = evolve(tmp_path, server, "run", "xor", "--set", "generations=100000")
        held(server, tmp_path)
        folder = tmp_path / "runs" / "xor"
        wait_until(lambda: query(folder, "SELECT * FROM generations"), "a generation")
        run.kill()
        run.wait()
        resumed = evolve(tmp_path, server, "resume", "runs/xor")
        wait_until(
            lambda: server.events("lease_taken_over") or resumed.process.poll(),
            "the lease is taken over",
        )
        assert resumed.process.poll() is None, resumed.err.read_text()
