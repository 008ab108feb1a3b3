"""OpenAI's evolution strategy estimates the gradient and steps as its sources say."""

import numpy as np
import pytest

from zswarm.errors import ConfigError
from zswarm.kernels.random import Stream, derive_seed
from zswarm.nets.fully_meshed import FullyMeshed, FullyMeshedSettings
from zswarm.ot.optimizers.openai_es import OpenAIES, OpenAIESSettings, _centred_ranks

NETWORK = FullyMeshed(FullyMeshedSettings(bias_range=0.5), 2, 1)
GENES = NETWORK.genes or 0


def places(genomes: list[bytes]) -> np.ndarray:
    return (
        np.frombuffer(b"".join(genomes), "<f4").reshape(len(genomes), -1).astype(float)
        / NETWORK.ranges
    )


def slope(genomes: list[bytes]) -> np.ndarray:
    """Return a fitness that rises with the first gene."""
    return places(genomes)[:, 0]


def test_every_direction_is_tried_both_ways_around_the_mean() -> None:
    optimizer = OpenAIES(OpenAIESSettings(population=10, deviation=0.2), NETWORK, 1)
    here = places(optimizer.ask())
    assert here.shape == (11, GENES)
    assert np.abs((here[1:6] + here[6:]) / 2 - here[0]).max() < 1e-6
    directions = (
        Stream(derive_seed(1, "openai-es", 0))
        .normal(0.0, 1.0, 5 * GENES)
        .reshape(5, GENES)
    )
    assert np.abs(here[1:6] - here[0] - 0.2 * directions).max() < 1e-6


def test_adam_moves_the_mean_along_the_weighted_sum_of_directions() -> None:
    """Plain Python repeats algorithm 1 of both papers, number by number."""
    settings = OpenAIESSettings(
        population=6, deviation=0.3, learning_rate=0.07, weight_decay=0.01
    )
    optimizer = OpenAIES(settings, NETWORK, 2)
    fitness, stream = np.empty(0), Stream(4)
    m, v = [0.0] * GENES, [0.0] * GENES
    centre = places(optimizer.ask())[0]
    for t in range(1, 5):
        if t > 1:
            centre_now = places(optimizer.ask())[0]
            assert centre_now == pytest.approx(centre, abs=1e-5)
        fitness = stream.uniform(-9.0, 9.0, 7)
        optimizer.tell(fitness)
        directions = (
            Stream(derive_seed(2, "openai-es", t - 1))
            .normal(0.0, 1.0, 3 * GENES)
            .reshape(3, GENES)
        )
        ranks = np.argsort(np.argsort(fitness[1:])) / 5 - 0.5
        for d in range(GENES):
            gradient = (
                sum((ranks[i] - ranks[3 + i]) * directions[i, d] for i in range(3))
                / (6 * 0.3)
                - 0.01 * centre[d]
            )
            m[d] = 0.9 * m[d] + 0.1 * gradient
            v[d] = 0.999 * v[d] + 0.001 * gradient**2
            centre[d] += (
                0.07 * (m[d] / (1 - 0.9**t)) / ((v[d] / (1 - 0.999**t)) ** 0.5 + 1e-8)
            )


def test_only_the_order_of_fitness_counts() -> None:
    one, other = (OpenAIES(OpenAIESSettings(population=20), NETWORK, 3) for _ in range(2))
    for _ in range(5):
        genomes = one.ask()
        assert other.ask() == genomes
        one.tell(slope(genomes))
        other.tell(np.exp(9.0 * slope(genomes)) - 1e6)


def test_equals_share_their_rank_and_failures_are_worst() -> None:
    nan, worst = float("nan"), float("-inf")
    assert _centred_ranks(np.array([3.0, 1.0, 2.0])).tolist() == [0.5, -0.5, 0.0]
    assert _centred_ranks(np.array([7.0, 7.0, 1.0])).tolist() == [0.25, 0.25, -0.5]
    assert _centred_ranks(np.array([2.0, nan, 1.0])).tolist() == [0.5, -0.5, 0.0]
    assert _centred_ranks(np.array([nan, worst, nan])).tolist() == [0.0, 0.0, 0.0]


def test_equal_fitness_does_not_move_the_mean() -> None:
    optimizer = OpenAIES(OpenAIESSettings(population=20, weight_decay=0.0), NETWORK, 1)
    first = optimizer.ask()[0]
    for _ in range(3):
        optimizer.tell(np.ones(21))
        assert optimizer.statistics()["gradient"] == 0.0
        assert optimizer.ask()[0] == first


def test_weights_decay_if_fitness_is_equal() -> None:
    optimizer = OpenAIES(OpenAIESSettings(population=20, weight_decay=0.1), NETWORK, 1)
    sizes = []
    for _ in range(30):
        optimizer.ask()
        optimizer.tell(np.ones(21))
        sizes.append(optimizer.statistics()["size"])
    assert sizes[-1] < 0.2 * sizes[0]


def test_the_mean_improves_and_its_fitness_is_reported() -> None:
    optimizer = OpenAIES(OpenAIESSettings(population=20), NETWORK, 1)
    centres = []
    for _ in range(30):
        genomes = optimizer.ask()
        optimizer.tell(slope(genomes))
        centres.append(optimizer.statistics()["centre"])
        assert centres[-1] == slope(genomes)[0]
    assert centres[-1] > centres[0] + 1.0


def test_an_odd_population_is_refused() -> None:
    with pytest.raises(
        ConfigError,
        match=r"^optimizer: population: expected an even number, two per direction, not 21$",
    ):
        OpenAIES(OpenAIESSettings(population=21), NETWORK, 1)
