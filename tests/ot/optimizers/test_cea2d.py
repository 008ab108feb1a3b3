"""CEA2D makes each cell's successor of what the cell sees, as FREVO does."""

from collections import Counter

import numpy as np
import pytest

from zswarm.errors import ConfigError
from zswarm.kernels.random import Stream
from zswarm.nets.fully_meshed import FullyMeshed, FullyMeshedSettings
from zswarm.ot.optimizers.cea2d import CEA2D, Cea2dSettings

NETWORK = FullyMeshed(FullyMeshedSettings(), 3, 2)


def evolved(optimizer: CEA2D, generations: int, stream: Stream) -> CEA2D:
    for _ in range(generations):
        optimizer.tell(stream.uniform(-9.0, -1.0, len(optimizer.ask())))
    return optimizer


def hood(cell: int, width: int, height: int) -> list[int]:
    """Return the cell and those around it."""
    y, x = divmod(cell, width)
    return [
        (y + dy) % height * width + (x + dx) % width
        for dy in (-1, 0, 1)
        for dx in (-1, 0, 1)
    ]


def table(genome: bytes) -> np.ndarray:
    return NETWORK.tables([genome])[0].astype(float)


@pytest.mark.parametrize(("width", "height"), [(10, 10), (3, 7), (5, 3)])
def test_a_cell_sees_itself_and_its_eight_neighbours_across_the_edges(
    width: int, height: int
) -> None:
    optimizer = CEA2D(Cea2dSettings(width=width, height=height), NETWORK, 1)
    for cell, seen in enumerate(optimizer._hoods.tolist()):
        assert sorted(seen) == sorted(hood(cell, width, height))
        assert len(set(seen)) == 9


def test_ten_times_ten_are_evaluated_and_one_of_nine_is_the_elite() -> None:
    optimizer = CEA2D(Cea2dSettings(), NETWORK, 1)
    assert len(optimizer.ask()) == 100
    assert optimizer.elite == 1
    assert [
        CEA2D(Cea2dSettings(elite=share, mutation=0.1), NETWORK, 1).elite
        for share in (0.06, 0.16, 0.17, 0.5)
    ] == [1, 1, 2, 4]


@pytest.mark.parametrize(
    "settings",
    [
        Cea2dSettings(),
        Cea2dSettings(width=6, height=4, elite=0.33, mutation=0.3, crossover=0.2),
    ],
)
def test_every_cell_is_replaced_by_what_it_sees(settings: Cea2dSettings) -> None:
    optimizer = evolved(CEA2D(settings, NETWORK, 2), 1, Stream(3))
    for _ in range(6):
        before, fitness = list(optimizer._genomes), optimizer._fitness.copy()
        asked = optimizer.ask()
        after, made = optimizer._population, optimizer._operators
        changed = []
        for cell in range(len(before)):
            ranked = sorted(
                hood(cell, settings.width, settings.height),
                key=lambda other: (-fitness[other], other),
            )
            best = ranked[: optimizer.elite]
            stays = cell in best
            assert (made[cell] == "elite") == stays
            assert not stays or after[cell] == before[cell]
            changed += [] if stays else [after[cell]]
            if made[cell] == "mutation":
                assert (
                    min(
                        np.abs(table(after[cell]) - table(before[other])).max()
                        for other in best
                    )
                    <= 0.6 + 1e-6
                )
            elif made[cell] == "crossover":
                rows = [
                    (table(after[cell]) == table(before[other])).all(axis=1)
                    for other in (cell, *best)
                ]
                assert np.any(rows, axis=0).all(), (
                    "each neuron is the cell's own or of one of the best"
                )
        assert asked == changed, "who stays keeps its fitness"
        optimizer.tell(Stream(len(asked)).uniform(-9.0, -1.0, len(asked)))


@pytest.mark.parametrize(
    ("settings", "shares"),
    [
        (Cea2dSettings(), {"mutation": 59 / 89, "crossover": 30 / 89, "renew": 0.0}),
        (
            Cea2dSettings(elite=0.11, mutation=0.2, crossover=0.5),
            {"mutation": 20 / 89, "crossover": 50 / 89, "renew": 19 / 89},
        ),
    ],
)
def test_operators_share_the_cells_that_are_replaced(
    settings: Cea2dSettings, shares: dict[str, float]
) -> None:
    optimizer, made, stream = CEA2D(settings, NETWORK, 4), Counter[str](), Stream(5)
    evolved(optimizer, 1, stream)
    for _ in range(60):
        evolved(optimizer, 1, stream)
        made.update(optimizer._operators)
        statistics = optimizer.statistics()
        assert sum(statistics[f"count_{name}"] for name in ("elite", *shares)) == 100
    changed = sum(made.values()) - made["elite"]
    assert {name: made[name] / changed for name in shares} == pytest.approx(
        shares, abs=0.02
    )


def test_good_genes_spread_by_one_cell_per_generation() -> None:
    """One genome is far better than all others; its mutants replace those around it."""
    optimizer = CEA2D(Cea2dSettings(mutation=0.89, crossover=0.0), NETWORK, 1)
    optimizer.ask()
    fitness = np.zeros(100)
    fitness[55] = 1.0
    optimizer.tell(fitness)
    best = table(optimizer._genomes[55])
    genomes = [table(genome) for genome in (optimizer.ask(), optimizer._population)[1]]
    near = [
        cell
        for cell, genome in enumerate(genomes)
        if np.abs(genome - best).max() <= 0.6 + 1e-6
    ]
    assert near == [44, 45, 46, 54, 55, 56, 64, 65, 66]


def test_the_search_continues_if_all_are_equal() -> None:
    """At most one of each neighbourhood stays on a plateau, as in FREVO."""
    optimizer = CEA2D(Cea2dSettings(), NETWORK, 1)
    for generation in range(5):
        genomes = optimizer.ask()
        assert len(genomes) == (99 if generation else 100)
        optimizer.tell(np.zeros(len(genomes)))


def test_ties_are_ranked_by_index_and_failures_last() -> None:
    optimizer = CEA2D(Cea2dSettings(width=3, height=3), NETWORK, 1)
    optimizer.ask()
    nan = float("nan")
    optimizer.tell(np.array([nan, -np.inf, 2.0, 2.0, nan, 1.0, 0.0, nan, nan]))
    stays, best = optimizer._ranked()
    assert stays.tolist() == [
        False,
        False,
        True,
        False,
        False,
        False,
        False,
        False,
        False,
    ]
    assert best.tolist() == 9 * [[2]]


def test_relative_fitness_makes_all_individuals_compete_again() -> None:
    optimizer = CEA2D(Cea2dSettings(), NETWORK, 1)
    optimizer.relative = True
    for generation in range(4):
        genomes = optimizer.ask()
        assert genomes == optimizer._population
        optimizer.tell(Stream(generation).uniform(-9.0, -1.0, 100))


def test_the_last_valid_individual_of_a_failing_neighbourhood_survives() -> None:
    """All failed: everybody's best is a failure, and no number is invented."""
    optimizer = CEA2D(Cea2dSettings(), NETWORK, 1)
    optimizer.ask()
    optimizer.tell(np.full(100, np.nan))
    genomes = optimizer.ask()
    assert 0 < len(genomes) <= 100
    optimizer.tell(np.ones(len(genomes)))
    assert optimizer.statistics()["mean"] == 1.0


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        (Cea2dSettings(elite=0.05), "elite: expected 1 to 8 of 9 cells, .* not 0.05"),
        (
            Cea2dSettings(elite=0.95, mutation=0.0, crossover=0.0),
            "elite: expected 1 to 8 of 9 cells, .* not 0.95",
        ),
        (Cea2dSettings(elite=0.2), "expected shares of at most 1 in all"),
    ],
)
def test_impossible_shares_are_refused(settings: Cea2dSettings, text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        CEA2D(settings, NETWORK, 1)


def test_statistics_report_diversity_and_the_operators_of_survivors() -> None:
    optimizer = evolved(CEA2D(Cea2dSettings(), NETWORK, 1), 5, Stream(1))
    statistics = optimizer.statistics()
    pairs = [
        NETWORK.distances([a], [b])[0, 0]
        for index, a in enumerate(optimizer._genomes)
        for b in optimizer._genomes[index + 1 :]
    ]
    assert statistics["diversity_mean"] == pytest.approx(np.mean(pairs))
    made = optimizer._operators
    optimizer.ask()
    for name in ("elite", "mutation", "crossover"):
        cells = [cell for cell in range(100) if made[cell] == name]
        staying = sum(optimizer._operators[cell] == "elite" for cell in cells)
        assert statistics[f"effectivity_{name}"] == pytest.approx(staying / len(cells))
