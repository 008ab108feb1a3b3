"""SIGKILL and SIGSTOP of any process in the middle of a batch keep the history."""

import os
import shutil
import signal
from pathlib import Path

import pytest

from tests.integration.paced import Scene, Size, Undisturbed, play_undisturbed
from tests.integration.programs import status, wait_until

pytestmark = pytest.mark.faults


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_trials_of_a_killed_or_stopped_server_move_to_another(
    scene: Scene, undisturbed: Undisturbed, number: int
) -> None:
    victim, pace = scene.server("victim")
    other, _ = scene.server("other")
    pace.arm()
    optimizer = scene.optimizer(victim.endpoint, other.endpoint)
    pace.held()
    if number == signal.SIGKILL:
        victim.kill()
    else:
        scene.stop(victim.process.pid)
    done = optimizer.done()
    scene.check(done, undisturbed)
    # Trials of a server that stands still are started again before it is taken for gone.
    assert done["requeued"] + scene.second_starts() > 0
    # The run may be done before a stopped server is taken for gone.
    least = 1 if number == signal.SIGKILL else 0
    assert least <= len(scene.events("server_left", "victim")) <= 1
    assert not scene.events("fault"), "the server is to blame, no trial is"
    assert "victim-" in optimizer.err.read_text()


def test_a_stopped_server_that_resumes_is_used_again(
    scene: Scene, undisturbed: Undisturbed
) -> None:
    victim, pace = scene.server("victim")
    other, others_pace = scene.server("other")
    pace.arm()
    others_pace.arm()  # so that work is left for when the victim is back
    optimizer = scene.optimizer(victim.endpoint, other.endpoint)
    pace.held()
    others_pace.held()
    scene.stop(victim.process.pid)
    wait_until(
        lambda: scene.events("server_left", "victim"),
        "the stopped server is taken for gone",
    )
    scene.go_on(victim.process.pid)
    pace.let_go()
    scene.wait_for_more("victim")
    others_pace.let_go()
    scene.check(optimizer.done(), undisturbed)
    assert victim.process.poll() is None


def test_a_killed_slot_costs_one_trial_one_attempt(
    scene: Scene, undisturbed: Undisturbed
) -> None:
    server, pace = scene.server("ss", capacity=2)
    pace.arm()
    optimizer = scene.optimizer(server.endpoint)
    held = pace.held()
    os.kill(held, signal.SIGKILL)
    pace.let_go()
    scene.check(optimizer.done(), undisturbed)
    faults = scene.events("fault")
    assert len(faults) == 1
    assert faults[0].startswith(
        "crashed: simulator paced: the slot's process was killed by signal 9 ("
    )
    assert faults[0].endswith(", attempt 1)")
    assert len(server.workers()) == 2, "the slot has a new process"


def test_a_stopped_slot_is_killed_at_the_trials_timeout_and_blames_one_trial(
    scene: Scene, undisturbed: Undisturbed
) -> None:
    scene.size = scene.size._replace(trial_timeout_s=3.0)
    server, pace = scene.server("ss", capacity=2)
    pace.arm()
    optimizer = scene.optimizer(server.endpoint)
    held = pace.held()
    scene.stop(held)
    pace.let_go()
    scene.check(optimizer.done(), undisturbed)
    assert status(held) is None, "a stopped process was left behind"
    faults = scene.events("fault")
    assert len(faults) == 1
    assert faults[0].startswith(
        "timeout: simulator paced: one trial took longer than 3 s (cluster.trial_timeout_s) (trial "
    )
    assert [event["kind"] for event in server.events("slot_died")] == ["timeout"]


def test_a_slot_that_was_stopped_for_less_than_the_timeout_costs_nothing(
    scene: Scene, undisturbed: Undisturbed
) -> None:
    server, pace = scene.server("ss", capacity=2)
    pace.arm()
    optimizer = scene.optimizer(server.endpoint)
    held = pace.held()
    scene.stop(held)
    pace.let_go()
    scene.wait_for_more(more=5)  # of the other slot
    scene.go_on(held)
    done = optimizer.done()
    scene.check(done, undisturbed)
    assert done["requeued"] == 0
    assert len(pace.played()) == undisturbed.trials, "a trial was played twice"


def test_a_stopped_slot_that_is_sent_megabytes_does_not_stop_its_server(
    tmp_path: Path,
) -> None:
    """Its trial times out, the other slot continues, and the server can be drained."""
    size = Size(generations=2, population=8, trials=1, hidden=500, compiled=True)
    undisturbed = play_undisturbed(tmp_path, size)
    folder = tmp_path / "scene"
    folder.mkdir()
    with Scene(folder, size._replace(trial_timeout_s=3.0)) as scene:
        server, pace = scene.server("ss", capacity=2)
        pace.set(0.05, "busy")
        pace.arm()
        optimizer = scene.optimizer(server.endpoint)
        held = pace.held()
        (idle,) = set(server.workers()) - {held}
        wait_until(
            lambda: idle in {one.process for one in pace.played()}, "the other has work"
        )
        states: list[bool] = []

        def idles() -> bool:
            states.append((found := status(idle)) is not None and found.state == "S")
            return len(states) > 20 and all(states[-20:])

        wait_until(idles, "the other slot waits for work")
        scene.stop(idle)
        pace.let_go()
        wait_until(lambda: server.events("slot_died"), "its next trial times out", 60.0)
        assert [event["kind"] for event in server.events("slot_died")] == ["timeout"]
        scene.check(optimizer.done(), undisturbed)
        assert status(idle) is None
        (stopped, _) = server.workers()
        scene.stop(stopped)
        server.kill(signal.SIGTERM)
        assert server.wait() == 128 + signal.SIGTERM


def test_nothing_outlives_a_killed_server(scene: Scene) -> None:
    """Neither its fork server, although that is stopped, nor its slots, although they compute."""
    server, pace = scene.server("ss", capacity=2)
    pace.arm()
    scene.optimizer(server.endpoint)
    pace.held()
    pace.set(600.0)
    pace.let_go()
    forking, workers = server.fork_server(), server.workers()
    scene.stop(forking)
    assert len(workers) == 2
    server.kill()
    server.wait()
    wait_until(lambda: not any(map(status, [forking, *workers])), "nothing is left", 30.0)


def test_slots_of_a_killed_fork_server_end_and_are_replaced(
    scene: Scene, undisturbed: Undisturbed
) -> None:
    server, pace = scene.server("ss", capacity=2)
    pace.arm()
    optimizer = scene.optimizer(server.endpoint)
    pace.held()
    before, workers = server.fork_server(), server.workers()
    os.kill(before, signal.SIGKILL)
    pace.let_go()
    scene.check(optimizer.done(), undisturbed)
    assert server.fork_server() != before
    assert len(server.workers()) == 2
    assert not any(map(status, workers))
    assert 1 <= len(scene.events("fault")) <= 2, "one trial of each slot that had a batch"
    assert len(server.events("server_ready")) == 1
    assert server.process.poll() is None


def test_a_stopped_fork_server_is_reported_when_a_slot_needs_a_process(
    scene: Scene, undisturbed: Undisturbed
) -> None:
    server, pace = scene.server("ss")
    other, others_pace = scene.server("other")
    pace.set(0.1)
    pace.arm()
    others_pace.arm()
    optimizer = scene.optimizer(server.endpoint, other.endpoint)
    pace.held()
    others_pace.held()
    forking = server.fork_server()
    scene.stop(forking)
    pace.let_go()
    scene.wait_for_more("ss")  # without it
    pace.arm()
    os.kill(pace.held(), signal.SIGKILL)
    pace.let_go()
    others_pace.let_go()
    scene.wait_for_more("other", 5)
    scene.go_on(forking)
    scene.check(optimizer.done(), undisturbed)
    assert len(scene.events("fault", "ss")) == 1
    assert server.process.poll() is None


def test_a_copy_that_is_resumed_takes_over_from_a_stopped_optimizer(
    scene: Scene, undisturbed: Undisturbed
) -> None:
    """The stopped program continues later: it is refused, and its record is intact."""
    server, pace = scene.server("ss", capacity=2)
    old = scene.optimizer(server.endpoint)
    wait_until(lambda: scene.counted() > 30, "some trials are counted")
    pace.arm()
    pace.held()
    scene.stop(old.process.pid)
    kept = scene.counted()
    shutil.copytree(scene.folder / "runs", scene.folder / "copied")
    pace.let_go()
    copied = scene.folder / "copied" / "paced"
    scene.check(
        scene.optimizer(server.endpoint, resume=copied).done(), undisturbed, copied
    )
    assert len(server.events("lease_taken_over")) == 1
    scene.go_on(old.process.pid)
    refusal = "refused: the run was taken over: its epoch is 1, not 0; "
    wait_until(lambda: refusal in old.err.read_text(), "it is refused")
    old.kill(signal.SIGINT)
    assert old.wait() == 130
    assert "stopped; nothing is lost. Resume with: " in old.err.read_text()
    assert "Traceback" not in old.err.read_text()
    assert kept <= scene.counted() < undisturbed.trials
    scene.check(scene.optimizer(server.endpoint, resume=scene.run).done(), undisturbed)


def test_a_second_optimizer_of_a_folder_is_refused_while_the_first_one_lives(
    scene: Scene, undisturbed: Undisturbed
) -> None:
    """Also while it is stopped; of several that follow a killed one, one continues."""
    server, pace = scene.server("ss")
    pace.arm()
    first = scene.optimizer(server.endpoint)
    pace.held()
    for stopped in (False, True):
        if stopped:
            scene.stop(first.process.pid)
        second = scene.optimizer(server.endpoint, resume=scene.run)
        assert second.wait() == 2
        assert second.err.read_text() == (
            f"zswarm-ot: {scene.run}: this run is in use by another zswarm-ot process; "
            "stop that one first\n"
        )
        assert second.out.read_text() == ""
    scene.go_on(first.process.pid)
    assert first.process.poll() is None
    first.kill()
    first.wait()
    pace.let_go()
    several = [scene.optimizer(server.endpoint, resume=scene.run) for _ in range(4)]
    codes = [optimizer.wait() for optimizer in several]
    assert codes.count(0) >= 1
    assert set(codes) <= {0, 2}
    scene.check(several[codes.index(0)].done(), undisturbed)
