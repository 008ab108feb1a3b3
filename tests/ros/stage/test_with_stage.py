"""The real Stage: where trials begin, what they are, and what is said of one that is too fast."""

import os
import re
import time
from pathlib import Path

import numpy as np
import pytest

from tests.robots.trials import built, by_network, by_policy
from tests.ros.stage import stage_here
from tests.sims import robot_controllers
from zswarm.errors import EvaluationError

pytestmark = pytest.mark.stage
ROOM = {"robots": 3, "map": "open", "epsilon": 0.6}
STEP = "lockstep 0.2"
DEADLINE_S = 300.0  # at full speed Stage sends more than a loaded machine takes
RESETS = int(os.environ.get("RESETS", "10"))


def starts() -> np.ndarray:
    """Return the poses at which a world made for seed 1 has the robots."""
    own = built("turtlebot-exit", **ROOM)
    own.reset(1)
    return own.poses.copy()


def apart(poses: np.ndarray) -> float:
    """Return the largest difference from the starts; of a quaternion the sign is no difference."""
    expected = starts()
    turned = np.sign((poses[:, 2:] * expected[:, 2:]).sum(axis=1))
    expected[:, 2:] *= turned[:, None]
    return float(abs(poses - expected).max())


@pytest.mark.parametrize("controller", [STEP, "throttle 5", "throttle 40", ""])
def test_every_trial_begins_at_the_starts_of_the_world(
    controller: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At rest, though robots were driving when the trial before ended."""
    with stage_here.running(tmp_path, monkeypatch, controller, **ROOM) as stage:
        simulator = stage.in_slot(
            missed_limit=1.0, deadline_s=DEADLINE_S, steps=1_000_000
        )
        for _ in range(3):
            simulator.reset(9)
            assert apart(simulator.poses) < 1e-3
            while apart(simulator.poses) < 0.1:  # at full speed, readings arrive late
                simulator.step(np.full((len(simulator.task.agents), 2), 0.9, np.float32))
        simulator.close()


def test_trials_in_lock_step_repeat_to_the_last_bit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second in a Stage whose slot died in a trial; the last in another Stage."""
    bits = []
    with stage_here.running(tmp_path, monkeypatch, STEP, **ROOM) as stage:
        simulator = stage.in_slot()
        bits.append(by_network(simulator, 6).bits)
        simulator.reset(1)
        simulator.step(np.ones((3, 2), np.float32))
        simulator.close()
        simulator = stage.in_slot()
        bits += [by_network(simulator, 6).bits, by_network(simulator, 6).bits]
        simulator.close()
    with stage_here.running(tmp_path, monkeypatch, STEP, **ROOM) as stage:
        simulator = stage.in_slot()
        bits.append(by_network(simulator, 6).bits)
        simulator.close()
    assert len(set(bits)) == 1


def test_robots_leave_the_room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with stage_here.running(tmp_path, monkeypatch, STEP, **ROOM) as stage:
        simulator = stage.in_slot()
        played = by_policy(simulator, robot_controllers.turtlebot_exit, 1)
        simulator.close()
    escaped, _, _, *of_running = played.outcome.metrics
    assert escaped >= 1
    assert of_running == [0.0, 0.0, 0.0]


def test_stage_at_full_speed_is_too_fast(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with stage_here.running(tmp_path, monkeypatch, "", **ROOM) as stage:
        simulator = stage.in_slot(missed_limit=0.0)
        with pytest.raises(EvaluationError, match=r"times too fast .*: slow it down"):
            by_policy(simulator, robot_controllers.turtlebot_exit, 1)


def test_the_throttle_finds_what_the_robots_keep_up_with_and_tells_it(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    """They take 0.1 s for an answer, so twice that for a step: real time, or less."""

    def slow(observations: np.ndarray) -> np.ndarray:
        time.sleep(0.1)
        return robot_controllers.turtlebot_exit(observations)

    with stage_here.running(tmp_path, monkeypatch, "throttle auto 0.2", **ROOM) as stage:
        simulator = stage.in_slot(steps=40, missed_limit=0.5)
        *_, rate = [by_policy(simulator, slow, 1).outcome.metrics[-1] for _ in range(2)]
        simulator.close()
        said = (tmp_path / "stage.log").read_text()
    rates = re.findall(
        r"^throttle: (\S+) times real time: robots answer within (\S+) s$", said, re.M
    )
    assert rates, said
    assert float(rates[-1][0]) <= 1.0
    assert float(rates[-1][1]) >= 0.1
    told = re.findall(
        r"^simulation 'stage' runs at (\S+) times real time$",
        capfd.readouterr().err,
        re.M,
    )
    assert rate / 1.3 < float(told[-1]) < rate * 1.3, "a quarter, and two digits"


def test_a_step_that_stage_does_not_keep_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with stage_here.running(tmp_path, monkeypatch, "throttle 5", **ROOM) as stage:
        simulator = stage.in_slot(step_s=0.15)
        with pytest.raises(
            EvaluationError, match=r"step_s is 0\.15, and .* scans every 0\.1 s"
        ):
            by_policy(simulator, robot_controllers.turtlebot_exit, 1)


def test_a_stage_that_ended_is_a_fault(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with stage_here.running(tmp_path, monkeypatch, STEP, **ROOM) as stage:
        simulator = stage.in_slot(deadline_s=1.0)
        simulator.reset(1)
        stage.process.kill()
        stage.process.wait()
        with pytest.raises(EvaluationError, match=r"no scan and pose of robot 0, 1, 2"):
            simulator.step(np.full((3, 2), 0.9, np.float32))


@pytest.mark.parametrize("controller", [STEP, ""])
def test_resets_at_full_speed_are_survived(
    controller: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And exact: readings of before a reset, which arrive later, begin no trial.

    stageros 1.8.0, without the patch, ends after some tens of resets.
    """
    with stage_here.running(tmp_path, monkeypatch, controller, **ROOM) as stage:
        simulator = stage.in_slot(missed_limit=1.0, deadline_s=DEADLINE_S)
        worst = 0.0
        for seed in range(RESETS):
            simulator.reset(seed)
            worst = max(worst, apart(simulator.poses))
            simulator.step(np.full((len(simulator.task.agents), 2), 0.9, np.float32))
        simulator.close()
        assert stage.process.poll() is None
        assert worst < 1e-3
