"""Emergency exit gives what FREVO recorded, and agrees with a second writing of its data sheet."""

import copy
import json
import os
import subprocess
import sys
from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from tests.installed_parts import playable
from tests.repository import REPOSITORY
from tests.sims.naive_emergency_exit import NaiveEmergencyExit, java_below, java_random
from zswarm.errors import ConfigError
from zswarm.evaluate import TrialOutcomes, build, evaluate
from zswarm.kernels.random import Stream, draw_java
from zswarm.nets.fully_meshed import FullyMeshed
from zswarm.plugins import registry as plugins
from zswarm.sims.emergency_exit import EmergencyExit, EmergencyExitSettings
from zswarm.testing import check_simulator

GOLDEN = REPOSITORY / "tests" / "golden"
RECORDED = json.loads((GOLDEN / "emergencyexit.json").read_text())
TRACES = json.loads((GOLDEN / "emergencyexit_traces.json").read_text())["traces"]
NETS = {net["id"]: net for net in RECORDED["nets"]}
FIELDS = {field["name"]: field for field in RECORDED["fields"]}
ACTIVATIONS = {"LINEAR": "clamp", "SIGMOID": "sigmoid", "RELU": "relu"}
SEEDS = {
    "small10x10": 100,
    "tall12x20": 101,
    "one_agent": 102,
    "dense": 103,
    "stadium": 0,
}
SEEDS |= {f"seed{number}": number for number in range(12)}
RANDOM_FIELDS = [name for name in FIELDS if name != "stadium"]
UNUSUAL: list[dict[str, Any]] = [
    {},
    {"field": "stadium", "steps": 15},
    {"steps": 1},
    {
        "steps": 7,
        "width": 2,
        "height": 9,
        "agents": 2,
        "exits": 1,
        "blockades": 0,
        "seed": 3,
    },
    {"steps": 30, "width": 5, "height": 5, "agents": 15, "exits": 1, "blockades": 9},
    {
        "steps": 30,
        "width": 8,
        "height": 13,
        "agents": 6,
        "exits": 2,
        "blockades": 11,
        "seed": 2**48 - 9,
    },
    {
        "steps": 60,
        "width": 16,
        "height": 16,
        "agents": 20,
        "exits": 12,
        "blockades": 60,
        "seed": 5,
    },
]


def settings_of(field: dict[str, Any]) -> dict[str, Any]:
    if field["name"] == "stadium":
        return {"field": "stadium", "steps": field["steps"]}
    counts = {what: len(field[what]) for what in ("agents", "exits", "blockades")}
    return {
        "steps": field["steps"],
        "width": field["width"],
        "height": field["height"],
        **counts,
    }


def network(net: dict[str, Any]) -> tuple[dict[str, Any], bytes]:
    """Return the settings and the genome of a recorded network."""
    table = [
        [*weights, bias]
        for weights, bias in zip(net["weights_into"], net["bias"], strict=True)
    ]
    settings = {
        "hidden": net["hidden"],
        "iterations": net["iterations"],
        "activation": ACTIVATIONS[net["activation"]],
    }
    return settings, np.array(table, "<f4").tobytes()


def play(
    settings: dict[str, Any], net: dict[str, Any], seeds: list[int]
) -> TrialOutcomes:
    net_settings, genome = network(net)
    simulator, built = build("emergency-exit", settings, "fully-meshed", net_settings)
    return evaluate(
        simulator,
        built,
        [genome],
        np.zeros((len(seeds), 1), np.int64),
        np.array(seeds, np.uint64),
    )


def controller(
    built: FullyMeshed, parameters: np.ndarray, agents: int
) -> Callable[[int, Any], list[float]]:
    """Decide for each agent, with a separate state each."""
    states = np.zeros((agents, built.state_size), np.float32)

    def decide(agent: int, observation: Any) -> list[float]:
        action = np.empty(2, np.float32)
        FullyMeshed.step(
            parameters, states[agent], np.array(observation, np.float32), action
        )
        return [float(output) for output in action]

    return decide


# ---- FREVO's recordings ----------------------------------------------------------------


def test_every_recorded_net_ran_on_every_recorded_field() -> None:
    assert {(run["field"], run["net"]) for run in RECORDED["runs"]} == {
        (field, net) for field in FIELDS for net in NETS
    }


@pytest.mark.parametrize(
    "run", RECORDED["runs"], ids=lambda run: f"{run['field']}-{run['net']}"
)
def test_a_run_ends_as_in_frevo(run: dict[str, Any]) -> None:
    field = FIELDS[run["field"]]
    outcomes = play(settings_of(field), NETS[run["net"]], [SEEDS[run["field"]]])
    assert outcomes.fitness[0, 0] == run["fitness"]
    escaped = sum(step >= 0 for step in run["out_at_step"])
    rounds = field["steps"] if run["first_all_out"] is None else run["first_all_out"] + 1
    assert outcomes.metrics[0].tolist() == [escaped, rounds]


@pytest.mark.parametrize(
    "total", RECORDED["sums"], ids=lambda total: f"{total['net']}-{total['evaluations']}"
)
def test_the_sum_over_trials_is_frevos_sum_over_evaluations(
    total: dict[str, Any],
) -> None:
    """Use the field seeds in sequence as fixed seeds, and add up fitness in the same order."""
    fixed = EmergencyExit(EmergencyExitSettings(seed=total["seed"])).fixed_seeds(
        total["evaluations"]
    )
    outcomes = play({}, NETS[total["net"]], list(fixed))
    assert sum(outcomes.fitness[:, 0].tolist(), 0.0) == total["fitness"]


@pytest.mark.parametrize("name", RANDOM_FIELDS)
def test_a_random_field_is_laid_out_as_in_frevo(name: str) -> None:
    """Agents, exits and blockades lie on the recorded cells, in the recorded order."""
    field = FIELDS[name]
    simulator = EmergencyExit(EmergencyExitSettings(**settings_of(field)))
    rows = simulator.fields.place(np.array([0, SEEDS[name]], np.uint64))
    for cells, what in zip(rows, ("agents", "exits", "blockades"), strict=True):
        assert [
            [cell % simulator.fields.stride - 1, cell // simulator.fields.stride - 1]
            for cell in cells[1].tolist()
        ] == field[what]


@pytest.mark.parametrize("name", FIELDS)
def test_the_frame_shows_the_recorded_field(name: str) -> None:
    field = FIELDS[name]
    simulator = EmergencyExit(EmergencyExitSettings(**settings_of(field)))
    simulator.reset(SEEDS[name])
    frame = simulator.frame()
    assert (frame.width, frame.height) == (field["width"], field["height"])
    assert [[body.x - 0.5, body.y - 0.5] for body in frame.bodies] == field["agents"]
    assert {body.kind for body in frame.bodies} == {"robot inside"}
    for kind, what in (("exit", "exits"), ("blockade", "blockades")):
        assert {(place.x, place.y) for place in frame.places if place.kind == kind} == {
            tuple(place) for place in field[what]
        }


@pytest.mark.parametrize(
    "trace", TRACES, ids=lambda trace: f"{trace['field']}-{trace['net']}"
)
def test_turns_follow_a_recorded_trace(trace: dict[str, Any]) -> None:
    """Positions after every round, and every sensor and output of the first agent."""
    field = FIELDS[trace["field"]]
    net_settings, genome = network(NETS[trace["net"]])
    simulator, built = build(
        "emergency-exit", settings_of(field), "fully-meshed", net_settings
    )
    assert isinstance(simulator, EmergencyExit)
    assert isinstance(built, FullyMeshed)
    decide = controller(built, built.parameters([genome])[0], simulator.fields.agents)
    positions: list[Any] = []
    first_agent: list[list[float]] = []
    out_at = [-1] * simulator.fields.agents

    def look(rounds: int) -> None:
        frame = simulator.frame()
        positions.extend(
            [[[body.x - 0.5, body.y - 0.5] for body in frame.bodies]]
            * (rounds + 1 - len(positions))
        )
        for agent, body in enumerate(frame.bodies):
            if body.kind == "robot outside" and out_at[agent] < 0:
                out_at[agent] = rounds - 1

    turn = simulator.reset(SEEDS[trace["field"]])
    look(0)
    while turn is not None:
        (agent,) = turn.agents
        action = decide(agent, turn.observations[0])
        if agent == 0:
            first_agent.append([*turn.observations[0].tolist(), *action])
        before = simulator._round
        turn = simulator.step(np.array([action], np.float32))
        if simulator._round > before:
            look(before + 1)
    look(field["steps"])
    assert positions == trace["positions"]
    recorded = [[*sensors, *outputs] for sensors, outputs in trace["agent0"]]
    assert first_agent == np.array(recorded, np.float32).astype(float).tolist()
    assert out_at == trace["out_at_step"]
    assert simulator.outcome().fitness[0] == trace["fitness"]


# ---- agreement of all implementations --------------------------------------------------


def naive(simulator: EmergencyExit, seed: int) -> NaiveEmergencyExit:
    settings = simulator.settings
    if settings.field == "stadium":
        field = FIELDS["stadium"]
        places = (
            [tuple(place) for place in field[what]]
            for what in ("agents", "exits", "blockades")
        )
        return NaiveEmergencyExit((20, 20), *places)
    size = settings.width, settings.height
    return NaiveEmergencyExit.random(
        size, settings.agents, settings.exits, settings.blockades, seed
    )


@pytest.mark.parametrize("settings", UNUSUAL)
@pytest.mark.parametrize("activation", ["clamp", "relu", "sigmoid", "tanh"])
def test_the_kernel_agrees_with_a_naive_reference_bit_for_bit(
    settings: dict[str, Any], activation: str
) -> None:
    simulator, built = build(
        "emergency-exit", settings, "fully-meshed", {"activation": activation}
    )
    assert isinstance(simulator, EmergencyExit)
    assert isinstance(built, FullyMeshed)
    genomes = [network(NETS[3])[1], *built.random(2, Stream(7))]
    seeds = np.array([*simulator.fixed_seeds(2), 2**64 - 1], np.uint64)
    participants = np.repeat(np.arange(len(genomes)), len(seeds))[:, None]
    outcomes = evaluate(
        simulator, built, genomes, participants, np.tile(seeds, len(genomes))
    )
    trial = 0
    for parameters in built.parameters(genomes):
        for seed in seeds:
            decide = controller(built, parameters, simulator.fields.agents)
            expected = naive(simulator, int(seed)).play(simulator.settings.steps, decide)
            assert (outcomes.fitness[trial, 0], *outcomes.metrics[trial]) == expected
            trial += 1


def test_the_compared_trials_include_moves_blocks_and_escapes() -> None:
    """The hand-made net, straight to the exit, gets some agents out and leaves others blocked."""
    counts = Counter()
    for seed in range(12):
        metrics = play({}, NETS[3], [seed]).metrics[0]
        counts["out"] += int(metrics[0])
        counts["all out"] += int(metrics[1] < 50)
    assert 60 < counts["out"] < 120
    assert 0 < counts["all out"] < 12


SHORT: dict[str, dict[str, Any]] = {"epuck": {"robots": 4, "seconds": 5.0}}


@pytest.mark.parametrize("name", playable(plugins.names("simulator")))
def test_every_simulator_keeps_the_contract(name: str) -> None:
    """Simulators with a setting for steps are tested with 100 steps."""
    simulator_class = plugins.load("simulator", name)
    steps = hasattr(simulator_class.settings_type, "steps")
    check_simulator(simulator_class, {"steps": 100} if steps else SHORT.get(name))


@pytest.mark.long
@pytest.mark.parametrize("settings", UNUSUAL[1:])
def test_unusual_settings_keep_the_contract(settings: dict[str, Any]) -> None:
    check_simulator(EmergencyExit, settings)


PLAIN = """
import sys
import numpy as np
from zswarm.kernels.portable import exp
from zswarm.kernels.random import Stream, draw_java
from zswarm.evaluate import build, evaluate

assert (type(getattr(exp, "dispatcher", exp)).__name__ == "function") == (sys.argv[1] == "plain")
for activation in ("clamp", "sigmoid", "relu", "tanh"):
    for problem in ({"steps": 6}, {"steps": 1, "field": "stadium"}):
        settings = {"activation": activation}
        simulator, network = build("emergency-exit", problem, "fully-meshed", settings)
        genomes = network.random(3, Stream(7))
        participants = np.arange(9)[:, None] % 3  # eight side by side, and one more
        seeds = np.arange(9, dtype=np.uint64)
        outcomes = evaluate(simulator, network, genomes, participants, seeds)
        print(outcomes.fitness.tobytes().hex(), outcomes.metrics.tobytes().hex(), outcomes.error)
"""


@pytest.mark.long
def test_plain_python_gives_the_same_bits_as_eight_lanes() -> None:
    printed = {}
    for form, options in (
        ("compiled", {}),
        ("plain", {"NUMBA_DISABLE_JIT": "1"}),
        ("plain", {"ZSWARM_PLAIN": "1"}),
    ):
        done = subprocess.run(
            [sys.executable, "-c", PLAIN, form],
            env={**os.environ, "NUMBA_DISABLE_JIT": "0", "ZSWARM_PLAIN": "", **options},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        printed[str(options)] = done.stdout
    assert len(printed) == 3
    assert len(set(printed.values())) == 1
    assert len(set(printed["{}"].split())) > 10, "the trials differ from one another"


@pytest.mark.parametrize("activation", ["clamp", "relu", "sigmoid", "tanh"])
@pytest.mark.parametrize("wild", [1.0, 1e19, 1e38])
def test_trials_played_in_lanes_equal_trials_played_in_sequence(
    activation: str, wild: float
) -> None:
    """Vary the number of trials and when agents leave, and overflow the sums in the network."""
    simulator, built = build(
        "emergency-exit",
        {"steps": 40, "agents": 5},
        "fully-meshed",
        {"activation": activation},
    )
    random = np.frombuffer(b"".join(built.random(16, Stream(9))), "<f4") * np.float32(
        wild
    )
    genomes = [network(NETS[3])[1], *(row.tobytes() for row in random.reshape(16, -1))]
    alone = copy.copy(built)
    alone.step_lanes = None
    rounds = set()
    for trials in (1, 2, 7, 8, 9, 17, 24):
        participants, seeds = (
            np.arange(trials)[:, None] * 3 % len(genomes),
            np.arange(trials, dtype=np.uint64),
        )
        together, one_by_one = (
            evaluate(simulator, net, genomes, participants, seeds)
            for net in (built, alone)
        )
        assert together.fitness.tobytes() == one_by_one.fitness.tobytes()
        assert together.metrics.tobytes() == one_by_one.metrics.tobytes()
        rounds |= set(together.metrics[:, 1])
    assert len(rounds) > 1 or activation != "clamp", "some were out before others"


def test_fields_are_generated_again_when_dropped_from_the_cache(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    simulator, built = build("emergency-exit", {"steps": 5}, "fully-meshed", {})
    assert isinstance(simulator, EmergencyExit)
    monkeypatch.setattr("zswarm.sims.exit_fields.MAX_CACHED", 5 * simulator.fields.cells)
    genomes = built.random(1, Stream(3))

    def fitness(seeds: list[int]) -> list[float]:
        return (
            evaluate(
                simulator,
                built,
                genomes,
                np.zeros((len(seeds), 1), np.int64),
                np.array(seeds, np.uint64),
            )
            .fitness[:, 0]
            .tolist()
        )

    first = fitness([1, 2, 3])
    assert fitness([3, 9, 8, 7]) == [first[2], *fitness([9, 8, 7])]
    assert len(simulator.fields.row_of) == 6
    assert fitness([11, 2, 1]) == [*fitness([11]), first[1], first[0]]
    assert len(simulator.fields.row_of) == 3


def test_a_seed_determines_the_field_independently_of_the_batch() -> None:
    seeds = [3, 1, 3, 2**64 - 1, 1]
    together = play({}, NETS[2], seeds)
    alone = [play({}, NETS[2], [seed]).fitness[0, 0] for seed in seeds]
    assert together.fitness[:, 0].tolist() == alone
    assert len(set(alone)) == 3


@pytest.mark.parametrize("bound", [1, 2, 3, 64, 999, 1000])
def test_a_draw_that_would_favour_small_numbers_is_repeated_as_in_java(
    bound: int,
) -> None:
    """Java redraws if the upper 31 bits fall into the last, incomplete run of 0..bound-1.

    The states include both edges of that run.
    """
    multiplier, mask = 0x5DEECE66D, 2**48 - 1
    for bits in (2**31 - 1, 2**31 - bound, 2**31 - 2**31 % bound - 1, 0, 12345):
        state = ((bits << 17) - 11) * pow(multiplier, -1, 2**48) & mask
        words = java_random(state ^ multiplier)
        expected = [java_below(bound, words) for _ in range(3)]
        kernel_state = np.array([state], np.uint64)
        assert [draw_java(kernel_state, bound) for _ in range(3)] == expected


def test_the_stadium_is_the_same_for_every_seed() -> None:
    assert len(set(play({"field": "stadium"}, NETS[1], [0, 7, 2**63]).fitness[:, 0])) == 1


@pytest.mark.parametrize(
    ("output", "cells"),
    [
        *(
            (0.0, -1),
            (0.2499999, -1),
            (0.25, 0),
            (0.7499999, 0),
            (0.75, 1),
            (1.0, 1),
            (1.2499999, 1),
        ),
        *((1.25, 0), (np.inf, 0), (np.nan, 0)),
    ],
)
def test_an_output_is_rounded_to_a_move_as_in_java(output: float, cells: int) -> None:
    simulator = EmergencyExit(EmergencyExitSettings(agents=1, blockades=0))
    for axis in (0, 1):
        simulator.reset(6)
        before = simulator.frame().bodies[0][1:3]
        action = np.array([[0.5, 0.5]], np.float32)
        action[0, axis] = output
        simulator.step(action)
        after = simulator.frame().bodies[0][1:3]
        assert after[axis] - before[axis] == cells
        assert after[1 - axis] == before[1 - axis]


# ---- settings --------------------------------------------------------------------------


def test_the_defaults_are_frevos_and_the_stadium_has_its_own_sizes() -> None:
    simulator = EmergencyExit(EmergencyExitSettings())
    fields = simulator.fields
    assert (fields.agents, fields.width, fields.height) == (10, 20, 20)
    assert simulator.settings.steps == 50
    stadium = EmergencyExit(
        EmergencyExitSettings(field="stadium", width=9, height=3, agents=1)
    )
    fields = stadium.fields
    assert (fields.agents, fields.width, fields.height) == (72, 20, 20)


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        (
            {"width": 21},
            "emergency-exit: width must not exceed height: "
            "a random field draws both coordinates from",
        ),
        (
            {"blockades": 386},
            "emergency-exit: 401 agents, exits and blockades do not fit on 400 cells",
        ),
        (
            {"width": 3, "height": 900},
            "emergency-exit: 35 agents, exits and blockades do not fit on 9 cells",
        ),
        ({"agents": 0}, "problem.settings: agents: expected int >= 1"),
        ({"exits": 0}, "problem.settings: exits: expected int >= 1"),
        ({"steps": 0}, "problem.settings: steps: expected int >= 1"),
        ({"steps": 5.5}, "problem.settings: steps: expected int, got float"),
        ({"seed": -2}, "problem.settings: seed: expected int >= -1"),
        ({"seed": 2**48}, "problem.settings: seed: expected int <= 281474976710655"),
        (
            {"field": "maze"},
            "problem.settings: field: expected random or stadium, not 'maze'",
        ),
        ({"agent": 3}, "problem.settings: unknown key 'agent' (did you mean 'agents'?)"),
    ],
)
def test_impossible_settings_are_refused_in_one_clear_line(
    settings: dict[str, Any], text: str
) -> None:
    with pytest.raises(ConfigError) as refusal:
        build("emergency-exit", settings, "fully-meshed", {})
    assert str(refusal.value).startswith(text)
    assert "\n" not in str(refusal.value)


def test_a_full_room_can_be_played() -> None:
    outcomes = play(
        {"width": 4, "height": 4, "agents": 10, "exits": 1, "blockades": 5},
        NETS[3],
        [0, 1],
    )
    assert np.isfinite(outcomes.fitness).all()
    assert (outcomes.fitness <= 1.0).all()
