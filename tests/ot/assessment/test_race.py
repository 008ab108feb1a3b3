"""The race for the champion: which trials are played next, and who wins."""

from collections.abc import Callable

import numpy as np
import pytest

from zswarm.ot.assessment.race import FIRST, LEAST, Race

Play = Callable[[int, np.ndarray], np.ndarray]  # a candidate's fitness on seeds by number


def play(race: Race, fitness: Play, metrics: int = 0) -> list[np.ndarray]:
    """Play a race to its end, and return the trials of each round."""
    rounds = []
    while race.phase != "over":
        counts = race.trials
        rounds.append(counts.copy())
        held_out = 1000 * (race.phase == "held-out")
        outcomes = [
            fitness(one, held_out + len(race.fitness[one]) + np.arange(count))
            for one, count in enumerate(counts)
        ]
        together = np.concatenate(outcomes)
        race.take(together, np.zeros((len(together), metrics)))
    return rounds


def noisy(means: list[float]) -> Play:
    noise = np.random.default_rng(7).normal(0, 1, (len(means), 5000))
    return lambda one, seeds: means[one] + noise[one, seeds]


def test_the_best_is_found_though_search_had_it_last() -> None:
    race = Race(5, 1000, differ=True)
    rounds = play(race, noisy([1.0, 1.1, 0.9, 1.2, 1.8]))
    assert race.winner == 4
    assert sum(int(counts.sum()) for counts in rounds) == 1000
    assert len(race.held_out) == 250
    mean, low, high, seeds = race.result()
    assert low < 1.8 < high
    assert mean == pytest.approx(1.8, abs=0.2)
    assert seeds == 250


@pytest.mark.parametrize("budget", [LEAST, 37, 100, 555])
def test_the_budget_is_kept_and_used(budget: int) -> None:
    race = Race(20, budget, differ=True)
    rounds = play(race, noisy([0.1 * one for one in range(20)]))
    assert sum(int(counts.sum()) for counts in rounds) == budget
    assert 2 <= race.candidates <= 20


def test_trials_that_do_not_differ_end_it_after_the_first_candidate() -> None:
    race = Race(5, 1000, differ=False)
    rounds = play(race, lambda one, seeds: np.full(len(seeds), float(one)))
    assert [counts.tolist() for counts in rounds] == [[FIRST, 0, 0, 0, 0]]
    assert not race.differ


def test_a_metric_that_differs_shows_that_trials_do() -> None:
    race = Race(2, 100, differ=False)
    race.take(np.full(FIRST, 3.0), np.arange(FIRST, dtype=float).reshape(-1, 1))
    assert race.differ
    assert race.phase == "race"


def test_candidates_without_variance_need_no_more_trials() -> None:
    race = Race(3, 1000, differ=True)
    rounds = play(race, lambda one, seeds: np.full(len(seeds), float(one)))
    assert len(rounds) == 3  # the first, the others, and the winner's further seeds
    assert race.winner == 2
    assert race.result() == (2.0, 2.0, 2.0, 250)


def test_who_fails_does_not_win_and_gets_no_more_trials() -> None:
    fitness = noisy([5.0, 1.0, 1.1])

    def failing(one: int, seeds: np.ndarray) -> np.ndarray:
        return np.where(seeds == 3, np.nan, 5.0) if one == 0 else fitness(one, seeds)

    race = Race(3, 600, differ=True)
    play(race, failing)
    assert race.winner != 0
    assert len(race.fitness[0]) == FIRST


def test_if_all_fail_the_best_in_search_remains() -> None:
    race = Race(3, 100, differ=True)
    play(race, lambda _, seeds: np.full(len(seeds), np.nan))
    assert race.winner == 0
    mean, low, high, seeds = race.result()
    assert np.isnan([mean, low, high]).all()
    assert seeds == 0


def test_a_single_candidate_is_only_measured() -> None:
    race = Race(1, 100, differ=True)
    rounds = play(race, noisy([1.0]))
    assert [counts.tolist() for counts in rounds] == [[FIRST], [25]]
