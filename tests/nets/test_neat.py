"""NEAT's networks decide as FREVO's, bit for bit; their operators follow the paper."""

import json
import struct
from typing import Any

import numpy as np
import pytest

from tests.repository import REPOSITORY
from zswarm.kernels.random import Stream
from zswarm.nets import neat_kernel
from zswarm.nets.neat import Neat, NeatNetworkSettings
from zswarm.nets.neat_genome import LINK, NODE, Genes
from zswarm.testing import check_representation

NETS = json.loads((REPOSITORY / "tests" / "golden" / "neat.json").read_text())["nets"]
PLAIN = getattr(Neat.step, "py_func", Neat.step)


def network(inputs: int = 2, outputs: int = 1, **settings: Any) -> Neat:
    return Neat(NeatNetworkSettings(**settings), inputs, outputs)


def genome(nodes: list[tuple[Any, ...]], links: list[tuple[Any, ...]]) -> bytes:
    """Return the genome of nodes (id, bias, factor), links (source, target, weight, enabled)."""
    return Genes(np.array(nodes, NODE), np.array(links, LINK)).genome()


def taken_apart(encoded: bytes) -> tuple[list[Any], list[Any]]:
    nodes, links = struct.unpack_from("<II", encoded)
    middle = 8 + 24 * nodes
    return np.frombuffer(encoded, NODE, nodes, 8).tolist(), np.frombuffer(
        encoded, LINK, links, middle
    ).tolist()


def recorded(net: dict[str, Any]) -> tuple[Neat, np.ndarray]:
    """A recorded net and its parameters; outputs come first, hidden neurons stay in their order."""
    nodes = [
        node
        for kind in ("output", "hidden")
        for node in net["nodes"]
        if node["type"] == kind
    ]
    encoded = genome(
        [(node["id"], node["bias"], node["sigmoid_factor"]) for node in nodes],
        [
            (link["from"], link["to"], link["weight"], link["enabled"])
            for link in net["links"]
        ],
    )
    built = network(
        net["inputs"], net["outputs"], recurrent=True, iterations=net["iterations"]
    )
    return built, built.parameters([encoded])[0]


def decide(
    built: Neat, parameters: np.ndarray, observations: Any, step: Any = Neat.step
) -> np.ndarray:
    """Return the network's decisions from the start of a trial on."""
    state = np.zeros(built.state_size, np.float32)
    actions = np.empty((len(observations), built.outputs), np.float32)
    for observation, action in zip(
        np.array(observations, np.float32), actions, strict=True
    ):
        step(parameters, state, observation, action)
    return actions


def evolved(built: Neat, generations: int = 30, count: int = 20) -> list[bytes]:
    """Return genomes after this many mutations and crossovers."""
    stream = Stream(1)
    genomes = built.random(count, stream)
    for _ in range(generations):
        genomes = built.mutate(genomes, stream, method=1, severity=0.3, probability=1.0)
        genomes = [
            built.crossover(a, b, stream)
            for a, b in zip(genomes, genomes[1:] + genomes[:1], strict=True)
        ]
    return genomes


GROWING = {"add_node": 0.3, "add_link": 0.6}
PLAIN_NODE = (3, 0.0, -4.9)
BOTH = [(1, 3, 0.5, 1), (2, 3, -0.5, 1)]


# ---- decisions


def test_the_recorded_nets_cover_every_structure_that_frevo_creates() -> None:
    """Disabled links, duplicate nodes and links, and a link from a neuron to itself."""
    links = [[(link["from"], link["to"]) for link in net["links"]] for net in NETS]
    ids = [[node["id"] for node in net["nodes"]] for net in NETS]
    assert any(not link["enabled"] for net in NETS for link in net["links"])
    assert any(len(set(of)) < len(of) for of in ids)
    assert any(len(set(of)) < len(of) for of in links)
    assert any(source == target for of in links for source, target in of)


@pytest.mark.parametrize("net", NETS, ids=lambda net: str(net["id"]))
def test_a_recorded_net_decides_as_in_frevo_bit_for_bit(net: dict[str, Any]) -> None:
    built, parameters = recorded(net)
    assert (
        decide(built, parameters, net["in"]).tobytes()
        == np.array(net["out"], np.float32).tobytes()
    )
    again = decide(built, parameters, net["in"][:3])
    assert again.tobytes() == np.array(net["out_continued"], np.float32).tobytes(), (
        "a clone starts from zero"
    )


@pytest.mark.parametrize("net", NETS, ids=lambda net: str(net["id"]))
def test_plain_python_decides_the_same_bits_as_the_compiled_step(
    net: dict[str, Any],
) -> None:
    built, parameters = recorded(net)
    assert (
        decide(built, parameters, net["in"], PLAIN).tobytes()
        == np.array(net["out"], np.float32).tobytes()
    )


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"recurrent": True},
        {"factor_range": 1.0, **GROWING},
        {"recurrent": True, **GROWING},
    ],
)
def test_all_settings_keep_the_contract(settings: dict[str, Any]) -> None:
    check_representation(Neat, settings)


@pytest.mark.parametrize(
    "number",
    [
        0.0,
        -0.0,
        1.0,
        -1 / 3,
        1e-300,
        5e-324,
        1.7976931348623157e308,
        float("inf"),
        float("nan"),
    ],
)
def test_three_float32_store_any_float64(number: float) -> None:
    kept = np.full(5, 7, np.float32)
    getattr(neat_kernel.store_double, "py_func", neat_kernel.store_double)(
        kept, 1, number
    )
    read = getattr(neat_kernel.load_double, "py_func", neat_kernel.load_double)(kept, 1)
    assert struct.pack("<d", read) == struct.pack("<d", number)
    assert kept[[0, 4]].tolist() == [7, 7]
    assert np.isfinite(kept).all(), "no pattern that a processor might change"


def test_a_network_that_leads_forward_is_swept_once_with_the_same_bits() -> None:
    built = network(4, 2, **GROWING)
    rows = built.parameters(evolved(built))
    seen = Stream(2).uniform(-2.0, 2.0, 40).reshape(10, 4)
    assert set(rows[:, 0]) == {1}
    for row in rows:
        once = decide(built, row, seen)
        row[0] = 3
        assert decide(built, row, seen).tobytes() == once.tobytes()


def test_a_recurrent_network_remembers_and_a_forward_one_does_not() -> None:
    link_to_itself = genome([PLAIN_NODE], [*BOTH, (3, 3, 1.0, 1)])
    for settings, encoded, remembers in (
        ({"recurrent": True}, link_to_itself, True),
        ({}, genome([PLAIN_NODE], BOTH), False),
    ):
        built = network(**settings)
        first, second = decide(
            built, built.parameters([encoded])[0], [[1, 0.2], [1, 0.2]]
        )
        assert (first[0] != second[0]) == remembers


def test_hidden_neurons_sum_their_links_subtract_the_bias_and_bend() -> None:
    """The expected value is 1 / (1 + exp(-(2 * tanh(0.6 - 0.1) - 0.25)))."""
    built = network()
    encoded = genome(
        [(3, 0.25, -1.0), (9, 0.1, 0.0)], [(1, 9, 0.6, 1), (2, 9, 5.0, 0), (9, 3, 2.0, 1)]
    )
    assert decide(built, built.parameters([encoded])[0], [[1, 1]])[0, 0] == pytest.approx(
        0.66245, abs=1e-5
    )


# ---- genomes


@pytest.mark.parametrize(
    ("nodes", "links", "text"),
    [
        ([], [], "are not 0 nodes and 0 links"),
        ([(2, 0, 0)], [], "must begin with the outputs, 3 to 3"),
        ([PLAIN_NODE, (1, 0, 0)], BOTH, "has a gene for an input"),
        ([PLAIN_NODE], [(1, 4, 1.0, 1)], "a link of node 4, which is missing"),
        ([PLAIN_NODE], [(0, 3, 1.0, 1)], "a link of node 0, which is missing"),
        ([PLAIN_NODE], [(1, 2, 1.0, 1)], "a link that ends at an input"),
        ([PLAIN_NODE], [(1, 3, np.nan, 1)], "not finite"),
        ([PLAIN_NODE], [(1, 3, np.inf, 0)], "not finite"),
        ([(3, np.nan, 0)], BOTH, "not finite"),
        ([(3, 0, np.inf)], BOTH, "not finite"),
        ([PLAIN_NODE], [(1, 3, 1.0, 2)], "neither enabled"),
        (
            [PLAIN_NODE, (4, 0, 0), (5, 0, 0), (6, 0, 0)],
            BOTH,
            "3 hidden neurons; max_hidden is 2",
        ),
        (
            [PLAIN_NODE],
            [(3, 3, 1.0, 1)],
            "starts at an output; that takes recurrent = true",
        ),
        (
            [PLAIN_NODE, (4, 0, 0)],
            [(4, 4, 1.0, 1)],
            "in a circle; that takes recurrent = true",
        ),
        (
            [PLAIN_NODE, (4, 0, 0), (5, 0, 0)],
            [(4, 5, 1.0, 1), (5, 4, 1.0, 0)],
            "in a circle",
        ),
    ],
)
def test_a_malformed_genome_is_refused(
    nodes: list[Any], links: list[Any], text: str
) -> None:
    """Circles also where a link of them is disabled, for crossover might enable it."""
    built = network(max_hidden=2)
    good = genome([PLAIN_NODE], BOTH)
    with pytest.raises(ValueError, match=text):
        built.parameters([good, genome(nodes, links)])


def test_cycles_are_allowed_in_recurrent_networks_and_any_order_without_cycles() -> None:
    network(recurrent=True).parameters(
        [genome([PLAIN_NODE, (4, 0, 0)], [(4, 4, 1.0, 1), (3, 4, 1.0, 1)])]
    )
    backward = genome(
        [PLAIN_NODE, (4, 0, 0), (5, 0, 0)],
        [(5, 4, 1.0, 1), (4, 3, 1.0, 1), (1, 5, 1.0, 1)],
    )
    assert network().parameters([backward])[0, 0] == 3, (
        "not in order: it takes more than one sweep"
    )


def test_counts_that_do_not_fit_the_length_are_refused() -> None:
    good = genome([PLAIN_NODE], BOTH)
    for wrong in (
        good + bytes(25),
        good[:-25],
        struct.pack("<II", 2**32 - 1, 2**32 - 1) + good[8:],
        good[:7],
    ):
        with pytest.raises(ValueError, match="a genome has"):
            network().parameters([wrong])


def test_genomes_of_all_sizes_fit_in_one_batch_and_decide_as_alone() -> None:
    built = network(3, 2, **GROWING)
    genomes = [*built.random(2, Stream(3)), *evolved(built)]
    assert len({len(each) for each in genomes}) > 5
    together = built.parameters(genomes)
    for row, each in zip(together, genomes, strict=True):
        (alone,) = built.parameters([each])
        assert row[: len(alone)].tobytes() == alone.tobytes()
        assert not row[len(alone) :].any()
        assert (
            decide(built, row, [[0.1, 0.2, 0.3]]).tobytes()
            == decide(built, alone, [[0.1, 0.2, 0.3]]).tobytes()
        )


def test_new_genomes_are_without_hidden_neurons_and_link_all_inputs_with_all_outputs() -> (
    None
):
    for encoded in network(3, 2, factor_range=0.5).random(50, Stream(1)):
        nodes, links = taken_apart(encoded)
        assert [node[0] for node in nodes] == [4, 5]
        assert sorted(link[:2] for link in links) == [
            (source, target) for source in (1, 2, 3) for target in (4, 5)
        ]
        assert all(abs(number) <= 2 for _, _, number, _ in links)
        assert all(
            abs(bias) <= 2 and abs(factor + 4.9) <= 0.5 for _, bias, factor in nodes
        )


# ---- mutations


def mutant(built: Neat, encoded: bytes, seed: int = 1, **options: Any) -> bytes:
    return built.mutate(
        [encoded],
        Stream(seed),
        **{"method": 1, "severity": 0.3, "probability": 1.0, **options},
    )[0]


def test_a_mutation_of_numbers_changes_the_child() -> None:
    """FREVO's does not: it makes a new gene and drops it."""
    built = network(add_node=0.0, add_link=0.0, replace=0.0, factor_range=1.0)
    parent = built.random(1, Stream(1))[0]
    (nodes, links), (nodes_before, links_before) = (
        taken_apart(mutant(built, parent)),
        taken_apart(parent),
    )
    for (_, _, weight, _), (_, _, before, _) in zip(links, links_before, strict=True):
        assert 0 < abs(weight - before) <= 0.6
    assert 0 < abs(nodes[0][1] - nodes_before[0][1]) <= 0.6
    assert 0 < abs(nodes[0][2] - nodes_before[0][2]) <= 0.3


def test_factors_with_an_empty_range_do_not_change() -> None:
    built = network(add_node=0.0, add_link=0.0)
    assert all(
        taken_apart(mutant(built, each))[0][0][2] == -4.9
        for each in built.random(20, Stream(1))
    )


def test_numbers_change_with_the_given_probability() -> None:
    built = network(20, 10, add_node=0.0, add_link=0.0)
    parents = built.random(20, Stream(1))
    mutants = built.mutate(parents, Stream(2), method=1, severity=0.3, probability=0.25)
    changed = [
        weight != before
        for pair in zip(mutants, parents, strict=True)
        for (_, _, weight, _), (_, _, before, _) in zip(
            *(taken_apart(each)[1] for each in pair), strict=True
        )
    ]
    assert abs(np.mean(changed) - 0.25) < 0.03


def test_a_redrawn_number_fills_its_range() -> None:
    built = network(50, 20, add_node=0.0, add_link=0.0, replace=1.0, weight_range=3.0)
    weights = [
        link[2]
        for link in taken_apart(
            mutant(built, built.random(1, Stream(1))[0], severity=1e-9)
        )[1]
    ]
    assert 2.9 < max(weights) <= 3
    assert -3 <= min(weights) < -2.9


def test_method_2_does_not_change_the_structure() -> None:
    built = network(add_node=1.0, add_link=1.0)
    parent = built.random(1, Stream(1))[0]
    assert built.structure(mutant(built, parent, method=2)) == (0, 2)
    assert built.structure(mutant(built, parent, method=1)) == (1, 3)


def test_a_new_node_splits_a_link_that_is_disabled_by_it() -> None:
    """The link into it has weight 1, that out of it the old one; other numbers stay."""
    built = network(add_node=1.0)
    child_nodes, child_links = taken_apart(
        mutant(built, genome([PLAIN_NODE], [(1, 3, 0.5, 1)]))
    )
    (_, (new, bias, factor)) = child_nodes
    assert (bias, factor) == (0, 0)
    assert child_nodes[0] == PLAIN_NODE
    assert child_links == [(1, 3, 0.5, 0), (1, new, 1.0, 1), (new, 3, 0.5, 1)]


def test_the_same_change_has_the_same_number_everywhere() -> None:
    encoded, other = (
        genome([PLAIN_NODE], [(1, 3, 0.5, 1)]),
        genome([PLAIN_NODE, (7, 0, 0)], [(1, 7, 2.0, 0), (1, 3, 0.1, 1)]),
    )
    numbers = {
        taken_apart(mutant(network(add_node=1.0), each, seed))[0][-1][0]
        for each in (encoded, other)
        for seed in (1, 2)
    }
    assert numbers == {int.from_bytes(bytes.fromhex("8f56176501aa3443"), "little")}, (
        "the hash of 1, 3 and 0, as documented"
    )


def test_a_link_that_is_split_twice_gets_two_nodes() -> None:
    """FREVO gives both one id, and one of them has no effect."""
    built = network(add_node=1.0)
    nodes, links = taken_apart(mutant(built, genome([PLAIN_NODE], [(1, 3, 0.5, 1)])))
    links = [
        (source, target, weight, int((source, target) == (1, 3)))
        for source, target, weight, _ in links
    ]
    again = mutant(built, genome(nodes, links))
    assert len({node[0] for node in taken_apart(again)[0]}) == 3


def test_a_new_link_joins_two_nodes_that_had_none() -> None:
    built = network(add_node=0.0, add_link=1.0)
    parent = genome(
        [PLAIN_NODE, (9, 0, 0)], [(1, 3, 0.5, 1), (1, 9, 0.5, 1), (9, 3, 0.5, 1)]
    )
    added = {taken_apart(mutant(built, parent, seed))[1][-1][:2] for seed in range(20)}
    assert added == {(2, 3), (2, 9)}
    recurrent = network(add_node=0.0, add_link=1.0, recurrent=True)
    added = {
        taken_apart(mutant(recurrent, parent, seed))[1][-1][:2] for seed in range(60)
    }
    assert added == {(2, 3), (2, 9), (3, 3), (3, 9), (9, 9)}


def test_a_network_with_all_links_changes_its_numbers_instead() -> None:
    built = network(add_node=0.0, add_link=1.0)
    parent = built.random(1, Stream(1))[0]
    assert len(mutant(built, parent)) == len(parent)
    assert mutant(built, parent) != parent


@pytest.mark.parametrize("recurrent", [False, True])
def test_evolution_respects_the_size_limit_and_makes_cycles_only_if_allowed(
    recurrent: bool,
) -> None:
    built = network(2, 2, max_hidden=4, recurrent=recurrent, **GROWING)
    genomes = evolved(built, 60, 10)
    rows = built.parameters(genomes)  # which refuses what is not allowed
    assert max(built.structure(each)[0] for each in genomes) == 4
    assert set(rows[:, 0]) == ({3} if recurrent else {1})


def test_structure_changes_with_the_chances_of_the_settings() -> None:
    built = network(6, 2, add_node=0.1, add_link=0.2)
    parents = [genome([(7, 0, 0), (8, 0, 0)], [(1, 7, 1.0, 1)])] * 2000
    mutants = built.mutate(parents, Stream(1), method=1, severity=0.3, probability=1.0)
    sizes = [built.structure(each) for each in mutants]
    assert abs(sizes.count((1, 2)) / 2000 - 0.1) < 0.02
    assert abs(sizes.count((0, 2)) / 2000 - 0.9 * 0.2) < 0.03


# ---- crossover and distance

MOTHER = genome(
    [(3, 1.0, -4.9), (9, 1.0, 0.0)],
    [(1, 3, 1.0, 0), (2, 3, 1.0, 1), (1, 9, 1.0, 1), (9, 3, 1.0, 1)],
)
FATHER = genome(
    [(3, 2.0, -4.9), (8, 2.0, 0.0)],
    [(2, 3, 2.0, 0), (1, 3, 2.0, 1), (2, 8, 2.0, 1), (8, 3, 2.0, 1)],
)


def test_a_child_has_the_mothers_structure_and_either_parents_numbers_where_both_have_them() -> (
    None
):
    built, stream = network(), Stream(1)
    seen = set()
    for _ in range(200):
        nodes, links = taken_apart(built.crossover(MOTHER, FATHER, stream))
        assert [node[0] for node in nodes] == [3, 9]
        assert [link[:2] for link in links] == [(1, 3), (2, 3), (1, 9), (9, 3)], (
            "matched by what they are, not by place"
        )
        assert nodes[1][1] == links[2][2] == links[3][2] == 1, "only the mother has them"
        seen.add((nodes[0][1], links[0][2], links[1][2]))
    assert len(seen) == 8, "each number by itself"


def test_a_gene_disabled_in_one_parent_is_usually_disabled_in_the_child() -> None:
    built, stream = network(), Stream(1)
    children = [
        taken_apart(built.crossover(MOTHER, FATHER, stream))[1] for _ in range(1000)
    ]
    assert abs(np.mean([links[0][3] == 0 for links in children]) - 0.75) < 0.04
    assert abs(np.mean([links[1][3] == 0 for links in children]) - 0.75) < 0.04
    assert all(links[2][3] == links[3][3] == 1 for links in children)


def test_the_distance_counts_links_of_one_and_differences_of_both() -> None:
    """Two links of each are unmatched; the differences are 1, 1, 1 and 0: 4 + 0.4 * 3 / 4."""
    assert network().distances([MOTHER], [FATHER])[0, 0] == pytest.approx(4 + 0.4 * 3 / 4)
    weighted = network(unmatched_coefficient=0.5, weight_coefficient=2.0)
    assert weighted.distances([MOTHER], [FATHER])[0, 0] == pytest.approx(2 + 2 * 3 / 4)


def test_genomes_of_frevo_with_twins_can_be_compared_and_crossed() -> None:
    twins = genome(
        [(3, 1.0, -4.9), (9, 1.0, 0.0), (9, 5.0, 0.0)],
        [(1, 9, 1.0, 1), (1, 9, 2.0, 1), (9, 3, 1.0, 1)],
    )
    built = network()
    assert built.distances([twins], [twins])[0, 0] == 0
    child = built.crossover(twins, twins, Stream(1))
    assert taken_apart(child) == (
        [(3, 1.0, -4.9), (9, 1.0, 0.0)],
        taken_apart(twins)[1],
    ), "the dead twin is left out"
    assert built.parameters([child]).tobytes() == built.parameters([twins]).tobytes()
