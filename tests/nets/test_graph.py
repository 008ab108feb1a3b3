"""What a network's drawing has: the numbers by which it decides."""

import numpy as np
import pytest

from zswarm.kernels.random import Stream
from zswarm.nets.ctrnn import CTRNN, CtrnnSettings
from zswarm.nets.feed_forward import FeedForward, FeedForwardSettings
from zswarm.nets.graph import Graph
from zswarm.nets.mealy import Mealy, MealySettings
from zswarm.nets.neat import Neat, NeatNetworkSettings
from zswarm.plugins import registry as plugins

INPUTS, OUTPUTS = 3, 2


def built(kind: str) -> tuple[Graph, bytes]:
    loaded = plugins.load("representation", kind)
    network = loaded(loaded.settings_type(), INPUTS, OUTPUTS)
    (genome,) = network.random(1, Stream(3))
    return network.graph(genome), genome


def weight(graph: Graph, source: int, target: int) -> float:
    (found,) = [
        edge.weight
        for edge in graph.edges
        if (edge.source, edge.target) == (source, target)
    ]
    return found


@pytest.mark.parametrize("kind", plugins.BUNDLED["representation"])
def test_every_kind_of_network_is_drawn(kind: str) -> None:
    graph, _ = built(kind)
    assert graph.nodes
    assert graph.edges or len(graph.nodes) == 1  # a machine of one state


def test_a_drawn_layered_network_decides_as_the_network_does() -> None:
    """Its weights and biases, summed from input to output."""
    network = FeedForward(
        FeedForwardSettings(hidden=[4], activation="clamp", output_activation="clamp"),
        INPUTS,
        OUTPUTS,
    )
    (genome,) = network.random(1, Stream(5))
    graph, observation = network.graph(genome), np.array([0.2, 0.5, 0.9], np.float32)
    values = [*observation.tolist()]
    for place, node in enumerate(graph.nodes[INPUTS:], INPUTS):
        total = float(node.text.removeprefix("bias "))
        total += sum(
            values[edge.source] * edge.weight
            for edge in graph.edges
            if edge.target == place
        )
        values.append(min(1.0, max(0.0, total)))
    decided = np.zeros(OUTPUTS, np.float32)
    network.step(
        network.parameters([genome])[0],
        np.zeros(network.state_size, np.float32),
        observation,
        decided,
    )
    assert values[-OUTPUTS:] == pytest.approx(decided.tolist(), abs=5e-3)


def test_a_meshed_networks_weights_stand_where_its_genome_has_them() -> None:
    """Per neuron those of all nodes, then its bias."""
    graph, genome = built("fully-meshed")
    table = np.frombuffer(genome, "<f4").reshape(4, INPUTS + 4 + 1)
    assert [node.kind for node in graph.nodes] == ["input"] * 3 + ["hidden"] * 2 + [
        "output"
    ] * 2
    assert weight(graph, 1, INPUTS + 3) == table[3, 1]
    assert weight(graph, INPUTS + 2, INPUTS) == table[0, INPUTS + 2]
    assert graph.nodes[INPUTS].text == f"bias {table[0, -1]:.4g}"


def test_the_graph_of_a_ctrnn_shows_time_constants() -> None:
    network = CTRNN(CtrnnSettings(tau_min=2.0, tau_max=6.0), INPUTS, OUTPUTS)
    genome = np.zeros(network.genes, "<f4").tobytes()
    assert {node.text for node in network.graph(genome).nodes[INPUTS:]} == {
        "bias 0, tau 4"
    }


def test_links_that_are_disabled_are_not_drawn() -> None:
    network = Neat(NeatNetworkSettings(add_node=1.0), INPUTS, OUTPUTS)
    before = network.random(1, Stream(3))
    (after,) = network.mutate(before, Stream(4), method=1, severity=0.1, probability=0.0)
    graph = network.graph(after)
    assert [node.kind for node in graph.nodes] == ["input"] * 3 + ["hidden"] + [
        "output"
    ] * 2
    assert len(graph.edges) == INPUTS * OUTPUTS - 1 + 2, (
        "one was split: it is off, and two are new"
    )


def test_a_machines_transitions_are_counted() -> None:
    """All combinations of inputs lead from each state to some state."""
    network = Mealy(MealySettings(states=3), INPUTS, OUTPUTS)
    (genome,) = network.random(1, Stream(3))
    graph = network.graph(genome)
    assert [node.kind for node in graph.nodes] == ["state"] * 3
    for state in range(3):
        assert sum(
            edge.weight for edge in graph.edges if edge.source == state
        ) == pytest.approx(1.0)


def test_networks_of_one_genome_are_drawn_apart() -> None:
    graph, _ = built("bulk")
    assert {node.part for node in graph.nodes} == {0, 1}
    assert all(
        graph.nodes[edge.source].part == graph.nodes[edge.target].part
        for edge in graph.edges
    )
