"""Of several networks in a genome that one decides which an input names; operators act on parts."""

from typing import Any

import numpy as np
import pytest

from zswarm.config.decode import convert
from zswarm.errors import ConfigError
from zswarm.kernels.random import Stream
from zswarm.nets.bulk import Bulk, BulkSettings
from zswarm.plugins import registry as plugins
from zswarm.testing import check_representation


def network(
    parts: int = 3, inputs: int = 4, outputs: int = 2, chosen_by: int = 1, **of: Any
) -> Bulk:
    given = {"parts": parts, "input": chosen_by, "of": {"kind": "fully-meshed", **of}}
    return Bulk(convert(given, BulkSettings, "representation"), inputs, outputs)


def decide(built: Any, genome: bytes, observations: Any) -> np.ndarray:
    state, parameters = (
        np.zeros(built.state_size, np.float32),
        built.parameters([genome])[0],
    )
    actions = np.empty((len(observations), built.outputs), np.float32)
    for observation, action in zip(
        np.array(observations, np.float32), actions, strict=True
    ):
        built.step(parameters, state, observation, action)
    return actions


@pytest.mark.parametrize(
    ("value", "part"),
    [(0, 0), (1, 1), (2, 2), (0.4, 0), (0.6, 1), (-3, 0), (7, 2), (1e30, 2), (-1e30, 0)],
)
def test_the_input_selects_the_nearest_part(value: float, part: int) -> None:
    built = network(activation="tanh")
    genome = np.frombuffer(built.random(1, Stream(1))[0], "<f4").reshape(3, 4, 9).copy()
    genome[:, :, 1] = 0  # the input chooses, and is not heard
    parts = [of_part.tobytes() for of_part in genome]
    seen = [[0.5, value, -1, 2]]
    decided = decide(built, genome.tobytes(), seen).tobytes()
    assert [decided == decide(built.part, one, seen).tobytes() for one in parts] == [
        number == part for number in range(3)
    ]


def test_a_part_remembers_only_its_own_decisions() -> None:
    built = network(parts=2, hidden=3)
    (genome,) = built.random(1, Stream(2))
    seen = Stream(3).uniform(-1.0, 1.0, 4 * 12).reshape(12, 4)
    seen[:, 1] = np.arange(12) % 3 == 0
    decided = decide(built, genome, seen)
    for part in (0, 1):
        alone = decide(built.part, built._split([genome])[part], seen[seen[:, 1] == part])
        assert decided[seen[:, 1] == part].tobytes() == alone.tobytes()


@pytest.mark.parametrize("kind", sorted({*plugins.BUNDLED["representation"]} - {"bulk"}))
def test_parts_may_be_of_every_kind_whose_genomes_have_one_length(kind: str) -> None:
    settings = {"parts": 3, "input": 1, "of": {"kind": kind}}
    part = plugins.load("representation", kind)
    if part(part.settings_type(), 5, 2).genome_bytes is None:
        with pytest.raises(
            ConfigError, match="expected a kind whose genomes have one length"
        ):
            Bulk(convert(settings, BulkSettings, "representation"), 5, 2)
    else:
        check_representation(Bulk, settings)


def test_the_defaults_of_the_parts_are_written_out() -> None:
    complete = convert(
        {"of": {"kind": "three-layer", "hidden": 7}}, BulkSettings, "representation"
    ).of
    assert complete == {
        "kind": "three-layer",
        "hidden": 7,
        "weight_range": 2.0,
        "bias_range": 2.0,
    }


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"of": {"kind": "bulk"}}, "of: kind: expected one of "),
        ({"of": {}}, "of: kind: expected one of "),
        (
            {"of": {"kind": "ctrnn", "hiden": 1}},
            r"of: unknown key 'hiden' \(did you mean 'hidden'\?\)",
        ),
        ({"of": {"kind": "ctrnn", "tau_min": 0.1}}, "of: tau_min: expected at least"),
        ({"of": 3}, "of: expected object, got int"),
        ({"parts": 0}, "parts: expected int >= 1"),
    ],
)
def test_impossible_settings_are_refused(settings: dict[str, Any], text: str) -> None:
    with pytest.raises(ConfigError, match=f"^representation: {text}"):
        convert(settings, BulkSettings, "representation")


def test_a_nonexistent_input_is_refused() -> None:
    with pytest.raises(
        ConfigError, match=r"^representation: input: expected 0 to 3, not 4$"
    ):
        network(chosen_by=4)


# ---- operators


def test_a_genome_is_the_genomes_of_its_parts() -> None:
    built = network()
    assert built.genes == 3 * built.part.genes
    assert built.ranges is not None
    assert built.ranges.tolist() == [2.0] * built.genes
    assert b"".join(built._split(built.random(1, Stream(1)))) == b"".join(
        built.part.random(3, Stream(1))
    )


def test_every_part_mutates() -> None:
    built = network()
    (mutant,) = built.mutate(
        [bytes(built.genome_bytes)], Stream(1), method=1, severity=0.3, probability=1.0
    )
    assert np.frombuffer(mutant, "<f4").all()


def test_a_child_takes_its_first_parts_from_the_mother_and_its_last_from_the_father() -> (
    None
):
    built = network(parts=4)
    mother, father = (np.full(built.genes, value, "<f4").tobytes() for value in (1, 2))
    stream, cuts = Stream(1), set()
    for _ in range(50):
        parts = np.frombuffer(built.crossover(mother, father, stream), "<f4").reshape(
            4, -1
        )
        assert (parts == parts[:, :1]).all()
        cuts.add(tuple(parts[:, 0].tolist()))
    assert cuts == {(1, 2, 2, 2), (1, 1, 2, 2), (1, 1, 1, 2)}


def test_a_single_part_is_crossed_like_a_network_of_its_kind() -> None:
    built = network(parts=1)
    mother, father = built.random(2, Stream(1))
    assert built.crossover(mother, father, Stream(2)) == built.part.crossover(
        mother, father, Stream(2)
    )


def test_the_distance_is_the_mean_of_the_parts() -> None:
    built = network(parts=2)
    a, b = built.random(2, Stream(1))
    of_parts = [
        built.part.distances([x], [y])[0, 0]
        for x, y in zip(built._split([a]), built._split([b]), strict=True)
    ]
    assert built.distances([a], [b])[0, 0] == sum(of_parts) / 2
