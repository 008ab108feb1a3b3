"""The tasks of the robots that push: rules, and that they are worth evolving for."""

import subprocess
import sys
from typing import Any

import numpy as np
import pytest

from tests.sims import champions, robot_controllers
from zswarm.errors import ConfigError
from zswarm.evaluate import build, evaluate
from zswarm.kernels.random import Stream
from zswarm.sims.box_pushing import BoxPushing
from zswarm.sims.exit_fitness import cpswarm_log
from zswarm.sims.foraging_physical import ForagingPhysical
from zswarm.sims.simulator import Simulator
from zswarm.sims.turtlebot_exit import TurtlebotExit
from zswarm.testing import check_simulator

TASKS: dict[str, tuple[type[Simulator], dict[str, Any]]] = {
    "turtlebot_exit": (TurtlebotExit, {"robots": 10}),
    "box_pushing": (BoxPushing, {}),
    "foraging_physical": (ForagingPhysical, {}),
    "foraging_physical_carry": (ForagingPhysical, {"transport": "carry"}),
}
UNSEEN = np.arange(5000, 5100, dtype=np.uint64)


def made(task: str, **settings: Any) -> Any:
    simulator_class, own = TASKS[task]
    return simulator_class(simulator_class.settings_type(**own, **settings))


def by_hand(task: str, seeds: np.ndarray, controller: str = "") -> float:
    """Return the mean fitness of a handwritten controller, by default the task's namesake."""
    policy, fitness, simulator = (
        getattr(robot_controllers, controller or task),
        [],
        made(task),
    )
    for seed in seeds:
        turn = simulator.reset(int(seed))
        while turn is not None:
            turn = simulator.step(policy(turn.observations))
        fitness.append(simulator.outcome().fitness[0])
    return float(np.mean(fitness))


# ---- rules -----------------------------------------------------------------------------


@pytest.mark.parametrize("task", TASKS)
def test_the_contract_is_kept(task: str) -> None:
    simulator_class, own = TASKS[task]
    check_simulator(simulator_class, own | {"steps": 12, "robots": 4})
    simulator = made(task)
    assert simulator.reset(3).observations[0, 8:10].any(), "exit, box or puck is seen"
    frame = simulator.frame()
    assert all(
        0 <= body.x <= frame.width and 0 <= body.y <= frame.height
        for body in frame.bodies
    )


def test_a_robot_at_an_exit_leaves_and_the_others_continue() -> None:
    simulator = made("turtlebot_exit", map="open", steps=50)
    simulator.reset(1)
    poses = simulator._world.poses.copy()
    poses[0] = -2.0, 0.9, np.pi / 2
    simulator._world.start(poses, np.zeros((0, 3)))
    stay = np.full((10, 2), 0.5, np.float32)
    turn = simulator.step(stay)
    assert list(turn.agents) == list(range(1, 10))
    assert simulator.frame().bodies[0].kind == "robot that is out"
    while turn is not None:
        turn = simulator.step(stay[1:])
    outcome = simulator.outcome()
    assert outcome.metrics[0] == 1
    assert outcome.metrics[2] == pytest.approx(10.0)
    distances = np.hypot(2 - np.abs(poses[1:, 0]), poses[1:, 1] - 1)
    assert outcome.fitness[0] == pytest.approx(-0.1 - distances.sum())


def test_the_fitness_of_the_papers_logs_equals_the_papers() -> None:
    """The expected values were computed by hand from the formula."""
    assert cpswarm_log([0.1], [9]) == pytest.approx(49.9 / 50 * 100 + 90)
    assert cpswarm_log([0.1, 5.0], [9, 16]) == pytest.approx((99.8 + 90 + 90) / 2)
    assert cpswarm_log([70.0, 0.19], [1, 200]) == pytest.approx(
        (0 + 49.81 / 50 * 100) / 2
    )


def test_a_box_in_the_goal_ends_the_trial() -> None:
    simulator = made("box_pushing", steps=100)
    simulator.reset(5)
    stay = np.full((6, 2), 0.5, np.float32)
    assert simulator.step(stay) is not None
    simulator._world.start(
        np.array([(0.5 + 0.4 * robot, 0.5, 0) for robot in range(6)]),
        np.array([(4.1, 3.0, 0)]),
    )
    assert simulator.step(stay) is None
    fitness, (reached, way, seconds) = simulator.outcome()
    assert fitness == [pytest.approx(1.98)]
    assert (reached, way, seconds) == (
        1,
        pytest.approx(4.1 - simulator._from),
        pytest.approx(0.4),
    )


def test_a_held_puck_is_carried_home_and_held_by_no_other_robot() -> None:
    simulator = made("foraging_physical_carry", pucks=1, robots=2)
    simulator.reset(1)
    simulator._from[0] = 2.0
    simulator._world.start(
        np.array([(1.6, 2.0, 0), (2.0, 2.4, -np.pi / 2)]), np.array([(2.0, 2.0, 0)])
    )
    ahead, back = (
        np.array([[0.7, 0.5]] * 2, np.float32),
        np.array([[0.0, 0.5], [0.5, 0.5]], np.float32),
    )
    turn = simulator.step(ahead)
    while not turn.observations[:, 13].any():
        turn = simulator.step(ahead)
    assert turn.observations[:, 13].sum() == 1, "one of the two"
    assert not turn.observations[:, 8:11].any(), "the only puck is held"
    holder = int(turn.observations[:, 13].argmax())
    assert simulator.frame().bodies[holder].kind == "robot with a puck"
    if holder == 1:
        back[0], back[1] = 0.5, (0.5, 0.5)
    for _ in range(60):
        if turn is not None:
            turn = simulator.step(back)
    assert turn is None or holder == 1
    assert holder == 1 or simulator.outcome().metrics[0] == 1


FIRST_AND_LAST = """
import sys
import numpy as np
from zswarm.kernels.random import Stream
from zswarm.evaluate import build, evaluate
simulator, network = build(sys.argv[1], {"steps": 30} | eval(sys.argv[2]), "fully-meshed", {})
genomes = network.random(7, Stream(3))
seeds = np.append(np.arange(200), 0).astype(np.uint64)
numbers = evaluate(simulator, network, genomes, (np.arange(201) % 200 % 7)[:, None], seeds)
first, last = [(numbers.fitness[row].tobytes(), numbers.metrics[row].tobytes()) for row in (0, -1)]
assert first == last
assert len(np.unique(numbers.fitness)) > 20
"""


@pytest.mark.long
@pytest.mark.parametrize("task", TASKS)
def test_a_processs_first_trial_and_one_after_200_others_are_the_same(task: str) -> None:
    """Contacts are solved in the same order in both.

    pymunk numbers shapes consecutively and stores contacts by address; neither affects the order.
    """
    name, own = task.removesuffix("_carry").replace("_", "-"), TASKS[task][1]
    done = subprocess.run(
        [sys.executable, "-c", FIRST_AND_LAST, name, repr(own)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("name", "settings", "text"),
    [
        (
            "turtlebot-exit",
            {"robots": 100},
            "turtlebot-exit: 100 robots of radius 0.177 do not fit in the 6 m2 where they start",
        ),
        (
            "turtlebot-exit",
            {"radius": 2.0},
            "turtlebot-exit: robots of radius 2 do not fit in the room",
        ),
        ("turtlebot-exit", {"map": "maze"}, "problem.settings: map: "),
        ("turtlebot-exit", {"rays": 7}, "problem.settings: rays: expected int >= 8"),
        ("turtlebot-exit", {"mass": 0.0}, "problem.settings: mass: "),
        (
            "box-pushing",
            {"box": 3.0},
            "box-pushing: a box of side 3 does not turn freely in a room of side 5",
        ),
        (
            "box-pushing",
            {"goal": 4.0},
            "box-pushing: goal 4 must be between half of the box and .55 side, 0.3 and 2.75",
        ),
        (
            "box-pushing",
            {"robots": 150},
            "box-pushing: 156 robots beside the box of radius 0.177 do not fit",
        ),
        (
            "foraging-physical",
            {"pucks": 100},
            "foraging-physical: 100 pucks of radius 0.1 do not fit in the",
        ),
        (
            "foraging-physical",
            {"nest": 0.15},
            "foraging-physical: a puck of radius 0.1 does not fit in a nest 0.15 wide",
        ),
        (
            "foraging-physical",
            {"nest": 3.9},
            "foraging-physical: pucks of radius 0.1 do not fit in the room",
        ),
        ("foraging-physical", {"step_s": 0.0}, "problem.settings: step_s: "),
    ],
)
def test_impossible_settings_are_refused_in_one_clear_line(
    name: str, settings: dict[str, Any], text: str
) -> None:
    with pytest.raises(ConfigError) as refusal:
        build(name, settings, "fully-meshed", {})
    assert str(refusal.value).startswith(text)
    assert "\n" not in str(refusal.value)


# ---- benefit of evolution --------------------------------------------------------------


@pytest.mark.parametrize(
    ("task", "bad", "good"),
    [
        ("turtlebot_exit", -17, -16),
        ("box_pushing", 0.2, 1.0),
        ("foraging_physical", 0.15, 0.3),
        ("foraging_physical_carry", 0.1, 0.8),
    ],
)
def test_random_controllers_do_badly_and_one_written_by_hand_does_better(
    task: str, bad: float, good: float
) -> None:
    name = task.removesuffix("_carry").replace("_", "-")
    simulator, network = build(
        name, TASKS[task][1], "fully-meshed", {"activation": "tanh", "iterations": 1}
    )
    genomes = network.random(20, Stream(3))
    fitness = evaluate(
        simulator, network, genomes, np.arange(20)[:, None], np.resize(UNSEEN[:2], 20)
    ).fitness
    assert fitness.mean() < bad
    assert by_hand(task, UNSEEN[:4]) > good


@pytest.mark.parametrize(
    ("task", "good"), [("box_pushing", 1.6), ("foraging_physical", 0.9)]
)
def test_a_better_handwritten_controller_scores_higher(task: str, good: float) -> None:
    assert by_hand(task, UNSEEN[:4], f"clever_{task}") > good


def does_better_than_by_hand(example: str, genome: bytes, between: float) -> None:
    """Check on unseen seeds that a fitness lies between those of the two controllers."""
    unseen = champions.on_seeds(champions.problem(example), genome, UNSEEN)
    task = example.split(" ")[0].replace("-", "_")
    assert by_hand(task, UNSEEN) < between < unseen.fitness.mean()
    if task == "turtlebot_exit":
        escaped, _, seconds = unseen.metrics.mean(axis=0)
        assert escaped > 9.4
        assert 22 < seconds < 31


@pytest.mark.long
@pytest.mark.parametrize(
    ("example", "between"),
    [
        ("box-pushing", 1.52),
        ("box-pushing seed=2", 1.52),
        ("box-pushing seed=3", 1.52),
        ("foraging-physical", 0.82),
    ],
)
def test_the_recorded_champion_is_better_than_the_controller_written_by_hand(
    example: str, between: float
) -> None:
    """In box pushing, champions reach 1.58, 1.57 and 1.61, the controller written by hand 1.46."""
    does_better_than_by_hand(example, champions.champion(example), between)


@pytest.mark.parametrize(
    ("example", "between"),
    [
        pytest.param("turtlebot-exit generations=13", -10, marks=pytest.mark.long),
        pytest.param("turtlebot-exit", -10, marks=pytest.mark.thorough),
        pytest.param("foraging-physical generations=18", 0.82, marks=pytest.mark.long),
        pytest.param("foraging-physical", 0.82, marks=pytest.mark.thorough),
    ],
)
def test_the_example_evolves_a_better_controller_than_the_one_written_by_hand(
    example: str, between: float
) -> None:
    """Evolve it here: its bits depend on the processor and on the release of pymunk."""
    does_better_than_by_hand(example, champions.evolve(example), between)
