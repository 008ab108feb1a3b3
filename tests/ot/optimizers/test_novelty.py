"""Novelty search measures, keeps and breeds what is new."""

import numpy as np
import pytest

from zswarm.errors import ConfigError
from zswarm.kernels.random import Stream
from zswarm.nets.fully_meshed import FullyMeshed, FullyMeshedSettings
from zswarm.ot.optimizers.novelty import Novelty, NoveltySettings

NETWORK = FullyMeshed(FullyMeshedSettings(), 2, 1)
NAN = float("nan")


def told(
    optimizer: Novelty, behaviours: list[list[float]], fitness: list[float] | None = None
) -> list[bytes]:
    genomes = optimizer.ask()
    optimizer.tell(np.array(fitness or [0.0] * len(genomes)), np.array(behaviours))
    return genomes


def test_novelty_is_the_mean_distance_to_the_nearest_others_and_the_archive() -> None:
    """The paper's equation (1), pair by pair."""
    optimizer = Novelty(
        NoveltySettings(measures=["x", "y"], population=10, neighbours=4), NETWORK, 1
    )
    behaviours, archive = (
        Stream(seed).uniform(-1.0, 1.0, 2 * count).reshape(count, 2)
        for seed, count in ((1, 20), (2, 7))
    )
    optimizer._archive = archive
    everything = [*behaviours.tolist(), *archive.tolist()]
    for index, value in enumerate(optimizer._novelty(behaviours)):
        here = everything[index]
        distances = sorted(
            ((here[0] - x) ** 2 + (here[1] - y) ** 2) ** 0.5
            for other, (x, y) in enumerate(everything)
            if other != index
        )
        assert value == pytest.approx(sum(distances[:4]) / 4, rel=1e-14)


def test_an_individual_with_equal_behaviour_counts_as_a_neighbour() -> None:
    optimizer = Novelty(
        NoveltySettings(measures=["x"], population=3, neighbours=1), NETWORK, 1
    )
    assert optimizer._novelty(np.array([[1.0], [1.0], [4.0]])).tolist() == [0.0, 0.0, 3.0]
    assert np.isnan(optimizer._novelty(np.array([[1.0]]))).all()


def test_the_most_novel_of_parents_and_children_stay() -> None:
    optimizer = Novelty(
        NoveltySettings(measures=["x"], population=3, neighbours=1, threshold=1e9),
        NETWORK,
        1,
    )
    first = told(optimizer, [[0.0], [10.0], [20.0]])
    children = told(optimizer, [[0.5], [100.0], [19.0]])
    assert optimizer._genomes == [children[1], first[1], first[2]]
    assert optimizer._behaviours.tolist() == [[100.0], [10.0], [20.0]]
    assert optimizer.statistics()["novelty"] == pytest.approx((80.0 + 9.0 + 1.0) / 3)


def test_archived_behaviour_is_not_novel() -> None:
    optimizer = Novelty(
        NoveltySettings(measures=["x"], population=2, neighbours=1, threshold=5.0),
        NETWORK,
        1,
    )
    told(optimizer, [[0.0], [10.0]])
    assert optimizer._archive.tolist() == [[0.0], [10.0]]
    assert optimizer.statistics()["archive"] == 2.0
    told(optimizer, [[0.0], [7.0]])
    assert optimizer._novelty(np.array([[0.0], [10.0], [50.0]])).tolist() == [
        0.0,
        0.0,
        40.0,
    ]


def test_the_threshold_rises_with_many_entries_and_falls_without_entries() -> None:
    """More than four entries raise it by a fifth; ten generations without one lower it by 5 %."""
    optimizer = Novelty(
        NoveltySettings(measures=["x"], population=6, neighbours=1, threshold=1.0),
        NETWORK,
        1,
    )
    thresholds = []
    for behaviours in ([[0.0], [3.0], [6.0], [9.0], [12.0], [15.0]], *20 * [[[0.0]] * 6]):
        told(optimizer, behaviours)
        thresholds.append(optimizer.statistics()["threshold"])
    assert thresholds == pytest.approx([1.2] * 10 + [1.2 * 0.95] * 10 + [1.2 * 0.95**2])


def test_four_entries_do_not_raise_the_threshold() -> None:
    optimizer = Novelty(
        NoveltySettings(measures=["x"], population=5, neighbours=1, threshold=2.5),
        NETWORK,
        1,
    )
    told(optimizer, [[0.0], [3.0], [6.0], [9.0], [9.0]])
    assert optimizer.statistics()["archive"] == 3.0
    assert optimizer.statistics()["threshold"] == 2.5


@pytest.mark.parametrize("unit", [1e-3, 1.0, 1e6])
def test_the_first_threshold_is_in_the_unit_of_the_measures(unit: float) -> None:
    optimizer = Novelty(
        NoveltySettings(measures=["x"], population=4, neighbours=1), NETWORK, 1
    )
    told(optimizer, [[0.0], [unit], [3.0 * unit], [7.0 * unit]])
    assert optimizer.statistics()["threshold"] == pytest.approx(2.0 * unit)
    assert optimizer._archive.tolist() == [[7.0 * unit]]


@pytest.mark.parametrize("first", [NAN, 7.0])
def test_the_threshold_is_set_by_the_first_distinct_behaviours(first: float) -> None:
    """If all fail at first, or behave alike, the archive is neither closed nor open to all."""
    optimizer = Novelty(
        NoveltySettings(measures=["x"], population=4, neighbours=1), NETWORK, 1
    )
    told(optimizer, [[first]] * 4)
    assert len(optimizer._archive) == 0
    told(optimizer, [[0.0], [1.0], [3.0], [20.0]])
    assert optimizer.statistics()["threshold"] == pytest.approx(
        (1.0 + 1.0 + 2.0 + 17.0) / 4 if first != first else (1 + 1 + 2 + 13) / 4
    )
    assert optimizer._archive.tolist() == [[20.0]]


def test_individuals_without_behaviour_are_ranked_last_and_never_archived() -> None:
    optimizer = Novelty(
        NoveltySettings(measures=["x", "y"], population=3, neighbours=2, threshold=1e-9),
        NETWORK,
        1,
    )
    first = told(
        optimizer, [[NAN, 1.0], [2.0, 3.0], [4.0, float("inf")]], [NAN, 1.0, 2.0]
    )
    assert optimizer._genomes == [first[0], first[1], first[2]], (
        "one alone has no neighbour"
    )
    children = told(optimizer, [[2.0, 2.0], [NAN, NAN], [0.0, 0.0]], [5.0, NAN, NAN])
    assert set(optimizer._genomes) == {first[1], children[0], children[2]}
    assert np.isfinite(optimizer._archive).all()
    assert optimizer.best() == (children[0], 5.0)


def test_fitness_has_the_weight_that_it_is_given() -> None:
    """0: none; 1: all; between them each is scaled to 0..1."""
    kept = {}
    for weight in (0.0, 0.5, 1.0):
        optimizer = Novelty(
            NoveltySettings(
                measures=["x"], population=2, neighbours=1, threshold=1e9, fitness=weight
            ),
            NETWORK,
            1,
        )
        first = told(optimizer, [[0.0], [1.0]], [9.0, 8.0])
        children = told(optimizer, [[50.0], [90.0]], [1.0, 0.0])
        kept[weight] = [
            ("first" if genome in first else "child", [*first, *children].index(genome))
            for genome in optimizer._genomes
        ]
    assert kept[0.0] == [("child", 2), ("child", 3)]
    assert kept[1.0] == [("first", 0), ("first", 1)]
    assert kept[0.5] == [("child", 2), ("first", 0)]


def test_novelty_without_measures_is_refused() -> None:
    with pytest.raises(
        ConfigError,
        match=r"^optimizer: measures: expected the names of metrics that describe behaviour$",
    ):
        Novelty(NoveltySettings(), NETWORK, 1)


def test_novelty_search_crosses_a_region_of_low_fitness() -> None:
    """A wall of bad fitness with a prize behind it: breeding for fitness stays inside."""

    def judged(optimizer: Novelty) -> float:
        for _ in range(100):
            genomes = optimizer.ask()
            place = (
                np.frombuffer(b"".join(genomes), "<f4")
                .reshape(len(genomes), -1)[:, :2]
                .astype(float)
            )
            out = np.abs(place).max(axis=1)
            optimizer.tell(
                np.where(out < 2.5, -out, np.where(out > 5.0, 100.0, -50.0)), place
            )
        return optimizer.best()[1]

    found = {
        weight: [
            judged(
                Novelty(
                    NoveltySettings(measures=["x", "y"], population=30, fitness=weight),
                    NETWORK,
                    seed,
                )
            )
            for seed in range(5)
        ]
        for weight in (0.0, 1.0)
    }
    assert found[0.0] == 5 * [100.0]
    assert max(found[1.0]) < 0.0
