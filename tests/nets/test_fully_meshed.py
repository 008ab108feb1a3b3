"""Fully-meshed networks decide and breed as FREVO's do, bit for bit."""

import json
from typing import Any

import msgspec
import numpy as np
import pytest

from tests.repository import REPOSITORY
from zswarm.config.decode import convert
from zswarm.errors import ConfigError
from zswarm.kernels.jit import interpreted
from zswarm.kernels.random import Stream
from zswarm.nets import vector
from zswarm.nets.fully_meshed import FullyMeshed, FullyMeshedSettings
from zswarm.testing import check_representation

GOLDEN = REPOSITORY / "tests" / "golden"
NETS = json.loads((GOLDEN / "fullymeshed.json").read_text())["nets"]
TRACE = json.loads((GOLDEN / "nnga_trace.json").read_text())
ACTIVATIONS = {"LINEAR": "clamp", "SIGMOID": "sigmoid", "RELU": "relu"}


def network(
    hidden: int = 2, inputs: int = 10, outputs: int = 2, **settings: Any
) -> FullyMeshed:
    return FullyMeshed(FullyMeshedSettings(hidden=hidden, **settings), inputs, outputs)


def recorded(net: dict[str, Any]) -> tuple[FullyMeshed, np.ndarray]:
    """Return a recorded network and its parameters."""
    built = network(
        net["hidden"],
        net["inputs"],
        net["outputs"],
        iterations=net["iterations"],
        activation=ACTIVATIONS[net["activation"]],
    )
    table = [
        [*weights, bias]
        for weights, bias in zip(net["weights_into"], net["bias"], strict=True)
    ]
    return built, built.parameters([np.array(table, "<f4").tobytes()])[0]


def decide(
    built: FullyMeshed, parameters: np.ndarray, state: np.ndarray, observations: Any
) -> np.ndarray:
    actions = np.empty((len(observations), built.outputs), np.float32)
    for observation, action in zip(
        np.array(observations, np.float32), actions, strict=True
    ):
        FullyMeshed.step(parameters, state, observation, action)
    return actions


def tables(built: FullyMeshed, genomes: list[bytes]) -> np.ndarray:
    """(genomes, neurons, sources + 1) float32: weights, then the bias."""
    return np.array(
        [
            np.frombuffer(genome, "<f4").reshape(built.neurons, built.sources + 1)
            for genome in genomes
        ]
    )


def trace_genome(id_: int) -> bytes:
    return np.array(TRACE["genomes"][str(id_)], "<f4").tobytes()


def test_the_recorded_nets_cover_all_activations_and_sizes() -> None:
    assert {net["activation"] for net in NETS} == set(ACTIVATIONS)
    assert {(net["inputs"], net["hidden"], net["outputs"]) for net in NETS} == {
        (10, 2, 2),
        (3, 0, 1),
        (5, 6, 3),
    }
    assert {net["iterations"] for net in NETS} == {1, 2, 3}


@pytest.mark.parametrize("net", NETS, ids=lambda net: str(net["id"]))
def test_a_recorded_net_decides_as_in_frevo_bit_for_bit(net: dict[str, Any]) -> None:
    built, parameters = recorded(net)
    state = np.zeros(built.state_size, np.float32)
    assert (
        decide(built, parameters, state, net["in"]).tobytes()
        == np.array(net["out"], np.float32).tobytes()
    )
    continued = decide(built, parameters, state, net["in"][:3])
    assert continued.tobytes() == np.array(net["out_continued"], np.float32).tobytes(), (
        "the state is carried over"
    )


@pytest.mark.parametrize("net", NETS, ids=lambda net: str(net["id"]))
def test_plain_python_decides_the_same_bits_as_the_compiled_step(
    net: dict[str, Any],
) -> None:
    built, parameters = recorded(net)
    state, action = (
        np.zeros(built.state_size, np.float32),
        np.empty(built.outputs, np.float32),
    )
    for observation, expected in list(zip(net["in"], net["out"], strict=True))[:20]:
        with interpreted():
            built.step(parameters, state, np.array(observation, np.float32), action)
        assert action.tobytes() == np.array(expected, np.float32).tobytes()


@pytest.mark.parametrize("activation", ["clamp", "sigmoid", "relu", "tanh"])
@pytest.mark.parametrize("hidden", [0, 2, 7, 15])
@pytest.mark.parametrize("wild", [1.0, 1e38])
def test_eight_agents_in_lanes_decide_as_one_by_one(
    activation: str, hidden: int, wild: float
) -> None:
    """Sums that are infinite or NaN are compared, too."""
    built = network(
        hidden=hidden, inputs=3, outputs=2, activation=activation, iterations=3
    )
    genomes = (
        np.frombuffer(b"".join(built.random(8, Stream(hidden))), "<f4") * np.float32(wild)
    ).reshape(8, -1)
    rows = built.parameters([genome.tobytes() for genome in genomes])
    seen = Stream(6).uniform(-9.0, 9.0, 20 * 8 * 3).astype(np.float32).reshape(20, 8, 3)
    alone = np.array(
        [
            decide(
                built, rows[lane], np.zeros(built.state_size, np.float32), seen[:, lane]
            )
            for lane in range(8)
        ]
    )
    state, together = (
        np.zeros(8 * built.state_size, np.float32),
        np.empty((20, 2, 8), np.float32),
    )
    for observations, outputs in zip(seen, together, strict=True):
        FullyMeshed.step_lanes(
            rows.T.reshape(-1), state, observations.T.reshape(-1), outputs.reshape(-1)
        )
    assert np.array_equal(together.transpose(2, 0, 1), alone, equal_nan=True)
    assert np.isfinite(alone).all() or wild > 1.0


def test_every_activation_keeps_its_bounds() -> None:
    for activation, low, high in (
        ("clamp", 0.0, 1.0),
        ("sigmoid", 0.5, 1.0),
        ("relu", 0.0, 100.0),
        ("tanh", -1.0, 1.0),
    ):
        built = network(
            hidden=0, inputs=1, outputs=2, iterations=1, activation=activation
        )
        genome = np.array([[0, 0, 0, -100], [0, 0, 0, 100]], "<f4")
        if activation == "sigmoid":
            genome[0, -1] = 0  # in the middle
        actions = decide(
            built,
            built.parameters([genome.tobytes()])[0],
            np.zeros(built.state_size, np.float32),
            [[0]],
        )
        assert actions.tolist() == [[low, high]]


@pytest.mark.parametrize(
    "settings",
    [
        {"hidden": 0},
        {"hidden": 7, "iterations": 3, "activation": "sigmoid"},
        {"activation": "relu", "iterations": 1},
        {"activation": "tanh"},
    ],
)
def test_other_settings_keep_the_contract(settings: dict[str, Any]) -> None:
    check_representation(FullyMeshed, settings)


# ---- genomes


def test_a_genome_has_a_number_for_every_weight_and_bias() -> None:
    assert network().genome_bytes == 4 * 60
    assert network(hidden=0, inputs=3, outputs=1).genome_bytes == 4 * 5
    assert network(hidden=6, inputs=5, outputs=3).genome_bytes == 4 * 9 * 15


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_nonfinite_number_is_refused_in_any_field(bad: float) -> None:
    built = network(hidden=0, inputs=3, outputs=1)
    for place in range(5):
        genome = np.zeros(5, "<f4")
        genome[place] = bad
        with pytest.raises(ValueError, match="not finite"):
            built.parameters([genome.tobytes()])


def test_the_refusal_of_a_genome_names_both_lengths() -> None:
    with pytest.raises(
        ValueError, match="a genome has 239 bytes; this network takes 240"
    ):
        network().parameters([bytes(240), bytes(239)])


def test_random_weights_and_biases_fill_their_own_ranges() -> None:
    built = network(weight_range=3.0, bias_range=0.5)
    drawn = tables(built, built.random(2000, Stream(1)))
    weights, biases = drawn[..., :-1], drawn[..., -1]
    assert 2.99 < weights.max() <= 3.0
    assert -3.0 <= weights.min() < -2.99
    assert 0.49 < biases.max() <= 0.5
    assert -0.5 <= biases.min() < -0.49
    assert abs(weights.mean()) < 0.02
    assert abs(weights.var() - 3.0) < 0.03, "uniform: the range squared, by 3"


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"hidden": -1}, "hidden: expected int >= 0"),
        ({"iterations": 0}, "iterations: expected int >= 1"),
        (
            {"activation": "step"},
            "activation: expected clamp, sigmoid, relu or tanh, not 'step'",
        ),
        ({"weight_range": 0.0}, "weight_range: expected float > 0.0"),
    ],
)
def test_impossible_settings_are_refused(settings: dict[str, Any], text: str) -> None:
    with pytest.raises(ConfigError) as refusal:
        convert(settings, FullyMeshedSettings, "representation")
    assert str(refusal.value) == f"representation: {text}"


def test_the_defaults_are_frevos() -> None:
    assert msgspec.structs.asdict(FullyMeshedSettings()) == {
        "hidden": 2,
        "iterations": 2,
        "activation": "clamp",
        "weight_range": 2.0,
        "bias_range": 2.0,
    }


# ---- operators


def test_mutation_1_adds_a_uniform_number_of_severity_times_the_range_to_every_gene() -> (
    None
):
    """Severity 0.3 of a range of 2 is +-0.6, variance 0.12, as counted in FREVO's mutants."""
    built = network()
    parents = built.random(500, Stream(1))
    mutants = built.mutate(parents, Stream(2), method=1, severity=0.3, probability=1.0)
    change = tables(built, mutants).astype(float) - tables(built, parents)
    assert (change != 0).all()
    assert 0.59 < change.max() < 0.6 + 1e-6
    assert -0.6 - 1e-6 < change.min() < -0.59
    assert abs(change.mean()) < 0.01
    assert abs(change.var() - 0.12) < 0.003
    sixths = np.histogram(change, 6, (-0.6, 0.6))[0] / change.size
    assert np.allclose(sixths, 1 / 6, atol=0.01), "flat"


def test_the_mutations_of_frevo_stay_within_the_same_reach() -> None:
    for generation in TRACE["generations"]:
        for individual in generation["next"]:
            if individual["created_by"] == "Mutation":
                genomes = np.array(
                    [TRACE["genomes"][str(individual[who])] for who in ("id", "parent")]
                )
                change = np.abs(genomes[0] - genomes[1])
                assert 0.3 < change.max() <= 0.6 + 1e-6
                assert change.all()


def test_mutation_1_of_biases_follows_their_own_range() -> None:
    built = network(weight_range=1.0, bias_range=10.0)
    parents = built.random(500, Stream(1))
    mutants = built.mutate(parents, Stream(2), method=1, severity=0.5, probability=1.0)
    change = np.abs(tables(built, mutants) - tables(built, parents))
    assert 0.49 < change[..., :-1].max() <= 0.5 + 1e-6
    assert 4.9 < change[..., -1].max() <= 5.0 + 1e-5


def test_mutation_2_is_relative_for_large_positive_weights_only() -> None:
    """The step is w / 5 but at least 0.1; a negative weight always gets 0.1."""
    built = network(hidden=0, inputs=1, outputs=1)  # a genome: two weights and a bias
    for weight, reach in ((5.0, 1.0), (1.0, 0.2), (0.4, 0.1), (0.0, 0.1), (-50.0, 0.1)):
        parent = np.array([weight, weight, 0], "<f4")
        mutants = built.mutate(
            [parent.tobytes()] * 1000, Stream(3), method=2, severity=0.3, probability=1.0
        )
        change = np.abs(tables(built, mutants)[:, 0, :2].astype(float) - parent[:2])
        assert 0.97 * reach < change.max() < reach + 1e-5


def test_mutation_2_of_a_bias_is_at_least_10_and_a_whole_number() -> None:
    built = network(hidden=0, inputs=1, outputs=1)
    for bias, reach in ((0.0, 10.0), (-90.0, 10.0), (51.0, 10.0), (64.0, 12.0)):
        parent = np.array([0, 0, bias], "<f4")
        mutants = built.mutate(
            [parent.tobytes()] * 2000, Stream(3), method=2, severity=0.3, probability=1.0
        )
        change = np.abs(tables(built, mutants)[:, 0, 2].astype(float) - bias)
        assert reach - 0.1 < change.max() < reach + 1e-5


@pytest.mark.parametrize("method", [1, 2])
@pytest.mark.parametrize("probability", [0.01, 0.25])
def test_mutation_changes_the_given_share_of_genes(
    method: int, probability: float
) -> None:
    built = network()
    parents = built.random(1000, Stream(1))
    mutants = built.mutate(
        parents, Stream(2), method=method, severity=0.3, probability=probability
    )
    changed = (tables(built, mutants) != tables(built, parents)).mean()
    assert abs(changed - probability) < 0.1 * probability


def test_crossover_takes_one_block_of_neurons_of_the_father_cut_at_the_end() -> None:
    """Starts are uniform, lengths over 1..n-1 before the cut; never is the whole father taken."""
    built = network(hidden=3, outputs=2)  # 5 neurons
    mother, father = (
        np.full((5, built.sources + 1), value, "<f4").tobytes() for value in (1, 2)
    )
    stream = Stream(5)
    blocks: dict[tuple[int, int], int] = {}
    for _ in range(4000):
        child = tables(built, [built.crossover(mother, father, stream)])[0]
        from_father = child[:, 0] == 2
        assert (child == np.where(from_father, 2, 1)[:, None]).all(), (
            "a neuron comes with all its weights and its bias"
        )
        taken = np.flatnonzero(from_father)
        start, length = int(taken[0]), len(taken)
        assert (taken == np.arange(start, start + length)).all(), "one block"
        blocks[start, length] = blocks.get((start, length), 0) + 1
    expected = {
        (start, min(length, 5 - start)): sum(
            1 for other in range(1, 5) if min(other, 5 - start) == min(length, 5 - start)
        )
        for start in range(5)
        for length in range(1, 5)
    }
    assert blocks.keys() == expected.keys()
    for block, ways in expected.items():
        assert abs(blocks[block] / 4000 - ways / 20) < 0.03, block


def test_crossover_of_a_single_neuron_is_the_father() -> None:
    built = network(hidden=0, inputs=1, outputs=1)
    mother, father = built.random(2, Stream(1))
    assert built.crossover(mother, father, Stream(2)) == father


def test_crossover_can_produce_every_recorded_child() -> None:
    """Each recorded child has a stream that gives the same bytes and the recorded block."""
    built = network()
    children = [
        child
        for generation in TRACE["generations"]
        for child in generation["next"]
        if "father" in child
    ]
    assert len(children) == 15
    row = 4 * (built.sources + 1)
    for child in children:
        mother, father = trace_genome(child["mother"]), trace_genome(child["father"])
        begin, end = (
            child["first_neuron"] * row,
            (child["first_neuron"] + child["neurons"]) * row,
        )
        expected = mother[:begin] + father[begin:end] + mother[end:]
        assert trace_genome(child["id"]) == expected
        assert expected in {
            built.crossover(mother, father, Stream(seed)) for seed in range(100)
        }


@pytest.mark.parametrize(
    ("left", "right"), [(1, 1), (1, 2), (2, 1), (2, 5), (23, 1), (1, 40), (40, 40)]
)
def test_the_distance_is_the_sum_of_absolute_differences_added_in_gene_order(
    left: int, right: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(vector, "BLOCK", 60 * 40 * 7)  # 40 rows are no multiple of 7
    built = network()
    genomes = built.random(80, Stream(8))
    flat = tables(built, genomes).reshape(80, -1)
    total = np.zeros((left, right))
    for gene in flat.T:
        total += np.abs(gene[:left, None] - gene[-right:])
    assert built.distances(genomes[:left], genomes[-right:]).tobytes() == total.tobytes()


def test_the_recorded_mothers_got_a_father_far_from_them() -> None:
    """FREVO's father is the most different of eleven draws: by far most often the farthest."""
    built = network()
    farthest = 0
    attempts = 0
    for generation in TRACE["generations"]:
        pool = [id_ for id_, _ in generation["ranked"][:3]]
        for _, mother, father, *_ in generation["xover_attempts"]:
            distances = built.distances(
                [trace_genome(mother)], [trace_genome(id_) for id_ in pool]
            )[0]
            farthest += pool[int(np.argmax(distances))] == father
            attempts += 1
    assert farthest >= 0.9 * attempts
