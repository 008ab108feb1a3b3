"""Simulations that wait for nobody, as Stage: a stand-in for it, in a private ROS graph."""

import json
import os
import shlex
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w

from tests.robots.trials import by_policy
from tests.ros.ros_here import need
from zswarm import evaluate
from zswarm.errors import EvaluationError
from zswarm.ros.link import graph
from zswarm.ros.link.child import command
from zswarm.ros.simulation import simulation

pytestmark = pytest.mark.robots
PROGRAM = Path(__file__).parent / "stage_like.py"
STARTS = [[0.0, -1.0], [1.0, -1.0]]  # x, y
NORMAL = {"robots": 2, "interval_s": 0.1, "tick_s": 0.02, "reset_s": 0.1, "lag_s": 0.0}


@contextmanager
def running(
    folder: Path, patch: pytest.MonkeyPatch, **options: Any
) -> Iterator[dict[str, Any]]:
    """A stand-in at work; yields the settings of a simulator that drives it in a slot."""
    need("rospy")
    python = command("master", "rospy")[0]
    patch.setenv("ZSWARM_ROS", str(folder))
    patch.setenv("RUNTIME_DIRECTORY", str(folder / "locks"))
    with ExitStack() as opened:
        here = opened.enter_context(graph.private("rospy"))
        file = {"link": "rospy", "profile": "stage", "master": here.master}
        (folder / "room.toml").write_text(tomli_w.dumps(file))
        patch.setenv("ROS_MASTER_URI", here.master)
        arguments = [python, str(PROGRAM), json.dumps({**NORMAL, **options})]
        started = opened.enter_context(subprocess.Popen(arguments))
        opened.callback(started.kill)
        yield {"robots": 2, "simulation": "room", "mode": "free-running", "steps": 30}


def in_slot(settings: dict[str, Any], **more: Any) -> Any:
    return evaluate.build(
        "turtlebot-exit-ros", {**settings, **more}, "fully-meshed", {}, in_slot=True
    )[0]


@contextmanager
def launched(folder: Path, patch: pytest.MonkeyPatch, program: str) -> Iterator[Any]:
    """A file that has each slot start a program; yields settings as ``running``."""
    need("rospy")
    patch.setenv("ZSWARM_ROS", str(folder))
    file = {"link": "rospy", "profile": "stage", "launch": program}
    (folder / "room.toml").write_text(tomli_w.dumps(file))
    yield {"robots": 2, "simulation": "room", "mode": "free-running", "steps": 30}


def ahead(observations: np.ndarray) -> np.ndarray:
    """Drive straight on, at full speed."""
    return np.tile(np.float32([1.0, 0.5]), (len(observations), 1))


def test_a_trial_begins_where_the_reset_put_the_robots(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The slot of the trial before died, and its robots drive on."""
    with running(tmp_path, monkeypatch) as settings:
        stranded = in_slot(settings)
        for _ in range(2):
            stranded.reset(1)
            assert stranded.poses[:, :2].tolist() == STARTS
            for _ in range(5):
                stranded.step(ahead(stranded.poses))
            assert stranded.poses[0, 0] > 0.3
        # Its bridge ends before any robot is stopped.
        stranded.close()
        simulator = in_slot(settings)
        simulator.reset(1)
        assert simulator.poses[:, :2].tolist() == STARTS
        simulator.close()


def test_readings_of_before_the_reset_that_arrive_late_begin_no_trial(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They wait on connections, as does the clock: for longer than the slot listens."""
    with running(tmp_path, monkeypatch, lag_s=3 * simulation.LISTEN_S) as settings:
        simulator = in_slot(settings, missed_limit=1.0, steps=1000)
        for _ in range(3):
            simulator.reset(1)
            assert simulator.poses[:, :2].tolist() == STARTS
            while simulator.poses[0, 0] < 0.3:
                simulator.step(ahead(simulator.poses))
        simulator.close()


def test_a_simulation_whose_readings_arrive_too_late_is_named_as_too_fast(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with running(tmp_path, monkeypatch, lag_s=3.0) as settings:
        simulator = in_slot(settings)
        simulator.reset(1)
        simulator.close()
        simulator = in_slot(settings, deadline_s=1.0)
        with pytest.raises(
            EvaluationError,
            match=r"no scan and pose of robot 0, 1 at .* s within 1 s \(deadline_s\): scans arrive "
            r"\S+ s of the simulation late, which is too fast for this machine; slow it down",
        ):
            simulator.reset(1)


def test_no_step_is_missed_in_a_simulation_that_is_slow_enough(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with running(tmp_path, monkeypatch, tick_s=0.1) as settings:
        simulator = in_slot(settings, missed_limit=1.0)
        played = by_policy(simulator, ahead, 1)
        simulator.close()
    _, _, seconds, _, missed, rate = played.outcome.metrics
    turns = len(played.poses) - 1
    assert seconds == 6.0
    assert missed == 1 - turns / 30
    assert 0 < rate <= 1.1


def test_a_simulation_that_is_too_fast_is_a_fault(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def slow(observations: np.ndarray) -> np.ndarray:
        time.sleep(0.1)
        return ahead(observations)

    with running(tmp_path, monkeypatch, tick_s=0.001, interval_s=0.2) as settings:
        simulator = in_slot(settings)
        with pytest.raises(
            EvaluationError,
            match=r"steps passed without a decision: .* times too fast .*: slow it down",
        ):
            by_policy(simulator, slow, 1)


@pytest.mark.parametrize("step_s", [0.05, 0.15, 0.25])
def test_a_step_that_the_simulation_does_not_keep_is_refused(
    step_s: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with running(tmp_path, monkeypatch) as settings:
        simulator = in_slot(settings, step_s=step_s)
        with pytest.raises(
            EvaluationError,
            match=f"step_s is {step_s:g}, and the simulation sends scans every 0.1 s; "
            "expected a multiple of that",
        ):
            by_policy(simulator, ahead, 1)


def test_robots_that_the_world_lacks_are_named_though_others_speak_already(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(simulation, "READY_S", 5.0)
    with running(tmp_path, monkeypatch) as settings:
        simulator = in_slot(settings, robots=3)
        with pytest.raises(
            EvaluationError,
            match="no node subscribes to /robot_2/cmd_vel; "
            "no node publishes /robot_2/base_scan, /robot_2/base_pose_ground_truth after 5 s",
        ):
            simulator.reset(1)


def test_a_profile_with_another_reset_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(simulation, "READY_S", 5.0)
    with running(tmp_path, monkeypatch) as settings:
        file = tmp_path / "room.toml"
        file.write_text(file.read_text().replace('"stage"', '"stageros"'))
        simulator = in_slot(settings)
        with pytest.raises(
            EvaluationError, match="no node subscribes to /zswarm/reset after 5 s"
        ):
            simulator.reset(1)


def test_each_slot_starts_a_simulation_and_starts_it_again_when_it_died(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From the folder of the file, and with a master of its own."""
    (tmp_path / "options.json").write_text(json.dumps(NORMAL))
    python = command("master", "rospy")[0]
    started = tmp_path / "started"
    line = f'echo $$ >> {started}; exec {python} {PROGRAM} "$(cat options.json)"'
    with launched(tmp_path, monkeypatch, shlex.join(["sh", "-c", line])) as settings:
        slots = [in_slot(settings) for _ in range(2)]
        for slot in slots:
            slot.reset(1)
            assert slot.poses[:, :2].tolist() == STARTS
        first, second = map(int, started.read_text().split())
        os.kill(first, signal.SIGKILL)
        with pytest.raises(
            EvaluationError, match="the simulation was killed by signal 9"
        ):
            by_policy(slots[0], ahead, 1)
        slots[1].reset(2)
        slots[0].reset(1)
        assert slots[0].poses[:, :2].tolist() == STARTS
        for slot in slots:
            slot.close()
        third = int(started.read_text().split()[2])
        assert not any(Path(f"/proc/{one}").exists() for one in (first, second, third))


@pytest.mark.parametrize(
    ("program", "said"),
    [
        ("no-such-stage room.world", "no-such-stage cannot be started: No such file"),
        (
            "sh -c 'echo world room is missing; exit 3'",
            "the simulation ended with code 3; it wrote: world room is missing",
        ),
    ],
)
def test_a_simulation_that_does_not_start_is_named_at_once(
    program: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with launched(tmp_path, monkeypatch, program) as settings:
        simulator = in_slot(settings)
        with pytest.raises(EvaluationError, match=said):
            simulator.reset(1)
