"""Cellular evolution on a torus, FREVO's ``CEA2D`` (github.com/smartgrids-aau/Frevo, version 1.5).

Individuals sit in the cells of a grid without edges. Each looks at itself and its eight neighbours only: those that are among
the best of these stay; the others are replaced by a mutant of one of the best, by a child of themselves and one of the best, or
by a new random individual. Good genes spread from neighbour to neighbour, so that different ones last longer than in NNGA.
Obstacles and random neighbours are not offered: they are off by default there.

Kept as it is there: of equals one is the better, so that cells go on changing where all are as good; the elite is rounded to
whole individuals, to the even one of two.
Mended:
- ties are ranked by index (there a millionth of the index is added to the fitness, which changes orders, too).
Who stays keeps its fitness and is not evaluated again.
"""

from collections.abc import Iterable, Mapping
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from msgspec import Meta

from zswarm.draws import Stream, derive_seed
from zswarm.errors import ConfigError
from zswarm.nets.representation import Representation
from zswarm.ot.optimizers.diversity import distances_of_pairs
from zswarm.ot.optimizers.optimizer import Optimizer, Told
from zswarm.ot.optimizers.tally import Tally, mean

OPERATORS = ("elite", "mutation", "crossover", "renew")
HOOD = 9  # a cell and its neighbours

Share = Annotated[float, Meta(ge=0, le=1)]


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of ``[optimizer]`` with ``kind = "cea2d"``; what the shares leave over is new at random: none here."""

    width: Annotated[int, Meta(ge=3, le=1_000, description="cells in a row")] = 10
    height: Annotated[int, Meta(ge=3, le=1_000, description="rows")] = 10
    elite: Annotated[Share, Meta(description="share of a cell and its neighbours that counts as the best of them")] = 0.11
    mutation: Annotated[Share, Meta(description="share of mutants of one of the best")] = 0.59
    crossover: Annotated[Share, Meta(description="share of children of a cell and one of the best")] = 0.30
    mutation_method: Annotated[
        Literal[1, 2],
        Meta(description="1: absolute, plus or minus `severity` times the range; 2: relative to the gene"),
    ] = 1
    severity: Annotated[float, Meta(gt=0, le=1e6, description="of method 1")] = 0.3
    probability: Annotated[float, Meta(gt=0, le=1, description="that a gene of a mutant changes")] = 1.0


class CEA2D(Optimizer):
    """Cellular evolution on a torus: individuals compete and mate with their neighbours only, which keeps them different.

    Statistics: best, mean of all cells, evaluations; ``diversity_mean``, the distance between two individuals, over all pairs of
    250 at most; ``count_`` and the name of an operator (elite, mutation, crossover, renew), its individuals, and
    ``effectivity_``, the share of these that stays.
    """

    settings_type = Settings
    portable = True
    competes = True
    settings: Settings

    def __init__(self, settings: Settings, representation: Representation, seed: int) -> None:
        super().__init__(settings, representation, seed)
        self.candidates = settings.width * settings.height
        self.elite = round(HOOD * settings.elite)
        if self.elite < 1:
            raise ConfigError(f"optimizer: elite: {settings.elite} of {HOOD} cells is none; expected at least 1 of {HOOD}, 0.06")
        if self.elite == HOOD:
            raise ConfigError(f"optimizer: elite: with {settings.elite} all {HOOD} cells stay; expected 8 of {HOOD} at most")
        if settings.elite + settings.mutation + settings.crossover > 1.0 + 1e-9:
            raise ConfigError("optimizer: elite, mutation and crossover: expected shares of 1 at most in all")
        self._hoods = _hoods(settings.width, settings.height)
        self._tally = Tally()
        self._genomes: list[bytes] = []
        self._fitness = np.full(self.candidates, np.nan)
        self._operators = ["renew"] * self.candidates  # what made each
        self._cells = np.arange(self.candidates)  # cells whose fitness is waited for
        self._told: list[bytes] = []  # all genomes as they were after the last tell

    def _ask(self) -> list[bytes]:
        stream = Stream(derive_seed(self.seed, "cea2d", self.generation))
        if self.generation == 0:
            self._genomes = self.representation.random(len(self._fitness), stream)
        else:
            stays, best = self._ranked()
            self._cells = np.flatnonzero(~stays)
            self._evolve(best, stream)
        if self.relative:
            self._cells = np.arange(len(self._genomes))
        return [self._genomes[cell] for cell in self._cells]

    def _ranked(self) -> tuple[np.ndarray, np.ndarray]:
        """Which cells stay, (cells,) bool, and the best around each, (cells, elite) cell numbers, best first."""
        rank = np.empty(len(self._fitness), np.int64)
        rank[np.argsort(-self._fitness, kind="stable")] = np.arange(len(rank))  # NaN last, ties by index
        by_rank = np.argsort(rank[self._hoods], axis=1, kind="stable")
        best = np.take_along_axis(self._hoods, by_rank, axis=1)[:, : self.elite]
        return rank <= rank[best[:, -1]], best

    def _evolve(self, best: np.ndarray, stream: Stream) -> None:
        """Replace the cells that do not stay, all at once: what they see of one another is the generation before."""
        settings, count = self.settings, len(self._genomes)
        kinds, drawn = stream.uniform(0.0, 1.0 - settings.elite, count), stream.integers(self.elite, count)
        before, partners = list(self._genomes), best[np.arange(count), drawn]
        self._operators = ["elite"] * count
        for cell in self._cells.tolist():
            mutant, child = kinds[cell] < settings.mutation, kinds[cell] < settings.mutation + settings.crossover
            self._operators[cell] = "mutation" if mutant else "crossover" if child else "renew"
        cells = {name: [cell for cell in self._cells.tolist() if self._operators[cell] == name] for name in OPERATORS}
        mutants = self.representation.mutate(
            [before[partners[cell]] for cell in cells["mutation"]],
            stream,
            method=settings.mutation_method,
            severity=settings.severity,
            probability=settings.probability,
        )
        children = [self.representation.crossover(before[cell], before[partners[cell]], stream) for cell in cells["crossover"]]
        new = self.representation.random(len(cells["renew"]), stream)
        for name, made in (("mutation", mutants), ("crossover", children), ("renew", new)):
            for cell, genome in zip(cells[name], made, strict=True):
                self._genomes[cell] = genome

    def _tell(self, fitness: np.ndarray, measures: np.ndarray) -> None:  # noqa: ARG002  it wants none
        self._fitness[self._cells] = fitness
        stays, _ = self._ranked()
        numbers = {"mean": mean(self._fitness[~np.isnan(self._fitness)])}
        for name in OPERATORS:
            of_it = np.array([operator == name for operator in self._operators])
            count = int(of_it.sum())
            numbers |= {f"count_{name}": float(count), f"effectivity_{name}": int((of_it & stays).sum()) / max(1, count)}
        self._tally.add([self._genomes[cell] for cell in self._cells], fitness, numbers, relative=self.relative)
        self._told = list(self._genomes)

    def state(self) -> dict[str, Any]:
        """See ``Optimizer.state``."""
        return {
            "generation": self.generation,
            "tally": self._tally.state(),
            "genomes": self._genomes,
            "fitness": self._fitness.tolist(),
        }

    def restore(self, state: Mapping[str, Any], told: Iterable[Told]) -> None:  # noqa: ARG002  the state is all
        """See ``Optimizer.restore``."""
        self.generation = state["generation"]
        self._tally = Tally(**state["tally"])
        self._genomes = list(state["genomes"])
        self._told = list(self._genomes)
        self._fitness = np.array(state["fitness"])

    def best(self) -> tuple[bytes, float]:
        """See ``Optimizer.best``."""
        return self._tally.best()

    def statistics(self) -> dict[str, float]:
        """See the class."""
        return {**self._tally.statistics, "diversity_mean": mean(distances_of_pairs(self.representation, self._told))}


def _hoods(width: int, height: int) -> np.ndarray:
    """(cells, 9): numbers of each cell and of those around it, numbered row after row."""
    cells = np.arange(width * height).reshape(height, width)
    return np.stack([np.roll(cells, (dy, dx), (0, 1)).ravel() for dy in (1, 0, -1) for dx in (1, 0, -1)], axis=1)
