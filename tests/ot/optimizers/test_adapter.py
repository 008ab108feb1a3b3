"""An optimizer of another package is asked, told, and told again after a stop."""

import re
from typing import Any

import msgspec
import numpy as np
import pytest
import threadpoolctl

from tests.ot.optimizers.spheres import evolve, make
from tests.repository import REPOSITORY
from zswarm.errors import ConfigError
from zswarm.ot.optimizers.adapter import FAR, Adapter
from zswarm.ot.optimizers.optimizer import Optimizer
from zswarm.testing import check_optimizer

DOCUMENT = REPOSITORY / "docs" / "optimizers.md"


class Settings(msgspec.Struct, frozen=True):
    """Define what a test has the other package do."""

    drift: float = 0.0  # added to what it proposes: as another version of it would
    later: int = 0  # from this generation on
    candidates: int = 6
    scale: float = 0.5


class Nearby(Adapter):
    """Look around the best solution that it was told."""

    settings_type = Settings
    settings: Settings

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.candidates = self.settings.candidates
        self.draws = np.random.RandomState(self.seed % 2**32)
        self.centre, self.height = np.zeros(self.genes), -np.inf
        self.told: list[tuple[np.ndarray, ...]] = []

    def _propose(self) -> np.ndarray:
        proposed = self.centre + self.settings.scale * self.draws.randn(
            self.settings.candidates, self.genes
        )
        return (
            proposed + self.settings.drift
            if self.generation >= self.settings.later
            else proposed
        )

    def _learn(
        self, solutions: np.ndarray, fitness: np.ndarray, measures: np.ndarray
    ) -> None:
        self.told.append((solutions, fitness, measures))
        if fitness.max() > self.height:
            self.centre, self.height = solutions[fitness.argmax()], fitness.max()


class Measured(Nearby):
    measures = ("first",)


def nearby(**settings: Any) -> Nearby:
    optimizer = make(Nearby, 7, **settings)
    assert isinstance(optimizer, Nearby)
    return optimizer


def test_an_adapter_keeps_the_contract_of_optimizers() -> None:
    check_optimizer(Nearby)
    check_optimizer(Measured)


def test_tell_receives_the_evaluated_vectors() -> None:
    """They are in units of the ranges, and rounded to float32."""
    optimizer = nearby()
    (told,) = evolve(optimizer, 1)
    solutions, fitness, _ = optimizer.told[0]
    ranges = optimizer.representation.ranges
    assert np.array_equal(
        solutions, optimizer.representation.parameters(told.genomes) / ranges
    )
    assert [row.tobytes() for row in (solutions * ranges).astype("<f4")] == told.genomes
    assert np.array_equal(fitness, told.fitness)
    proposed = 0.5 * np.random.RandomState(1).randn(6, 7)
    assert np.abs(solutions - proposed).max() < 1e-6


def test_a_failed_candidate_is_as_bad_as_the_worst_of_its_generation() -> None:
    """Its unknown measures stay NaN; if all candidates failed, all are equal."""
    optimizer = make(Measured, 7)
    assert isinstance(optimizer, Measured)
    optimizer.ask()
    optimizer.tell(np.array([3.0, np.nan, -2.0, np.nan, 5.0, 0.0]), np.ones((6, 1)))
    optimizer.ask()
    optimizer.tell(np.full(6, np.nan), np.full((6, 1), np.nan))
    (_, fitness, measures), (_, equal, _) = optimizer.told
    assert fitness.tolist() == [3.0, -2.0, -2.0, -2.0, 5.0, 0.0]
    assert np.isnan(measures[:, 0]).tolist() == [False, True, False, True, False, False]
    assert equal.tolist() == [0.0] * 6
    assert optimizer.best()[1] == 5.0


def restored(old: Optimizer, told: Any, **settings: Any) -> Nearby:
    new = nearby(**settings)
    new.restore(msgspec.msgpack.decode(msgspec.msgpack.encode(old.state())), told)
    return new


def test_a_restored_optimizer_equals_the_original() -> None:
    old = nearby()
    new = restored(old, evolve(old, 5))
    assert new.diverged is None
    assert new.ask() == old.ask()
    assert new.statistics() == old.statistics()


def test_tell_receives_the_recorded_vectors_if_proposals_diverge() -> None:
    """Another processor or version may diverge; the first such generation is named."""
    old = nearby()
    told = evolve(old, 6)
    new = restored(old, told, drift=1e-3, later=4)
    assert new.diverged == 4
    for (solutions, fitness, _), generation in zip(new.told, told, strict=True):
        assert np.array_equal(
            solutions,
            new.representation.parameters(generation.genomes) / new.representation.ranges,
        )
        assert np.array_equal(fitness, generation.fitness)
    assert new.best() == old.best()
    assert np.array_equal(new.centre, old.centre)


def test_an_optimizer_that_cannot_receive_recorded_vectors_is_refused() -> None:
    old = nearby()
    told = evolve(old, 3)
    with pytest.raises(
        ConfigError,
        match="generation 1 was recorded with 6 candidates, and this program proposes 7: resume",
    ):
        restored(old, told, candidates=7)
    with pytest.raises(
        ConfigError, match="2 generations are recorded; its state is of 3"
    ):
        restored(old, told[:2])


def test_only_the_generations_of_the_state_are_replayed() -> None:
    """The record may have more generations than the state that is restored."""
    old = nearby()
    told = evolve(old, 3)
    state = old.state()
    told += evolve(old, 2)
    new = nearby()
    new.restore(state, iter(told))
    assert new.generation == 3
    assert new.ask() == told[3].genomes


def test_nonfinite_values_and_wrong_shapes_are_refused() -> None:
    with pytest.raises(
        ValueError,
        match=r"Nearby\._propose must return \(n, 7\) finite numbers, not array",
    ):
        nearby(scale=float("nan")).ask()
    with pytest.raises(ValueError, match="finite numbers"):
        nearby(candidates=0).ask()


def test_a_diverging_search_stays_within_float32() -> None:
    optimizer = nearby(scale=1e200)
    evolve(optimizer, 1)
    assert np.abs(optimizer.told[0][0]).max() == pytest.approx(FAR)


def test_genomes_that_are_no_vectors_are_refused_in_one_line() -> None:
    with pytest.raises(ConfigError, match=r"^optimizer: .* \(Vector\) are not vectors$"):
        make(Nearby, None)


class Rotated(Nearby):
    """Propose by a product of large matrices, which two threads add in another order."""

    def _propose(self) -> np.ndarray:
        turn = np.random.RandomState(1).randn(self.genes, self.genes)
        self.threads = [
            library["num_threads"]
            for library in threadpoolctl.threadpool_info()
            if library["user_api"] == "blas"
        ]
        return np.asarray(super()._propose() @ (turn @ turn.T) / self.genes)


def test_linear_algebra_uses_one_thread_in_every_program() -> None:
    """The program has its threads back afterwards."""
    genomes = []
    for threads in (1, 2):
        with threadpoolctl.threadpool_limits(threads, "blas"):
            optimizer = make(Rotated, 300, candidates=40)
            genomes.append(optimizer.ask())
            after = [
                library["num_threads"]
                for library in threadpoolctl.threadpool_info()
                if library["user_api"] == "blas"
            ]
        assert isinstance(optimizer, Rotated)
        assert set(optimizer.threads) == {1}
        assert set(after) == {threads}
    assert genomes[0] == genomes[1]


def test_the_ten_lines_of_the_document_are_an_optimizer() -> None:
    """They bring another optimizer of another package."""
    blocks = re.findall(
        r"^```python\n(.*?)^```", DOCUMENT.read_text(encoding="utf-8"), re.S | re.M
    )
    (code,) = (block for block in blocks if "(Adapter)" in block)
    namespace: dict[str, Any] = {}
    exec(compile(code, DOCUMENT.name, "exec"), namespace)  # noqa: S102  our own text
    check_optimizer(namespace["XNES"])
    assert evolve(make(namespace["XNES"], 7), 60)[-1].fitness.max() > -0.05
