"""A controller at the optimizer gives the history of controllers that travel."""

import os
import signal
from pathlib import Path
from typing import Any

import pytest

from tests.integration.programs import (
    Optimizer,
    Program,
    Server,
    free_port,
    query,
    status,
    wait_until,
)
from tests.integration.proxy import Proxy
from tests.promise.promise import check_run

pytestmark = pytest.mark.programs

EXPERIMENT = """
name = "asked"
seed = 3
generations = 3
[problem]
simulator = "{simulator}"
trials = {trials}
settings = {settings}
[representation]
kind = "hebbian"
[optimizer]
kind = "nnga"
population = 10
"""
SMALL = {
    "emergency-exit": "{agents = 4, steps = 20}",
    "minisim": "{steps = 20, robots = 3}",
}
COUNTED = "SELECT coalesce(sum(count), 0) FROM outcomes"
ASKED = '--set=cluster.controller="optimizer"'
EACH_AGENT = '--set=cluster.messages="agent"'


def play(
    folder: Path, name: str, *options: str, simulator: str = "minisim", trials: int = 1
) -> Optimizer:
    file = folder / "experiment.toml"
    file.write_text(
        EXPERIMENT.format(
            simulator=simulator,
            trials=trials,
            settings=SMALL.get(simulator, "{}"),
        )
    )
    return Optimizer(
        folder,
        name,
        [
            "run",
            str(file),
            "--json",
            "--no-multicast",
            f"--out={folder / name}",
            *options,
        ],
    )


def local(slots: int) -> tuple[str, ...]:
    return "--servers=local", f"--set=cluster.local_slots={slots}"


def remote(*servers: Server) -> tuple[str, ...]:
    return f"--servers={len(servers)}", *(
        f"--connect={server.endpoint}" for server in servers
    )


def reference(folder: Path, simulator: str, trials: int) -> str:
    """Return the history hash of controllers that travel."""
    return str(
        play(folder, "reference", *local(1), simulator=simulator, trials=trials).done()[
            "history_hash"
        ]
    )


def counted(folder: Path, name: str) -> int:
    rows = query(folder / name / "asked", COUNTED)
    return int(rows[0][0]) if rows else 0


def test_the_history_is_that_of_controllers_at_the_servers(tmp_path: Path) -> None:
    """The run names its way in one line: a question per turn, or per agent."""
    expected = reference(tmp_path, "minisim", 1)
    for name, options in (("turn", ()), ("agent", (EACH_AGENT,))):
        optimizer = play(tmp_path, name, ASKED, *options, *local(2))
        assert optimizer.done()["history_hash"] == expected
        said = [
            line
            for line in optimizer.err.read_text().splitlines()
            if "controllers" in line
        ]
        assert said == [
            f"the controllers stay in this program: servers ask it a question for each {name}"
        ]


@pytest.mark.faults
@pytest.mark.parametrize("options", [(), (EACH_AGENT,)])
def test_simulators_with_sequential_agents_have_the_same_history(
    tmp_path: Path, options: tuple[str, ...]
) -> None:
    """The number of agents differs by trial."""
    more = ("--set=problem.settings.agents={from = 3, to = 6}", *local(2))
    travelled = play(
        tmp_path, "travelled", *more, simulator="emergency-exit", trials=2
    ).done()
    asked = play(
        tmp_path, "asked", ASKED, *options, *more, simulator="emergency-exit", trials=2
    ).done()
    assert asked["history_hash"] == travelled["history_hash"]


@pytest.mark.faults
def test_killed_servers_do_not_change_the_history(
    tmp_path: Path,
) -> None:
    """Two of them; then both, and one that starts only now does the rest."""
    expected = reference(tmp_path, "emergency-exit", 2)
    servers = [
        Server(tmp_path, f"ss-{number}", capacity=1).ready() for number in range(2)
    ]
    port = free_port()
    late = f"--connect=tcp/127.0.0.1:{port}"
    optimizer = play(
        tmp_path,
        "asked",
        ASKED,
        *remote(*servers),
        late,
        simulator="emergency-exit",
        trials=2,
    )
    programs: list[Program] = [optimizer, *servers]
    try:
        shares = "SELECT count(DISTINCT server) FROM outcomes"
        wait_until(
            lambda: query(tmp_path / "asked" / "asked", shares) == [(2,)],
            "both servers play",
        )
        servers[0].kill()
        before = counted(tmp_path, "asked")
        wait_until(
            lambda: counted(tmp_path, "asked") > before + 2, "the other one goes on"
        )
        servers[1].kill()
        programs.append(Server(tmp_path, "late", capacity=2, port=port))
        assert optimizer.done()["history_hash"] == expected
    finally:
        for program in programs:
            program.close()
    check_run(tmp_path / "asked" / "asked")


@pytest.mark.faults
def test_a_killed_optimizer_is_resumed_and_its_slots_are_freed(
    tmp_path: Path,
) -> None:
    """Slots that asked it do not hang: the next epoch of the run has them."""
    expected = reference(tmp_path, "emergency-exit", 2)
    server = Server(tmp_path, "ss", capacity=2).ready()
    first = play(
        tmp_path, "asked", ASKED, *remote(server), simulator="emergency-exit", trials=2
    )
    try:
        wait_until(lambda: counted(tmp_path, "asked") > 8, "some trials are counted")
        first.kill()
        folder = str(tmp_path / "asked" / "asked")
        second = Optimizer(
            tmp_path,
            "second",
            ["resume", folder, "--json", "--no-multicast", *remote(server)],
        )
        assert second.done()["history_hash"] == expected
        assert not server.events("slot_died"), "nobody's fault"
    finally:
        first.close()
        server.close()
    check_run(Path(folder))


@pytest.mark.faults
def test_a_killed_slot_and_a_stopped_optimizer_do_not_change_the_history(
    tmp_path: Path,
) -> None:
    expected = reference(tmp_path, "emergency-exit", 2)
    server = Server(tmp_path, "ss", capacity=2).ready()
    optimizer = play(
        tmp_path, "asked", ASKED, *remote(server), simulator="emergency-exit", trials=2
    )
    try:
        wait_until(lambda: counted(tmp_path, "asked") > 8, "some trials are counted")
        os.kill(server.workers()[0], signal.SIGKILL)
        wait_until(lambda: server.events("slot_died"), "the server notices")
        optimizer.kill(signal.SIGSTOP)
        wait_until(
            lambda: (found := status(optimizer.process.pid)) and found.state == "T",
            "it stands still",
        )
        quiet = [status(worker) for worker in server.workers()]
        assert all(quiet), "slots wait"
        optimizer.kill(signal.SIGCONT)
        assert optimizer.done()["history_hash"] == expected
    finally:
        optimizer.close()
        server.close()
    check_run(tmp_path / "asked" / "asked")


@pytest.mark.faults
def test_lost_answers_are_requested_again(tmp_path: Path) -> None:
    """The link is reset repeatedly in the middle of trials; states continue unchanged."""
    expected = reference(tmp_path, "emergency-exit", 1)
    server = Server(tmp_path, "ss", capacity=2).ready()
    with Proxy(server.endpoint) as link:
        through = ("--servers=1", f"--connect={link.endpoint}")
        optimizer = play(tmp_path, "asked", ASKED, *through, simulator="emergency-exit")
        try:
            wait_until(lambda: counted(tmp_path, "asked") > 8, "some trials are counted")
            for _ in range(4):
                back, connections = link.back, link.connections
                link.reset()
                wait_until(
                    lambda: link.connections > connections,  # noqa: B023
                    "the link is there again",
                )
                wait_until(lambda: link.back > back + 20_000, "questions go on")  # noqa: B023
            assert optimizer.done()["history_hash"] == expected
        finally:
            optimizer.close()
            server.close()
    check_run(tmp_path / "asked" / "asked")


@pytest.mark.faults
def test_parallel_runs_are_answered_by_their_own_controllers(tmp_path: Path) -> None:
    """A study whose runs share a server, and ask with it."""

    def histories(name: str, *options: str) -> dict[str, Any]:
        optimizer = play(
            tmp_path,
            name,
            "--repeat=2",
            "--set=study.at_once=2",
            *options,
            *local(2),
            trials=2,
        )
        assert optimizer.wait() == 0, optimizer.err.read_text()
        ended = [line for line in optimizer.lines() if line["event"] == "run"]
        return {Path(line["run"]).name: line["history_hash"] for line in ended}

    travelled = histories("travelled")
    assert len(set(travelled.values())) == 2
    assert histories("asked", ASKED) == travelled


@pytest.mark.faults
def test_large_questions_and_answers_use_sender_threads(tmp_path: Path) -> None:
    """Zenoh takes small ones without waiting; these have 38 kB, and 6 kB for each of two slots."""
    swarm = ("--set=problem.settings={robots = 800, steps = 10, side = 100.0}", *local(2))
    travelled = play(tmp_path, "travelled", *swarm, simulator="arena").done()
    assert (
        play(tmp_path, "asked", ASKED, *swarm, simulator="arena").done()["history_hash"]
        == travelled["history_hash"]
    )


@pytest.mark.faults
def test_a_router_carries_the_questions(tmp_path: Path) -> None:
    expected = reference(tmp_path, "minisim", 1)
    place = f"tcp/127.0.0.1:{free_port()}"
    router = Program(
        tmp_path, "router", ["-m", "zswarm.router", "--no-multicast", "--listen", place]
    )
    wait_until(lambda: router.events("router_ready"), "the router is there")
    server = Server(tmp_path, "ss", options=("--connect", place)).ready()
    try:
        through = ("--servers=1", f"--connect={place}", "--through-router")
        assert play(tmp_path, "asked", ASKED, *through).done()["history_hash"] == expected
    finally:
        server.close()
        router.close()


def test_messages_per_agent_need_controllers_at_the_optimizer(tmp_path: Path) -> None:
    optimizer = play(tmp_path, "wrong", EACH_AGENT)
    assert optimizer.wait() == 2
    (line,) = optimizer.err.read_text().splitlines()
    assert (
        'messages: expected "turn" unless controller is "optimizer", not "agent"' in line
    )
