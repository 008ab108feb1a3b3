"""Runs with real processes on loopback give the same result through any failure."""

import shutil
import signal
from pathlib import Path

import pytest

from tests.integration import asleep, evacuation
from tests.integration.asleep import HISTORY as ALONE
from tests.integration.evacuation import ASSESSED, COUNTED, TRIALS
from tests.integration.programs import Optimizer, Server, free_port, query, wait_until
from tests.promise.promise import check_run

pytestmark = pytest.mark.usefixtures("sleeping")

# The hash of the assessment when nothing happens to the run, made once.
ASSESSED_ALONE = "904a55c4f583a5a98e7af71f66e27e01"


def run(folder: Path, name: str, *options: str) -> Optimizer:
    file = asleep.write(folder, "disturbed")
    return Optimizer(folder, name, ["run", file, "--json", *options])


def remote(*servers: Server, wait: int = 0) -> list[str]:
    """Return options that use only these servers."""
    return [
        "--no-multicast",
        "--servers",
        str(wait or len(servers)),
        *(f"--connect={server.endpoint}" for server in servers),
    ]


def counted(folder: Path) -> int:
    rows = query(folder / "runs" / "disturbed", COUNTED)
    return int(rows[0][0]) if rows else 0


def test_killed_and_late_servers_do_not_change_the_history(tmp_path: Path) -> None:
    """Kill one server, then the others; a server that starts late finishes the work."""
    servers = [Server(tmp_path, f"ss-{number}", capacity=1) for number in range(3)]
    late_port = free_port()
    optimizer = run(
        tmp_path,
        "ot",
        *remote(*[server.ready() for server in servers]),
        f"--connect=tcp/127.0.0.1:{late_port}",
    )
    record = tmp_path / "runs" / "disturbed"
    programs = [*servers, optimizer]
    try:
        of_second = "SELECT 1 FROM outcomes WHERE server LIKE 'ss-1-%'"
        wait_until(lambda: query(record, of_second), "the second server works")
        servers[1].kill()
        without_it = counted(tmp_path) + 100
        wait_until(lambda: counted(tmp_path) > without_it, "the others go on")
        servers[0].kill()
        servers[2].kill()
        assert counted(tmp_path) < TRIALS, "the run is over too early for this test"
        programs.append(Server(tmp_path, "late", capacity=1, port=late_port))
        done = optimizer.done()
    finally:
        for program in programs:
            program.close()
    shares = dict(query(record, "SELECT server, trials FROM servers"))
    assert done["history_hash"] == ALONE
    assert done["assessment_hash"] == ASSESSED_ALONE
    assert done["requeued"] > 0
    assert query(
        record, "SELECT sum(count) > 0 FROM events WHERE event = 'requeued'"
    ) == [(1,)]
    assert (
        sum(trials for server, trials in shares.items() if server.startswith("late-")) > 0
    )
    assert sum(shares.values()) == TRIALS + ASSESSED
    assert check_run(record).history_hash == ALONE


@pytest.mark.long
def test_a_killed_optimizer_resumes_and_repeats_nothing(tmp_path: Path) -> None:
    server = Server(tmp_path, "ss")
    try:
        killed = run(tmp_path, "killed", *remote(server))
        wait_until(lambda: counted(tmp_path) > 1200, "the second generation is under way")
        killed.kill()
        killed.wait()
        before = counted(tmp_path)
        done = Optimizer(
            tmp_path, "resumed", ["resume", "runs/disturbed", "--json", *remote(server)]
        ).done()
        taken_over = server.events("lease_taken_over")
    finally:
        server.close()
    assert done["history_hash"] == ALONE
    assert 1200 < before < TRIALS
    assert counted(tmp_path) == TRIALS + ASSESSED, "a recorded trial was evaluated again"
    assert len(taken_over) == 1, "the slots were not taken over at once"
    assert check_run(tmp_path / "runs" / "disturbed").history_hash == ALONE


@pytest.mark.long
def test_an_optimizer_killed_in_the_assessment_resumes_there(tmp_path: Path) -> None:
    """Another number of slots, and a kill, change neither its hash nor its champion."""
    servers = [Server(tmp_path, f"ss-{number}", capacity=1) for number in range(2)]
    try:
        killed = run(tmp_path, "killed", *remote(*servers))
        wait_until(lambda: counted(tmp_path) > TRIALS, "the assessment is under way")
        killed.kill()
        killed.wait()
        before = counted(tmp_path)
        again = ["resume", "runs/disturbed", "--json", *remote(servers[0])]
        done = Optimizer(tmp_path, "resumed", again).done()
    finally:
        for server in servers:
            server.close()
    assert TRIALS < before < TRIALS + ASSESSED, "the run is over too early for this test"
    assert counted(tmp_path) == TRIALS + ASSESSED, "a recorded trial was evaluated again"
    assert done["history_hash"] == ALONE
    assert done["assessment_hash"] == ASSESSED_ALONE
    assert done["champion"]["seeds"] == ASSESSED // 4
    check_run(tmp_path / "runs" / "disturbed")


@pytest.mark.parametrize(
    ("number", "code"),
    [
        (signal.SIGINT, 130),
        pytest.param(signal.SIGTERM, 143, marks=pytest.mark.long),
        pytest.param(signal.SIGHUP, 143, marks=pytest.mark.long),
    ],
)
def test_a_stopped_optimizer_prints_how_to_resume(
    tmp_path: Path, number: int, code: int
) -> None:
    for _ in range(20):
        stopped = run(tmp_path, "stopped", "--servers", "local")
        wait_until(lambda: counted(tmp_path) > 0, "some trials are counted")
        stopped.kill(number)
        if stopped.wait() != 0:
            break
        # On a busy machine it had ended before.
        shutil.rmtree(tmp_path / "runs")
    assert stopped.wait() == code
    assert "zswarm-ot resume runs/disturbed" in stopped.err.read_text()
    assert "Traceback" not in stopped.err.read_text()
    # A picture, if a generation was finished.
    (tmp_path / "runs" / "disturbed" / "fitness.png").unlink(missing_ok=True)
    arguments = ["resume", "runs/disturbed", "--json", "--servers", "local"]
    done = Optimizer(tmp_path, "resumed", arguments, picture=True).done()
    assert done["history_hash"] == ALONE
    assert counted(tmp_path) == TRIALS + ASSESSED
    assert check_run(tmp_path / "runs" / "disturbed").history_hash == ALONE
    # Another program draws it.
    picture = tmp_path / "runs" / "disturbed" / "fitness.png"
    wait_until(picture.is_file, "the picture is drawn")


@pytest.mark.long
def test_two_optimizers_of_one_user_share_the_servers_and_both_finish(
    tmp_path: Path,
) -> None:
    folders = [tmp_path / "one", tmp_path / "two"]
    for folder in folders:
        folder.mkdir()
    servers = [
        Server(tmp_path, f"ss-{number}", capacity=1).ready() for number in range(2)
    ]
    optimizers = [run(folder, "ot", *remote(*servers, wait=1)) for folder in folders]
    try:
        hashes = [optimizer.done()["history_hash"] for optimizer in optimizers]
    finally:
        for program in (*servers, *optimizers):
            program.close()
    assert hashes == [ALONE, ALONE]
    assert [
        check_run(folder / "runs" / "disturbed").history_hash for folder in folders
    ] == hashes


@pytest.mark.long
def test_runs_that_share_one_slot_all_end(tmp_path: Path) -> None:
    server = Server(tmp_path, "ss", capacity=1).ready()
    folders = [tmp_path / name for name in ("first", "second", "third")]
    optimizers: list[Optimizer] = []
    try:
        for folder in folders:
            folder.mkdir()
            short = ["--set", "generations=2", "--set", "problem.trials=5"]
            optimizers.append(run(folder, "ot", *remote(server), *short))
        hashes = {optimizer.done()["history_hash"] for optimizer in optimizers}
    finally:
        for program in (server, *optimizers):
            program.close()
    assert len(hashes) == 1
    assert len(server.events("lease_granted")) == 3


@pytest.mark.long
def test_a_drained_server_finishes_running_work_and_exits(tmp_path: Path) -> None:
    servers = [Server(tmp_path, f"ss-{number}") for number in range(2)]
    optimizer = run(tmp_path, "ot", *remote(*[server.ready() for server in servers]))
    try:
        wait_until(lambda: counted(tmp_path) > 100, "some trials are counted")
        servers[0].kill(signal.SIGTERM)
        assert servers[0].wait() == 143
        assert [event["event"] for event in servers[0].events("server_stopped")] == [
            "server_stopped"
        ]
        assert not servers[0].events("drain_cut_short")
        assert optimizer.done()["history_hash"] == ALONE
    finally:
        for program in (*servers, optimizer):
            program.close()
    assert check_run(tmp_path / "runs" / "disturbed").history_hash == ALONE


@pytest.mark.long
def test_fresh_seeds_and_local_slots_give_the_same_for_any_number_of_slots(
    tmp_path: Path,
) -> None:
    small = [
        "--set",
        "problem.seeds=fresh",
        "--set",
        "problem.settings.seed=-1",
        "--servers",
        "local",
    ]
    hashes = set()
    for slots in (1, 3):
        options = [
            *small,
            "--set",
            f"cluster.local_slots={slots}",
            "--out",
            f"out-{slots}",
        ]
        file = evacuation.write(tmp_path, "disturbed", 50)
        compiled = {"ZSWARM_PLAIN": ""}
        arguments = ["run", file, "--json", *options]
        optimizer = Optimizer(tmp_path, f"slots-{slots}", arguments, **compiled)
        hashes.add(optimizer.done()["history_hash"])
        check_run(tmp_path / f"out-{slots}" / "disturbed")
    assert len(hashes) == 1
