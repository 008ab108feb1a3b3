"""The server of this machine's slots is killed: it is started again, and nothing is lost."""

import os
import signal
from collections.abc import Container, Iterator

import pytest

from tests.integration.paced import Pace, Scene, Undisturbed, counted
from tests.integration.programs import (
    Optimizer,
    children,
    command_line,
    query,
    wait_until,
)
from tests.promise.promise import check_run
from zswarm.ot.cluster.local import AGAIN, LocalServer

pytestmark = pytest.mark.faults

WORDS = "the slots of this machine were killed by signal 9: started again"
STUDY = """
[study]
repeat = 3
at_once = 3
"""


@pytest.fixture
def optimizer(scene: Scene) -> Iterator[Optimizer]:
    """Start a run on slots of this machine alone."""
    file = scene.size.write(scene.folder / "paced.toml")
    optimizer = start(scene, file)
    yield optimizer
    optimizer.close()


def start(scene: Scene, file: str) -> Optimizer:
    pace = Pace(scene.folder / "pace")
    scene.environment["PACED_FOLDER"] = str(pace.folder)
    options = ["--json", "--servers", "local", "--set", "cluster.local_slots=2"]
    return Optimizer(scene.folder, "ot", ["run", file, *options], **scene.environment)


def kill_server_of(program: int, but: Container[int] = ()) -> int:
    """Kill a program's own server, once there is one; return its process."""

    def found() -> int:
        own = children(program)
        servers = [one for one in own if "zswarm.ss" in command_line(one)]
        return next((one for one in servers if one not in but), 0)

    server = int(wait_until(found, "the slots of this machine are started"))
    os.kill(server, signal.SIGKILL)
    return server


def test_a_killed_local_server_is_started_again(
    scene: Scene, undisturbed: Undisturbed, optimizer: Optimizer
) -> None:
    for _ in range(2):
        scene.wait_for_more("local-", 10)
        kill_server_of(optimizer.process.pid)
    scene.check(optimizer.done(), undisturbed)
    assert optimizer.err.read_text().count(WORDS) == 2
    servers = query(scene.run, "SELECT count(DISTINCT server) FROM outcomes")
    assert servers == [(3,)], "one of them computed nothing"


def test_a_local_server_that_something_kills_again_and_again_ends_the_run(
    scene: Scene, undisturbed: Undisturbed, optimizer: Optimizer
) -> None:
    """It can be resumed."""
    killed: set[int] = set()
    while len(killed) < 4:
        killed.add(kill_server_of(optimizer.process.pid, killed))
    assert optimizer.wait() == 1
    said = optimizer.err.read_text()
    assert said.count(WORDS) == 3
    assert "the slots of this machine ended: exit code -9" in said
    assert f"Resume with: zswarm-ot resume {scene.run.relative_to(scene.folder)}" in said
    resume = ["resume", str(scene.run), "--json"]
    resumed = Optimizer(scene.folder, "resumed", resume, **scene.environment)
    try:
        scene.check(resumed.done(), undisturbed)
    finally:
        resumed.close()


def test_a_killed_local_server_has_not_ended_while_it_may_be_started_again() -> None:
    """A run that looked at it before it was killed asks next whether it ended."""
    killed = set(children(os.getpid()))  # those of other tests
    local = LocalServer(1, "default")

    def kill() -> None:
        killed.add(server := kill_server_of(os.getpid(), killed))
        os.waitid(os.P_PID, server, os.WEXITED | os.WNOWAIT)

    try:
        for _ in range(AGAIN):
            kill()
            assert not local.ended()
            assert local.start_again() == WORDS
        kill()
        assert not local.start_again()
        assert local.ended().startswith("exit code -9")
    finally:
        local.close()


def test_a_killed_local_server_of_a_study_is_started_once(scene: Scene) -> None:
    file = scene.folder / "sweep.toml"
    scene.size.write(file)
    file.write_text(file.read_text() + STUDY)
    optimizer = start(scene, str(file))
    runs = scene.folder / "runs" / "paced"
    try:
        wait_until(
            lambda: all(counted(runs / f"seed-{seed}") > 5 for seed in (5, 6, 7)),
            "all runs are served",
        )
        kill_server_of(optimizer.process.pid)
        assert optimizer.done()["finished"] == 3
    finally:
        optimizer.close()
    assert optimizer.err.read_text().count(WORDS) == 1
    for seed in (5, 6, 7):
        assert check_run(runs / f"seed-{seed}", sample=0).finished
