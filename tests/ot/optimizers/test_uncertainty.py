"""CMA-ES and OpenAI's strategy evaluate candidates as often as their order needs."""

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from tests.ot.assessment.test_assessed_runs import Noisy
from tests.ot.assessment.test_racing import evolved, loaded, played, resumed, stopped
from zswarm import experiment
from zswarm.config.decode import convert
from zswarm.errors import ConfigError
from zswarm.ot.build import build
from zswarm.ot.generation import assess
from zswarm.ot.optimizers import uncertainty
from zswarm.ot.optimizers.cmaes import CMAES
from zswarm.ot.optimizers.openai_es import OpenAIES
from zswarm.ot.optimizers.optimizer import Optimizer
from zswarm.ot.record.reader import Run
from zswarm.testing import check_optimizer
from zswarm.testing.rules import fully_meshed

KINDS = {"cmaes": CMAES, "openai-es": OpenAIES}


def test_one_in_ten_is_evaluated_again_and_two_at_least() -> None:
    assert uncertainty.rows(4, 1.0).tolist() == [0, 1, 2, 3, 0, 1]
    assert uncertainty.rows(4, 2.9).tolist() == [0, 1, 2, 3] * 2 + [0, 1] * 2
    assert uncertainty.rows(1, 1.0).tolist() == [0, 0]
    assert uncertainty.rows(50, 1.0)[50:].tolist() == [0, 1, 2, 3, 4]


def test_without_noise_ranks_do_not_change_also_where_all_are_equal() -> None:
    for first in (np.arange(20.0), np.zeros(20), np.r_[np.zeros(10), np.ones(10)]):
        judged = uncertainty.judge(np.r_[first, first[:2]], 20, 1.0)
        assert judged.noise < 0.0
        np.testing.assert_array_equal(judged.fitness, first)


def test_noise_is_how_far_ranks_change_beyond_what_is_accepted() -> None:
    """The worst of ten becomes the best, by 18 ranks among 20, and the second stays."""
    first = np.arange(10.0)
    judged = uncertainty.judge(np.r_[first, 100.0, 1.0], 10, 1.0)
    assert judged.fitness.tolist() == [50.0, *range(1, 10)]
    # Ranks 1 and 20 with 18 between; |1 - R|, ..., |19 - R| are 0 to 18 for R = 1 and for R = 19,
    # and the second smallest is accepted. The other has 3.5 twice, and .5, .5, 1.5, ...
    assert judged.noise == pytest.approx((2 * 18 - 1 - 1 + 0 - 0.5 - 0.5) / 2)


def test_failed_evaluations_do_not_count_but_rank_last() -> None:
    first = np.r_[np.arange(9.0), np.nan]
    judged = uncertainty.judge(np.r_[first, np.nan, 1.0], 10, 1.0)
    np.testing.assert_array_equal(judged.fitness, first)
    better = uncertainty.judge(np.r_[8.0, first[1:], np.nan, 1.0], 10, 1.0)
    assert better.noise > judged.noise


def test_the_effort_follows_the_noise_between_one_and_the_most() -> None:
    effort, seen = 1.0, []
    for noise in (1.0, 1.0, 1.0, 1.0, -1.0, 0.0, -1.0, -1.0, -1.0):
        effort = uncertainty.adapted(effort, noise, 4)
        seen.append(effort)
    assert seen[:4] == [1.5, 2.25, 3.375, 4.0]
    assert seen[4:] == pytest.approx([4 / 1.5, 4 / 2.25, 4 / 3.375, 1.0, 1.0])


@pytest.mark.parametrize("kind", KINDS)
def test_the_contract_is_kept(kind: str) -> None:
    check_optimizer(KINDS[kind], {"evaluations": 4, "population": 10})


def made(kind: str, **settings: object) -> Optimizer:
    optimizer = KINDS[kind]
    given = {"population": 10, **settings}
    converted = convert(given, optimizer.settings_type, "settings")
    return optimizer(converted, fully_meshed(3, 1), 1)


def searched(optimizer: Optimizer, noise: float, generations: int) -> list[float]:
    """Tell distances from a point, and noise; return how often candidates were evaluated."""
    draw, often = np.random.default_rng(5), []
    for _ in range(generations):
        genes = np.array([np.frombuffer(one, "<f4") for one in optimizer.ask()], float)
        fitness = -((genes - 0.3) ** 2).sum(axis=1)
        optimizer.tell(fitness + noise * draw.normal(size=len(fitness)))
        often.append(optimizer.statistics()["evaluated"])
    return often


@pytest.mark.parametrize("kind", KINDS)
def test_noise_makes_evaluations_more_and_calm_makes_them_one(kind: str) -> None:
    assert max(searched(made(kind, evaluations=16), 0.0, 20)) == 1.0
    assert max(searched(made(kind, evaluations=16), 100.0, 20)) == 16.0


def test_cmaes_steps_further_where_more_evaluations_are_not_allowed() -> None:
    sigmas = {}
    for most in (2, 1000):
        optimizer = made("cmaes", evaluations=most, restarts="none")
        searched(optimizer, 1e6, 12)
        sigmas[most] = optimizer.statistics()["sigma"]
    assert sigmas[2] > sigmas[1000]


@pytest.mark.parametrize("kind", KINDS)
def test_each_evaluation_of_a_candidate_plays_further_seeds(kind: str) -> None:
    changes = (f"optimizer.kind={kind}", "optimizer.evaluations=4")
    problem, optimizer = build(loaded("assessment.racing=false", *changes))
    optimizer._effort = 2.0  # type: ignore[attr-defined]
    work = assess(problem, optimizer, 0).workload
    trials = problem.experiment.problem.trials
    every = problem.trial_seeds(0, 4 * trials).tolist()
    times: Counter[bytes] = Counter()
    for row, genome in enumerate(work.genomes):
        begin = times[genome] * trials
        seeds = work.seeds[row * trials : (row + 1) * trials].tolist()
        assert seeds == every[begin : begin + trials]
        times[genome] += 1
    assert sorted(set(times.values())) == [2, 4]
    assert every[:trials] == problem.trial_seeds(0).tolist()


@pytest.mark.parametrize("kind", KINDS)
def test_a_run_has_one_history_also_where_it_was_resumed(
    tmp_path: Path, kind: str
) -> None:
    more = (
        "assessment.racing=false",
        f"optimizer.kind={kind}",
        "optimizer.evaluations=4",
        "optimizer.population=40",
        "seed=3",
    )
    noise = 1000.0
    folder, whole = evolved(tmp_path / "whole", Noisy(noise), *more)
    assert played(folder) == 10 * whole.evaluations
    evaluated = [row["statistics"]["evaluated"] for row in Run(folder).history()]
    assert evaluated == [1, 1, 2, 3]
    again = stopped(tmp_path / "stopped", *more, servers=Noisy(noise))
    assert resumed(again, Noisy(noise, batch=3)).history_hash == whole.history_hash


def test_tournaments_and_racing_are_refused_in_one_line() -> None:
    changes = ["optimizer.kind=cmaes", "optimizer.evaluations=4"]
    file = experiment.load(experiment.find("minisim-duel"), changes)
    with pytest.raises(ConfigError) as refusal:
        build(experiment.complete(file, "test"))
    assert str(refusal.value) == (
        "optimizer: evaluations: expected 1: candidates play each other, so none has a fitness of "
        "its own"
    )
    with pytest.raises(ConfigError, match="racing: expected an optimizer that uses"):
        build(loaded(*changes))
