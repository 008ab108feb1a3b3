"""Food or poison is what its data sheet says."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest

from zswarm.kernels.random import Stream
from zswarm.sims.food_or_poison import FoodOrPoison, FoodOrPoisonSettings
from zswarm.sims.simulator import Outcome
from zswarm.testing import check_simulator

Decide = Callable[[int, float], bool]  # the kind and the taste


@pytest.mark.parametrize("settings", [{}, {"kinds": 1, "items": 1}])
def test_food_or_poison_keeps_the_contract(settings: dict[str, Any]) -> None:
    check_simulator(FoodOrPoison, settings)


def played(
    seed: int, decide: Decide, kinds: int = 6, items: int = 60
) -> tuple[list[tuple[int, float, bool]], Outcome]:
    """Return what was observed and decided in each turn, and the outcome."""
    simulator = FoodOrPoison(FoodOrPoisonSettings(kinds=kinds, items=items))
    turn, said = simulator.reset(seed), []
    while turn is not None:
        (shown,) = turn.observations.tolist()
        assert sorted(shown[:-1]) == [0.0] * (kinds - 1) + [1.0]
        kind = shown.index(1.0)
        eats = decide(kind, shown[-1])
        said.append((kind, shown[-1], eats))
        turn = simulator.step(np.array([[0.6 if eats else 0.5]], np.float32))
    return said, simulator.outcome()


def naive(
    seed: int, decide: Decide, kinds: int, items: int
) -> tuple[list[tuple[int, float, bool]], list[float]]:
    """The data sheet written a second time."""
    stream = Stream(seed)
    foods = [stream.integer(2) == 1 for _ in range(kinds)]
    said, eaten, right = [], {True: [], False: []}, []
    for _ in range(items):
        kind = stream.integer(kinds)
        eats = decide(kind, 0.0)
        said.append((kind, 0.0, eats))
        eaten[foods[kind]].append(eats)
        right.append(eats == foods[kind])
        if eats:
            taste = 1.0 if foods[kind] else -1.0
            said.append((kind, taste, decide(kind, taste)))
    shares = [
        sum(some) / len(some) if some else 0.0
        for some in (eaten[True], eaten[False], right[items // 2 :])
    ]
    return said, [sum(right) / items - right.count(False) / items, *shares]


@pytest.mark.parametrize(("kinds", "items"), [(6, 60), (1, 1), (3, 7)])
@pytest.mark.parametrize("seed", range(4))
def test_a_trial_equals_an_independent_implementation(
    seed: int, kinds: int, items: int
) -> None:
    """Whoever decides by chance is shown the same items and tastes, and judged alike."""
    coins = [Stream(seed + 100), Stream(seed + 100)]
    expected, numbers = naive(seed, lambda *_: coins[0].integer(2) == 1, kinds, items)
    said, outcome = played(seed, lambda *_: coins[1].integer(2) == 1, kinds, items)
    assert said == expected
    assert [*outcome.fitness, *outcome.metrics] == pytest.approx(numbers, abs=1e-12)


class Learner:
    """Taste each kind once, and know it then."""

    def __init__(self) -> None:
        self.known: dict[int, bool] = {}

    def __call__(self, kind: int, taste: float) -> bool:
        if taste:
            self.known[kind] = taste > 0
        return self.known.get(kind, True)


def test_a_controller_that_learns_each_kind_errs_once_per_poison() -> None:
    for seed in range(20):
        learner = Learner()
        _, outcome = played(seed, learner)
        poisons = list(learner.known.values()).count(False)
        assert outcome.fitness == pytest.approx([1 - 2 * poisons / 60])
        assert outcome.metrics[0] == (1.0 if True in learner.known.values() else 0.0)


@pytest.mark.parametrize("eaten", [(), range(6), (0, 2, 4)])
def test_a_controller_that_does_not_learn_is_right_half_the_time(
    eaten: Sequence[int],
) -> None:
    """Whatever it eats: nothing, all, some kinds; over 100 trials."""
    fitness = [
        played(seed, lambda kind, _: kind in eaten)[1].fitness[0] for seed in range(100)
    ]
    assert np.mean(fitness) == pytest.approx(0.0, abs=0.4 * np.std(fitness))


def test_actions_while_tasting_have_no_effect() -> None:
    _, silent = played(3, lambda kind, taste: kind < 3 and not taste)
    _, loud = played(3, lambda kind, taste: kind < 3 or bool(taste))
    assert silent == loud


def test_a_controller_that_returns_nan_eats_nothing() -> None:
    simulator = FoodOrPoison(FoodOrPoisonSettings(items=9))
    simulator.reset(1)
    for _ in range(8):
        assert simulator.step(np.full((1, 1), np.nan, np.float32)) is not None
    assert simulator.step(np.full((1, 1), np.nan, np.float32)) is None
    assert simulator.outcome().metrics[:2] == [0.0, 0.0]
