"""Mealy machines decide as FREVO's, bit for bit; each mutation does what its name says."""

import json
from typing import Any

import numpy as np
import pytest

from tests.repository import REPOSITORY
from zswarm import evaluate, experiment
from zswarm.config.decode import convert
from zswarm.errors import ConfigError
from zswarm.kernels.random import Stream
from zswarm.nets.mealy import Machine, Mealy, MealySettings
from zswarm.ot.build import build
from zswarm.testing import check_representation

MACHINES = json.loads((REPOSITORY / "tests" / "golden" / "mealy.json").read_text())[
    "machines"
]
STEPS = [Mealy.step, getattr(Mealy.step, "py_func", Mealy.step)]
STILL = dict.fromkeys(
    (
        "delete_transition",
        "change_first_state",
        "change_output",
        "change_next_state",
        "change_threshold",
    ),
    0.0,
)


def machines(inputs: int = 2, outputs: int = 2, **settings: Any) -> Mealy:
    return Mealy(MealySettings(**settings), inputs, outputs)


def recorded(machine: dict[str, Any]) -> tuple[Mealy, bytes]:
    inputs, states = machine["inputs"], machine["states"]
    built = machines(
        states=states,
        rows="product",
        scale=1.0,
        thresholds=[len(each["thresholds"] or []) for each in inputs],
        minimum=[each["min"] for each in inputs],
        maximum=[each["max"] for each in inputs],
        units=[each["units"] for each in inputs],
        output_units=machine["output_units"],
    )
    thresholds = np.array(
        [number for each in inputs for number in each["thresholds"] or []]
    )
    following = np.array(machine["next_state"]).reshape(-1, states)
    outputs = np.array(machine["output_table"]).reshape(-1, states, 2)
    return built, Machine(machine["init_state"], thresholds, following, outputs).genome()


def decide(
    built: Mealy, genome: bytes, observations: Any, step: Any = Mealy.step
) -> tuple[np.ndarray, list[int]]:
    """Return the outputs, and the states after each decision."""
    (parameters,) = built.parameters([genome])
    state, actions, states = (
        np.zeros(1, np.float32),
        np.empty((len(observations), built.outputs), np.float32),
        [],
    )
    for observation, action in zip(
        np.array(observations, np.float32), actions, strict=True
    ):
        step(parameters, state, observation, action)
        states.append(int(state[0]) - 1)
    return actions, states


def numbers(built: Mealy, genome: bytes) -> Machine:
    return built._decoded(genome)


# ---- decisions


@pytest.mark.parametrize("step", STEPS, ids=["compiled", "plain"])
@pytest.mark.parametrize("machine", MACHINES, ids=lambda machine: str(machine["id"]))
def test_a_recorded_machine_decides_as_in_frevo_bit_for_bit(
    machine: dict[str, Any], step: Any
) -> None:
    actions, states = decide(*recorded(machine), machine["in"], step)
    assert actions.tobytes() == np.array(machine["out"], np.float32).tobytes()
    assert states == machine["state_after"]


def test_the_recorded_machines_have_inputs_with_thresholds_and_without() -> None:
    assert {
        each["thresholds"] is None for machine in MACHINES for each in machine["inputs"]
    } == {
        True,
        False,
    }


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"rows": "product"},
        {"add_state": 0.5, "delete_state": 0.5, "thresholds": [2]},
        {"thresholds": [0], "units": [3], "minimum": [-100]},
        {"states": 1},
    ],
)
def test_all_settings_keep_the_contract(settings: dict[str, Any]) -> None:
    check_representation(Mealy, settings)
    check_representation(Mealy, settings, inputs=1, outputs=1)


def rows_of(built: Mealy, observations: Any) -> list[int]:
    """Return the row of the table that each observation chooses."""
    outputs = np.arange(built.rows).reshape(-1, 1, 1)
    genome = Machine(
        0, np.array([30, 60] * 2), np.zeros((built.rows, 1), int), outputs
    ).genome()
    return [
        round(float(number) * 100)
        for number in decide(built, genome, observations)[0][:, 0]
    ]


CLASSES = [[low, high] for low in (0.0, 0.3, 0.6) for high in (0.0, 0.3, 0.6)]


def test_each_combination_of_classes_has_a_row_of_its_own() -> None:
    built = machines(2, 1, states=1, thresholds=[2], scale=100.001)
    assert rows_of(built, CLASSES) == list(range(9))


def test_products_choose_rows_as_in_frevo() -> None:
    """(1, 2) and (2, 1) have one row; rows 4, 6 and 7 are never read."""
    built = machines(2, 1, states=1, thresholds=[2], scale=100.001, rows="product")
    assert rows_of(built, CLASSES) == [0, 1, 2, 1, 3, 5, 2, 5, 8]


def test_inputs_out_of_range_count_as_the_nearest_class() -> None:
    built = machines(
        1, 1, states=1, thresholds=[0], units=[4], scale=1.0, minimum=[-10], maximum=[10]
    )
    genome = Machine(
        0, np.zeros(0), np.zeros((5, 1), int), np.arange(5).reshape(5, 1, 1)
    ).genome()
    seen = [
        [-1e30],
        [-11],
        [-10],
        [-5.1],
        [-4.9],
        [0],
        [9.9],
        [10],
        [1e30],
        [float("nan")],
    ]
    assert (decide(built, genome, seen)[0][:, 0] * 100).round().tolist() == [
        0,
        0,
        0,
        1,
        1,
        2,
        3,
        4,
        4,
        2,
    ]


def test_a_machine_begins_in_its_first_state_in_each_trial() -> None:
    built = machines(1, 1, states=3)
    outputs = np.tile([[10], [20], [30]], (2, 1, 1))
    genome = Machine(
        2, np.array([50]), np.array([[1, 2, 0], [0, 0, 0]]), outputs
    ).genome()
    actions, states = decide(built, genome, [[0], [0], [0], [1]])
    assert (actions[:, 0] * 100).round().tolist() == [30, 10, 20, 30]
    assert states == [0, 1, 2, 0]


# ---- genomes


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"first": 3}, "a state beyond its 3"),
        ({"following": np.full((4, 3), 3)}, "a state beyond its 3"),
        ({"outputs": np.full((4, 3, 2), 101)}, r"an output that is not in 0\.\.100"),
        ({"outputs": np.full((4, 3, 2), -1)}, r"an output that is not in 0\.\.100"),
        ({"thresholds": np.array([0, 2**30])}, "a threshold beyond 2,000,000"),
        (
            {"following": np.zeros((4, 2), int), "outputs": np.zeros((4, 2, 2), int)},
            "2 states; this machine has 3 states",
        ),
    ],
)
def test_a_malformed_genome_is_refused(change: dict[str, Any], text: str) -> None:
    built = machines(states=3)
    good = built.random(1, Stream(1))[0]
    with pytest.raises(ValueError, match=text):
        built.parameters([good, numbers(built, good)._replace(**change).genome()])


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        (
            {"thresholds": [1, 1, 1]},
            "thresholds: expected one number, or 2, one per input, not 3",
        ),
        ({"units": [0]}, "units must be at least 1, for each input"),
        ({"minimum": [0, 100]}, "minimum must be less than maximum, for each input"),
        (
            {"add_state": 0.1, "states": 30},
            "max_states must be at least states, 30, not 20",
        ),
        (
            {"thresholds": [600]},
            r"have 361,201 rows of 6 states, which are 6,501,618 numbers; at most 1,048,576",
        ),
        ({"rows": "sum"}, "rows: expected combinations or product"),
    ],
)
def test_impossible_settings_are_refused(settings: dict[str, Any], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        Mealy(convert(settings, MealySettings, "representation"), 2, 2)


def test_machines_of_different_sizes_fit_in_one_batch() -> None:
    built = machines(add_state=1.0)
    genomes = built.random(1, Stream(1))
    genomes += built.mutate(genomes, Stream(2), method=1, severity=0.3, probability=1.0)
    together = built.parameters(genomes)
    for row, genome in zip(together, genomes, strict=True):
        (alone,) = built.parameters([genome])
        assert row[: len(alone)].tobytes() == alone.tobytes()
        assert not row[len(alone) :].any()


def test_new_machines_fill_their_ranges() -> None:
    built = machines(
        1, 1, thresholds=[3], minimum=[-20], maximum=[20], units=[4], output_units=7
    )
    drawn = [numbers(built, genome) for genome in built.random(300, Stream(1))]
    assert {int(number) for machine in drawn for number in machine.thresholds} == {
        -20,
        -10,
        0,
        10,
    }
    assert all((np.diff(machine.thresholds) >= 0).all() for machine in drawn)
    assert {
        int(number) for machine in drawn for number in machine.outputs.ravel()
    } == set(range(8))
    assert {
        int(number) for machine in drawn for number in machine.following.ravel()
    } == set(range(6))
    assert {machine.first for machine in drawn} == {0}


# ---- the seven mutations


def mutants(
    built: Mealy, count: int = 200, probability: float = 1.0
) -> list[tuple[Machine, Machine]]:
    """Return parents, each with its mutant."""
    parents = built.random(count, Stream(1))
    children = built.mutate(
        parents, Stream(2), method=1, severity=0.3, probability=probability
    )
    built.parameters(children)
    return [
        (numbers(built, a), numbers(built, b))
        for a, b in zip(parents, children, strict=True)
    ]


def same(one: Any, other: Any) -> bool:
    return np.array_equal(one, other)


def test_zero_probabilities_change_nothing() -> None:
    assert all(
        before.genome() == after.genome() for before, after in mutants(machines(**STILL))
    )


@pytest.mark.parametrize(
    ("mutation", "part"),
    [
        ("change_output", "outputs"),
        ("change_next_state", "following"),
        ("delete_transition", "following"),
        ("change_threshold", "thresholds"),
        ("change_first_state", "first"),
    ],
)
def test_a_mutation_changes_its_own_part_only(mutation: str, part: str) -> None:
    pairs = mutants(machines(thresholds=[3, 0], units=[5], **{**STILL, mutation: 0.5}))
    for before, after in pairs:
        for other in set(Machine._fields) - {part}:
            assert same(getattr(before, other), getattr(after, other))
    assert (
        sum(
            not same(getattr(before, part), getattr(after, part))
            for before, after in pairs
        )
        > 60
    )


@pytest.mark.parametrize(
    ("mutation", "part"),
    [("change_output", "outputs"), ("change_next_state", "following")],
)
def test_a_mutation_hits_with_its_chance_times_the_probability(
    mutation: str, part: str
) -> None:
    pairs = mutants(
        machines(output_units=1_000_000, **{**STILL, mutation: 0.4}), probability=0.5
    )
    changed = [
        (getattr(before, part) != getattr(after, part)).mean() for before, after in pairs
    ]
    assert abs(np.mean(changed) - 0.2) < 0.02


def test_a_deleted_transition_stays_in_its_state() -> None:
    for _, after in mutants(machines(**{**STILL, "delete_transition": 1.0}), 5):
        assert same(after.following, np.tile(np.arange(6), (4, 1)))


def test_thresholds_change_after_an_input_that_has_none() -> None:
    """FREVO fails here."""
    pairs = mutants(
        machines(
            thresholds=[0, 3],
            units=[5],
            minimum=[-50],
            **{**STILL, "change_threshold": 1.0},
        )
    )
    assert any(not same(before.thresholds, after.thresholds) for before, after in pairs)
    for _, after in pairs:
        assert (np.diff(after.thresholds) >= 0).all()
        assert set(after.thresholds) <= {-50, -20, 10, 40, 70}


def test_a_changed_first_state_is_an_existing_state() -> None:
    firsts = {
        after.first
        for _, after in mutants(machines(**{**STILL, "change_first_state": 1.0}))
    }
    assert firsts == {1, 2, 3, 4, 5}


def test_a_new_state_leaves_the_others_as_they_are() -> None:
    """FREVO puts it at a wrong place in the table."""
    for before, after in mutants(machines(add_state=1.0, **STILL), 20):
        assert same(after.following[:, :6], before.following)
        assert same(after.outputs[:, :6], before.outputs)
        assert after.following.shape == (4, 7)


def test_deleting_a_state_removes_transitions_to_it_and_keeps_the_others() -> None:
    """FREVO keeps transitions to it, and to the last state, whose number has changed."""
    for before, after in mutants(machines(delete_state=1.0, **STILL), 50):
        # The random outputs tell.
        (lost,) = [
            state
            for state in range(6)
            if same(np.delete(before.outputs, state, axis=1), after.outputs)
        ]
        kept = np.delete(before.following, lost, axis=1)
        expected = kept - (kept > lost)
        assert same(after.following[kept != lost], expected[kept != lost])
        assert after.following.max() < 5
        assert after.first < 5


def test_the_number_of_states_stays_between_one_and_the_maximum() -> None:
    built = machines(add_state=0.6, delete_state=0.6, states=2, max_states=4, **STILL)
    genomes, stream, seen = built.random(10, Stream(1)), Stream(2), set()
    for _ in range(30):
        genomes = built.mutate(genomes, stream, method=1, severity=0.3, probability=1.0)
        genomes = [
            built.crossover(a, b, stream)
            for a, b in zip(genomes, genomes[1:] + genomes[:1], strict=True)
        ]
        seen |= {numbers(built, genome).following.shape[1] for genome in genomes}
        built.parameters(genomes)
    assert seen == {1, 2, 3, 4}


# ---- crossover and distance


def test_a_child_has_each_number_of_either_parent() -> None:
    built = machines(states=2, thresholds=[2, 1])
    mother = Machine(
        0, np.array([1, 1, 1]), np.zeros((6, 2), int), np.ones((6, 2, 2), int)
    ).genome()
    father = Machine(
        1, np.array([2, 2, 2]), np.ones((6, 2), int), np.full((6, 2, 2), 2)
    ).genome()
    children = [
        numbers(built, built.crossover(mother, father, Stream(seed)))
        for seed in range(300)
    ]
    assert {child.first for child in children} == {0, 1}
    assert {tuple(child.thresholds) for child in children} == {
        (a, a, b) for a in (1, 2) for b in (1, 2)
    }, "input by input"
    assert abs(np.mean([child.following for child in children]) - 0.5) < 0.05
    assert abs(np.mean([child.outputs for child in children]) - 1.5) < 0.05


def test_the_distance_counts_the_numbers_that_differ() -> None:
    built = machines(states=2, add_state=0.5)
    one = Machine(0, np.array([10, 20]), np.zeros((4, 2), int), np.zeros((4, 2, 2), int))
    other = one._replace(
        first=1, thresholds=np.array([10, 21]), following=np.eye(4, 2, dtype=int)
    )
    wider = Machine(
        0, np.array([10, 20]), np.zeros((4, 3), int), np.zeros((4, 3, 2), int)
    )
    found = built.distances(
        [one.genome()], [one.genome(), other.genome(), wider.genome()]
    )
    assert found.tolist() == [[0, 4, 12]]


# ---- what it is known for


def test_a_machine_learns_to_walk_to_the_exit_and_to_stop_there() -> None:
    """The example, on the exit within half of its generations, and not at first."""
    loaded = experiment.load(experiment.find("mealy"), [])
    parts = build(experiment.complete(loaded, "test"))
    bests = []
    for _ in range(30):
        genomes = parts.optimizer.ask()
        participants, seeds = (
            np.arange(len(genomes)).reshape(-1, 1),
            np.zeros(len(genomes), np.uint64),
        )
        outcomes = evaluate.evaluate(
            parts.problem.simulator,
            parts.problem.representation,
            genomes,
            participants,
            seeds,
        )
        parts.optimizer.tell(outcomes.fitness[:, 0])
        bests.append(parts.optimizer.best()[1])
    assert bests[0] < -1
    assert bests[-1] == 0
