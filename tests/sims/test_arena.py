"""Compare arena with a naive implementation of its reference.

Also check its world, and that evolution is worthwhile for its tasks.
"""

from typing import Any

import numpy as np
import pytest

from tests.sims import arena_controllers, champions
from tests.sims.naive_arena import NaiveArena
from zswarm.errors import ConfigError
from zswarm.evaluate import TrialOutcomes, build, evaluate
from zswarm.kernels.random import Stream
from zswarm.nets.fully_meshed import FullyMeshed
from zswarm.sims.arena import Arena, ArenaSettings
from zswarm.sims.arena_tasks import TASKS
from zswarm.sims.arena_world import HEADING_X, HEADING_Y, SAID, X, Y
from zswarm.testing import check_simulator

UNUSUAL: list[dict[str, Any]] = [
    *({"task": task} for task in TASKS),
    # 6 x 6 cells.
    {
        "task": "consensus",
        "robots": 40,
        "side": 7.0,
        "sight": 1.1,
        "noise": 0.0,
        "steps": 12,
    },
    # 5 x 5 cells, many overlap.
    {
        "task": "dispersion",
        "robots": 30,
        "side": 3.0,
        "sight": 0.5,
        "radius": 0.2,
        "steps": 12,
    },
    {
        "task": "foraging",
        "robots": 5,
        "side": 1.0,
        "sight": 3.0,
        "items": 40,
        "nest": 0.2,
        "speed": 2.0,
        "step_s": 1.0,
    },
    {"robots": 1, "steps": 1},
    {"robots": 2, "side": 0.3, "sight": 0.2, "steps": 30},
]
UNSEEN = np.arange(10**9, 10**9 + 40, dtype=np.uint64)


def built(settings: dict[str, Any], **network: Any) -> tuple[Arena, FullyMeshed]:
    simulator, controller = build(
        "arena", settings, "fully-meshed", {"hidden": 3, **network}
    )
    assert isinstance(simulator, Arena)
    assert isinstance(controller, FullyMeshed)
    return simulator, controller


def play(
    simulator: Arena, network: FullyMeshed, genomes: list[bytes], seeds: np.ndarray
) -> TrialOutcomes:
    """Play every genome on every seed."""
    participants = np.repeat(np.arange(len(genomes)), len(seeds))[:, None]
    return evaluate(
        simulator, network, genomes, participants, np.tile(seeds, len(genomes))
    )


def drive(
    simulator: Arena, seed: int, actions: list[float], steps: int = 10**6
) -> list[np.ndarray]:
    """The robots' table after each step when all do the same."""
    turn, tables = simulator.reset(seed), []
    while turn is not None and len(tables) < steps:
        turn = simulator.step(
            np.tile(np.float32(actions), (simulator.settings.robots, 1))
        )
        tables.append(simulator.world.robots[:, : simulator.settings.robots].copy())
    return tables


def put(
    simulator: Arena,
    *places: tuple[float, float],
    heading: tuple[float, float] = (1.0, 0.0),
) -> np.ndarray:
    """Put robots somewhere; what they observe there."""
    simulator.reset(1)
    table = simulator.world.robots[:, : simulator.settings.robots]
    table[X], table[Y] = np.float32(places).T
    table[HEADING_X], table[HEADING_Y] = heading
    return simulator._turn().observations


# ---- reference -------------------------------------------------------------------------


@pytest.mark.parametrize("settings", UNUSUAL, ids=str)
def test_the_kernel_agrees_with_a_naive_reference_bit_for_bit(
    settings: dict[str, Any],
) -> None:
    simulator, network = built({"steps": 30, **settings})
    genomes, seeds = network.random(2, Stream(7)), np.array([3, 2**64 - 1], np.uint64)
    outcomes = evaluate(simulator, network, genomes, np.array([[0], [1]]), seeds)
    for trial, parameters in enumerate(network.parameters(genomes)):
        states = np.zeros((simulator.settings.robots, network.state_size), np.float32)

        def decide(
            robot: int, observation: np.ndarray, states=states, parameters=parameters
        ) -> np.ndarray:
            action = np.empty(simulator.outputs, np.float32)
            network.step(parameters, states[robot], observation, action)
            return action

        expected = NaiveArena(simulator.settings, int(seeds[trial])).play(decide)
        assert (outcomes.fitness[trial, 0], *outcomes.metrics[trial]) == expected


@pytest.mark.parametrize("task", TASKS)
def test_observations_agree_with_the_naive_reference_at_every_step(task: str) -> None:
    settings = ArenaSettings(task=task, steps=100, robots=8, side=2.0)  # type: ignore[arg-type]
    simulator, naive, policy = (
        Arena(settings),
        NaiveArena(settings, 11),
        getattr(arena_controllers, task),
    )
    turn = simulator.reset(11)
    observations = []
    while turn is not None:
        observations.append(turn.observations)
        turn = simulator.step(policy(turn.observations))
    naive.play(lambda robot, _: policy(naive.observations[-1])[robot])
    assert np.array(observations).tobytes() == np.array(naive.observations).tobytes()
    outcome = simulator.outcome()
    assert (*outcome.fitness, *outcome.metrics) == naive.outcome()
    if task == "foraging":
        assert naive.delivered, "items were brought home"


@pytest.mark.parametrize("task", TASKS)
def test_turns_and_kernel_keep_the_contract(task: str) -> None:
    check_simulator(Arena, {"task": task, "steps": 40, "robots": 12})
    simulator = Arena(ArenaSettings(task=task))  # type: ignore[arg-type]
    assert simulator.metrics == TASKS[task].metrics
    assert len(simulator.sensors) == simulator.inputs


def test_the_frame_shows_robots_items_and_the_nest() -> None:
    simulator = Arena(ArenaSettings(task="foraging", items=3))
    simulator.reset(4)
    frame = simulator.frame()
    assert [place[:] for place in frame.places] == [("nest", 0, 0, 0.5, 4.0)]
    assert [body.kind for body in frame.bodies] == ["robot"] * 16 + ["item"] * 3
    assert all(body.x > 0.5 for body in frame.bodies[16:]), "items lie outside the nest"


# ---- world -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    "actions",
    [[1, 1], [1, 0.9], [0, 0], [np.nan, np.inf], [-np.inf, 1e30], [0.3, np.nan]],
)
def test_no_controller_moves_a_robot_out_of_the_room_or_breaks_its_heading(
    actions: list[float],
) -> None:
    simulator = Arena(ArenaSettings(robots=30, steps=300, side=3.0))
    for table in drive(simulator, 5, actions):
        assert (table[:2] >= np.float32(0.1)).all()
        assert (table[:2] <= np.float32(3) - np.float32(0.1)).all()
        np.testing.assert_allclose(
            np.hypot(table[HEADING_X], table[HEADING_Y]), 1, atol=1e-6
        )


def test_robots_that_stand_still_come_apart_until_none_overlaps_by_a_hundredth() -> None:
    simulator = Arena(ArenaSettings(robots=30, steps=200, side=3.0))
    simulator.reset(3)
    table = simulator.world.robots[:, :30]
    table[X : Y + 1] = np.float32(1.4) + table[X : Y + 1] / 20  # all within 15 cm
    actions = np.full((30, 2), 0.5, np.float32)
    while simulator.step(actions) is not None:
        pass
    x, y = table[X], table[Y]
    apart = np.hypot(x[:, None] - x, y[:, None] - y)[~np.eye(30, dtype=bool)]
    assert apart.min() > 0.2 - 0.002


def test_wheels_move_a_robot_as_its_speed_says() -> None:
    simulator = Arena(
        ArenaSettings(robots=1, side=100.0, speed=0.5, step_s=0.2, steps=100)
    )
    put(simulator, (50, 50))
    simulator.step(np.float32([[1, 1]]))
    assert simulator.world.robots[X, 0] - 50 == pytest.approx(0.1, abs=1e-5)
    put(simulator, (50, 50))
    # Wheels 0.2 m apart, one at 0.5 m/s, one at rest: 2.5 rad/s, or about 0.5 rad per step, which
    # the kernel approximates by tangents.
    for _ in range(100):
        simulator.step(np.float32([[0.5, 1]]))
    angle = 2 * np.arctan(0.25) * 100
    assert (
        np.hypot(simulator.world.robots[X, 0] - 50, simulator.world.robots[Y, 0] - 50)
        < 0.25
    )
    np.testing.assert_allclose(
        simulator.world.robots[HEADING_X : HEADING_Y + 1, 0],
        [np.cos(angle), np.sin(angle)],
        atol=1e-4,
    )


def test_rays_see_only_the_nearest_body() -> None:
    simulator = Arena(ArenaSettings(robots=3, side=4.0, sight=2.5))
    near, far = 1 - 0.9 / 2.5, 1 - 1.0 / 2.5
    # Robots in a row, looking along it.
    seen = put(simulator, (1.0, 2.0), (2.0, 2.0), (2.6, 2.0))
    # The middle robot's rim; the wall behind.
    np.testing.assert_allclose(seen[0, [0, 4]], [near, far], rtol=1e-5)
    np.testing.assert_allclose(
        seen[1, [0, 2, 4, 6]], [1 - 0.5 / 2.5, 0.2, near, 0.2], rtol=1e-5
    )
    np.testing.assert_allclose(seen[2, 0], 1 - 1.4 / 2.5, rtol=1e-5)  # the wall
    # All turned by 90 degrees.
    turned = put(simulator, (1.0, 2.0), (2.0, 2.0), (2.6, 2.0), heading=(0.0, 1.0))
    np.testing.assert_allclose(np.roll(turned[:, :8], 2, axis=1), seen[:, :8], atol=1e-6)
    np.testing.assert_allclose(seen[0, 8:10], [1.3 / 2.5, 0], atol=1e-6)
    np.testing.assert_allclose(turned[0, 8:10], [0, -1.3 / 2.5], atol=1e-6)


def test_a_diagonal_ray_measures_the_distance_to_a_corner() -> None:
    seen = put(Arena(ArenaSettings(robots=1, side=4.0, sight=3.0)), (3.0, 3.0))
    np.testing.assert_allclose(seen[0, 1], 1 - np.sqrt(2) / 3, rtol=1e-5)
    np.testing.assert_allclose(seen[0, 5], 0, atol=1e-6)


def test_messages_reach_only_neighbours_one_step_later() -> None:
    simulator = Arena(ArenaSettings(task="consensus", robots=3, side=9.0, sight=2.0))
    put(simulator, (1.0, 1.0), (2.9, 1.0), (4.8, 1.0))
    simulator.world.robots[SAID] = 0
    stay = np.full((3, 3), 0.5, np.float32)
    stay[:, 2] = [0.25, 0.5, 0.75]
    turn = simulator.step(stay)
    assert turn is not None
    # The middle one hears .25 and .75.
    np.testing.assert_array_equal(turn.observations[:, 11], np.float32([0.5, 0.5, 0.5]))
    stay[:, 2] = [1, 0, 0]
    assert simulator.step(stay).observations[:, 11].tolist() == [0, 0.5, 0]
    simulator = Arena(ArenaSettings(task="consensus", robots=2, side=9.0, sight=2.0))
    put(simulator, (1.0, 1.0), (3.1, 1.0))
    assert simulator.step(np.float32([[0.5, 0.5, 0.25], [0.5, 0.5, 1]])).observations[
        :, 11
    ].tolist() == [0.25, 1]


def test_an_item_is_found_carried_and_delivered_once() -> None:
    simulator = Arena(ArenaSettings(task="foraging", robots=1, items=1, side=4.0))
    put(simulator, (0.75, 1.0), heading=(-1.0, 0.0))
    simulator.world.items[:, 0] = 0.75, 1.0
    found = simulator.step(np.full((1, 2), 0.5, np.float32))
    assert found.observations[0, 14] == 1
    assert simulator.world.items[0, 0] != np.float32(0.75), "another appeared elsewhere"
    assert simulator.frame().bodies[0].kind == "robot with an item"
    simulator.world.items[:, 0] = 3.5, 3.5
    carried = [
        simulator.step(np.ones((1, 2), np.float32)).observations[0, 14] for _ in range(12)
    ]
    assert carried == [1] * carried.count(1) + [0] * carried.count(0)
    assert 0 < carried.count(0) < 12
    while simulator.step(np.full((1, 2), 0.5, np.float32)) is not None:
        pass
    assert simulator.outcome() == ([1.0], [1.0, 1.0, 0.0])


def test_a_room_of_a_thousand_robots_is_played() -> None:
    simulator, network = built({"robots": 1000, "side": 32.0, "steps": 3})
    assert np.isfinite(
        play(simulator, network, network.random(1, Stream(2)), UNSEEN[:1]).fitness
    ).all()


# ---- tasks -----------------------------------------------------------------------------


def by_hand(task: str, seeds: np.ndarray, controller: str = "") -> float:
    """Return the mean fitness of a handwritten controller, by default the task's namesake."""
    policy, fitness = getattr(arena_controllers, controller or task), []
    simulator = Arena(ArenaSettings(task=task))  # type: ignore[arg-type]
    for seed in seeds:
        turn = simulator.reset(int(seed))
        while turn is not None:
            turn = simulator.step(policy(turn.observations))
        fitness.append(simulator.outcome().fitness[0])
    return float(np.mean(fitness))


@pytest.mark.parametrize("task", TASKS)
def test_random_controllers_do_badly_and_one_written_by_hand_does_better(
    task: str,
) -> None:
    simulator, network = built({"task": task}, activation="tanh", iterations=1)
    rated = (
        play(simulator, network, network.random(60, Stream(3)), UNSEEN[:2])
        .fitness.reshape(60, 2)
        .mean(axis=1)
    )
    bad, good = {
        "aggregation": (0.1, 0.2),
        "dispersion": (0.4, 0.65),
        "foraging": (5, 30),
        "consensus": (-0.5, 0.2),
    }[task]
    assert rated.mean() < bad
    assert by_hand(task, UNSEEN[:2]) > good


@pytest.mark.long
@pytest.mark.parametrize(
    ("task", "share"),
    [
        ("aggregation", 1.5),
        ("dispersion", 1.1),
        ("foraging", 1.05),
        ("consensus", 1.1),
    ],
)
def test_the_example_evolves_a_better_controller_than_the_one_written_by_hand(
    task: str, share: float
) -> None:
    """Compare the recorded champion with it on unseen seeds.

    Foraging depends on the run seed: with seed 2, evolution only draws level. In consensus,
    evolution falls short of the best known controller.
    """
    example = f"arena-{task}"
    genome = champions.champion(example)
    unseen = champions.on_seeds(champions.problem(example), genome, UNSEEN).fitness.mean()
    assert unseen > share * by_hand(task, UNSEEN)
    if task == "consensus":
        assert 0.75 < unseen / by_hand(task, UNSEEN, "patient_consensus") < 1


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        (
            {"side": 0.2},
            "arena: a robot of radius 0.1 does not fit in a room of side 0.2",
        ),
        (
            {"sight": 0.1},
            "arena: sight 0.1 must be at least 2 radius, 0.2: robots that touch see each other",
        ),
        (
            {"task": "foraging", "nest": 3.95},
            "arena: nest 3.95 must be between radius 0.1 and side - radius, 3.9: robots",
        ),
        (
            {"task": "foraging", "nest": 0.1},
            "arena: nest 0.1 must be between radius 0.1 and side - radius, 3.9: robots come in",
        ),
        ({"task": "agregation"}, "problem.settings: task: "),
        ({"robots": 0}, "problem.settings: robots: expected int >= 1"),
        # It would turn by no number.
        (
            {"radius": 1e-30, "sight": 1e-29},
            "problem.settings: radius: expected float >= 0.001",
        ),
        ({"speed": -1.0}, "problem.settings: speed: "),
    ],
)
def test_impossible_settings_are_refused_in_one_clear_line(
    settings: dict[str, Any], text: str
) -> None:
    with pytest.raises(ConfigError) as refusal:
        built(settings)
    assert str(refusal.value).startswith(text)
    assert "\n" not in str(refusal.value)
