"""Every representation keeps the contract; the check finds the mistakes of authors."""

from typing import Any

import numpy as np
import pytest

from tests.docs.documents import REPOSITORY
from tests.parameters import some
from zswarm.kernels.jit import STEP_SIGNATURE, kernel
from zswarm.kernels.random import Stream
from zswarm.nets.fully_meshed import FullyMeshed
from zswarm.plugins import registry as plugins
from zswarm.testing import check_representation

ZERO = np.float32(0)
PAGE = REPOSITORY / "docs" / "representations.md"


@pytest.mark.parametrize("name", plugins.names("representation"))
@pytest.mark.parametrize(
    ("inputs", "outputs"),
    some([(5, 2), (1, 1), (10, 2), (1, 9), (13, 1)], (5, 2), (1, 9)),
)
def test_every_representation_keeps_the_contract(
    name: str, inputs: int, outputs: int
) -> None:
    check_representation(
        plugins.load("representation", name), inputs=inputs, outputs=outputs
    )


@pytest.mark.parametrize("name", plugins.names("representation"))
def test_a_data_sheet_begins_with_a_one_line_summary(name: str) -> None:
    lines = (plugins.load("representation", name).__doc__ or "").split("\n")
    assert 20 < len(lines[0]) < 130
    assert lines[0].endswith(".")
    assert len(lines) == 1 or not lines[1].strip()


@pytest.mark.parametrize("name", plugins.BUNDLED["representation"])
def test_the_page_names_every_representation(name: str) -> None:
    assert f"`{name}`" in PAGE.read_text(encoding="utf-8")


# ---- what the check finds


@kernel(STEP_SIGNATURE)
def untyped(parameters, state, observation, output):  # type: ignore[no-untyped-def]  # compiled
    """0.1 and its sum with a float32 are float64 here, and float32 in plain Python."""
    for row in range(output.shape[0]):
        output[row] = (observation[0] + 0.1) * parameters[0] * 0.7


@kernel(STEP_SIGNATURE)
def reading_beside(parameters, state, observation, output):  # type: ignore[no-untyped-def]  # compiled
    for row in range(output.shape[0]):
        output[row] = observation[observation.shape[0]]


@kernel(STEP_SIGNATURE)
def writing_beside(parameters, state, observation, output):  # type: ignore[no-untyped-def]  # compiled
    for row in range(output.shape[0]):
        output[row] = parameters[0]
    state[state.shape[0]] = ZERO


def hidden_randomness(self, count, stream, shared=Stream(0)):  # noqa: B008  shared on purpose
    return FullyMeshed.random(self, count, shared)


def short_child(self, mother, father, stream):
    return mother[:-4]


def far_from_itself(self, left, right):
    return FullyMeshed.distances(self, left, right) + 1


def nearer_between(self: Any, genomes: Any, left: Any, right: Any) -> np.ndarray:
    return FullyMeshed.distances_between(self, genomes, left, right) / 2


def one_way(self, left, right):
    return np.triu(FullyMeshed.distances(self, left, right))


def never_refusing(self, genomes):
    return np.zeros((len(genomes), 9), np.float32)


def losing_one(self, genomes, stream, **options):
    return genomes[1:]


def changing_nothing(self, genomes, stream, **options):
    return list(genomes)


def cloning(self, mother, father, stream):
    return mother


def depending(self, genomes):
    return FullyMeshed.parameters(self, genomes) + np.float32(len(genomes))


def added_in_pairs(self, left, right):
    a, b = (
        np.array([np.frombuffer(genome, "<f4") for genome in side]).T
        for side in (left, right)
    )
    return np.add.reduce(
        np.abs(a[:, :, None] - b[:, None, :]).astype(np.float64) * 1e-9 + 1, axis=0
    ) * (left != right)


def of_none(self, count, stream):
    return FullyMeshed.random(self, max(1, count), stream)


def beyond(self, count, stream):
    genomes = [
        np.frombuffer(genome, "<f4") * np.float32(2)
        for genome in FullyMeshed.random(self, count, stream)
    ]
    return [genome.tobytes() for genome in genomes]


def positive(self, count, stream):
    genomes = [
        np.frombuffer(genome, "<f4") * np.float32(0.4)
        for genome in FullyMeshed.random(self, count, stream)
    ]
    return [genome.tobytes() for genome in genomes]


def refusing_large(self, genomes):
    if any(np.abs(np.frombuffer(genome, "<f4")).max() > 1e6 for genome in genomes):
        raise ValueError("too large")
    return FullyMeshed.parameters(self, genomes)


def not_compiled(parameters, state, observation, output):
    output[:] = 0


@pytest.mark.parametrize(
    ("attribute", "fault", "text"),
    [
        ("random", hidden_randomness, "draw only from it"),
        ("crossover", short_child, "must be 64 bytes, not 60"),
        ("distances", far_from_itself, "differs from itself"),
        ("distances", one_way, "not symmetric"),
        ("distances_between", nearer_between, "other bits than .distances"),
        ("crossover_draws", 3, "expected 3 words for each crossover"),
        ("distances", added_in_pairs, "a pair's distance depends on the other genomes"),
        (
            "parameters",
            never_refusing,
            "of a genome that is one byte short must raise ValueError",
        ),
        ("parameters", depending, "a genome's row depends on the other genomes"),
        (
            "parameters",
            refusing_large,
            "any finite numbers must be a genome, also all -1e\\+30",
        ),
        ("random", of_none, "random of 0 and mutate of no genomes"),
        ("random", beyond, "is beyond its range"),
        ("random", positive, "is not uniform in plus or minus its range"),
        ("mutate", losing_one, "6 genomes gave 5"),
        (
            "mutate",
            changing_nothing,
            "mutate, method 1: all genomes are the same after 50 mutations",
        ),
        ("crossover", cloning, "a child equals its mother and has nothing of its father"),
        ("step", staticmethod(not_compiled), "must be compiled"),
        (
            "step",
            staticmethod(untyped),
            "plain Python and the compiled form decide differently; type all constants",
        ),
        ("step", staticmethod(reading_beside), "or reads outside its arrays"),
        (
            "step",
            staticmethod(writing_beside),
            "writes outside its arrays: is state_size too small?",
        ),
        ("step_lanes", staticmethod(not_compiled), "step_lanes must be compiled"),
        (
            "step_lanes",
            staticmethod(untyped),
            "an agent decides differently than with step",
        ),
    ],
)
def test_the_contract_check_names_what_is_broken(
    attribute: str, fault: Any, text: str
) -> None:
    broken = type("Broken", (FullyMeshed,), {attribute: fault})
    with pytest.raises(AssertionError, match=text):
        check_representation(broken, {"hidden": 0})


@pytest.mark.parametrize(
    ("attribute", "value", "text"),
    [
        (
            "ranges",
            np.full(16, 2.0, np.float32),
            r"ranges must be a \(16,\) float64 array, not \(16,\) float32",
        ),
        (
            "ranges",
            np.full(15, 2.0),
            r"ranges must be a \(16,\) float64 array, not \(15,\) float64",
        ),
        ("ranges", None, r"ranges must be a \(16,\) float64 array, not None"),
        ("ranges", np.zeros(16), "ranges must be finite and above 0"),
        ("genes", None, "ranges must be None where genes is"),
        ("genes", 17, "17 float32 numbers are not 64 bytes"),
        ("genome_bytes", 60, "a genome must be 60 bytes, not 64"),
        ("state_size", -1, "state_size must be an int >= 0"),
    ],
)
def test_the_contract_check_names_a_wrong_attribute(
    attribute: str, value: Any, text: str
) -> None:
    class Broken(FullyMeshed):
        def __init__(self, *arguments: Any) -> None:
            super().__init__(*arguments)
            setattr(self, attribute, value)
            self.random = FullyMeshed(*arguments).random  # type: ignore[method-assign]

    with pytest.raises(AssertionError, match=text):
        check_representation(Broken, {"hidden": 0})
