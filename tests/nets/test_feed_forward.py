"""Feed-forward networks decide and breed as FREVO's layered networks do, bit for bit."""

import contextlib
import json
from typing import Any

import numpy as np
import pytest

from tests.repository import REPOSITORY
from zswarm.config.decode import convert
from zswarm.errors import ConfigError
from zswarm.kernels.jit import interpreted
from zswarm.kernels.random import Stream
from zswarm.nets.feed_forward import (
    FeedForward,
    FeedForwardSettings,
    Layered,
    ThreeLayer,
    ThreeLayerSettings,
)
from zswarm.testing import check_representation

GOLDEN = REPOSITORY / "tests" / "golden"
THREE_LAYER = json.loads((GOLDEN / "threelayer.json").read_text())["nets"]
MULTI_LAYER = json.loads((GOLDEN / "multilayer.json").read_text())["nets"]


def network(
    hidden: list[int], inputs: int = 3, outputs: int = 2, **settings: Any
) -> FeedForward:
    return FeedForward(FeedForwardSettings(hidden=hidden, **settings), inputs, outputs)


def layers(net: dict[str, Any]) -> list[tuple[Any, Any]]:
    """Per layer of a recorded net the weights to each node, and the biases."""
    if "weights_hidden" in net:
        return [
            (net["weights_hidden"], net["bias_hidden"]),
            (net["weights_output"], net["bias_output"]),
        ]
    hidden = [net["weights_first"], *net["weights_between"]]
    return [
        *zip(hidden, net["bias_hidden"], strict=True),
        (net["weights_output"], net["bias_output"]),
    ]


def recorded(net: dict[str, Any]) -> tuple[Layered, bytes]:
    """Return a recorded network and its genome."""
    numbers = [
        [*weights, bias]
        for layer in layers(net)
        for weights, bias in zip(*layer, strict=True)
    ]
    genome = np.concatenate(numbers).astype("<f4").tobytes()
    if "weights_hidden" in net:
        return ThreeLayer(
            ThreeLayerSettings(hidden=net["hidden"]), net["inputs"], net["outputs"]
        ), genome
    return network(
        [net["nodes_per_layer"]] * net["hidden_layers"], net["inputs"], net["outputs"]
    ), genome


def decide(built: Layered, genome: bytes, observations: Any, step: Any) -> np.ndarray:
    state, parameters = (
        np.zeros(built.state_size, np.float32),
        built.parameters([genome])[0],
    )
    actions = np.empty((len(observations), built.outputs), np.float32)
    for observation, action in zip(
        np.array(observations, np.float32), actions, strict=True
    ):
        step(parameters, state, observation, action)
    return actions


def test_the_recorded_nets_have_one_to_three_hidden_layers() -> None:
    assert {len(layers(net)) for net in [*THREE_LAYER, *MULTI_LAYER]} == {2, 3, 4}
    assert {net["stepNumber"] for net in THREE_LAYER} == {1, 2}, "which has no effect"


@pytest.mark.parametrize(
    "net", [*THREE_LAYER, *MULTI_LAYER], ids=lambda net: f"{len(layers(net))}-{net['id']}"
)
def test_a_recorded_net_decides_as_in_frevo_bit_for_bit_compiled_and_plain(
    net: dict[str, Any],
) -> None:
    built, genome = recorded(net)
    expected = np.array([*net["out"], *net["out_continued"]], np.float32).tobytes()
    for compiled_or_plain in (contextlib.nullcontext, interpreted):
        with compiled_or_plain():
            decided = decide(built, genome, [*net["in"], *net["in"][:3]], built.step)
        assert decided.tobytes() == expected


def test_a_net_of_three_layers_is_a_feed_forward_one_with_one_hidden_layer() -> None:
    """Same genomes, same parameters, same operators."""
    three, feed = ThreeLayer(ThreeLayerSettings(hidden=5), 4, 3), network([5], 4, 3)
    genomes = three.random(4, Stream(1))
    assert feed.random(4, Stream(1)) == genomes
    assert feed.parameters(genomes).tobytes() == three.parameters(genomes).tobytes()
    assert three.step is feed.step


@pytest.mark.parametrize("hidden", [[], [1], [9, 3], [2, 17, 2]])
def test_the_output_is_that_of_each_layer_in_turn(hidden: list[int]) -> None:
    """Counted by hand in the order of the layout, with tanh and clamp in place of sigmoid."""
    built = network(hidden, activation="relu", output_activation="clamp")
    (genome,) = built.random(1, Stream(2))
    seen = Stream(3).uniform(-2.0, 2.0, 3).astype(np.float32)
    numbers, values = iter(np.frombuffer(genome, "<f4")), list(seen)
    for nodes in [*hidden, 2]:
        sums = []
        for _ in range(nodes):
            total = np.float32(0)
            for value in values:
                total = total + next(numbers) * value
            sums.append(next(numbers) + total)
        values = [max(total, np.float32(0)) for total in sums]
    expected = [min(value, np.float32(1)) for value in values]
    assert decide(built, genome, [seen], built.step)[0].tolist() == expected
    assert next(numbers, None) is None


@pytest.mark.parametrize("hidden", [[], [4], [9, 3]])
@pytest.mark.parametrize("activation", ["clamp", "sigmoid", "relu", "tanh"])
def test_all_settings_keep_the_contract(hidden: list[int], activation: str) -> None:
    check_representation(
        FeedForward,
        {"hidden": hidden, "activation": activation, "output_activation": activation},
    )


def test_a_feed_forward_network_remembers_nothing() -> None:
    built = network([4, 4])
    (genome,) = built.random(1, Stream(1))
    once = decide(built, genome, [[1, 2, 3]], built.step)
    after = decide(built, genome, [[5, -5, 5], [1, 2, 3]], built.step)
    assert after[1].tolist() == once[0].tolist()


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"hidden": [0]}, "hidden[0]: expected int >= 1"),
        ({"hidden": [1] * 9}, "hidden: expected array of length <= 8"),
        ({"hidden": 3}, "hidden: expected array, got int"),
        (
            {"output_activation": "step"},
            "output_activation: expected clamp, sigmoid, relu or tanh, not 'step'",
        ),
    ],
)
def test_impossible_settings_are_refused(settings: dict[str, Any], text: str) -> None:
    with pytest.raises(ConfigError) as refusal:
        convert(settings, FeedForwardSettings, "representation")
    assert str(refusal.value) == f"representation: {text}"


# ---- operators


def test_crossover_takes_whole_nodes_from_every_layer() -> None:
    """A node of the father comes with all its weights and its bias; blocks span layers."""
    built = network([3, 2], inputs=4, outputs=1)
    assert np.diff(built.blocks).tolist() == [5, 5, 5, 4, 4, 3]
    mother, father = (np.full(built.genes, value, "<f4").tobytes() for value in (1, 2))
    stream, taken = Stream(5), set()
    for _ in range(500):
        child = np.frombuffer(built.crossover(mother, father, stream), "<f4") == 2
        nodes = [
            child[begin:end]
            for begin, end in zip(built.blocks, built.blocks[1:], strict=False)
        ]
        assert all(node.all() or not node.any() for node in nodes)
        taken.add(tuple(bool(node.all()) for node in nodes))
    assert len(taken) == 20, "blocks of 1 to 5 of 6 nodes: never all"


def test_mutation_2_moves_weights_and_biases_by_10_at_least() -> None:
    built = network([3])
    mutants = built.mutate(
        [bytes(built.genome_bytes)] * 1000,
        Stream(3),
        method=2,
        severity=0.3,
        probability=1.0,
    )
    changes = np.abs(np.array([np.frombuffer(mutant, "<f4") for mutant in mutants])).max(
        axis=0
    )
    assert ((changes > 9.9) & (changes <= 10.0)).all()


def test_the_distance_is_the_mean_difference_in_ranges() -> None:
    built = network([2], inputs=1, outputs=1, weight_range=4.0, bias_range=0.5)
    assert built.ranges.tolist() == [4, 0.5, 4, 0.5, 4, 4, 0.5]
    other = np.array([4, 0, 0, 0.25, 0, 0, -0.5], "<f4")
    assert built.distances([bytes(28)], [other.tobytes()]).tolist() == [
        [(1 + 0.5 + 1) / 7]
    ]
