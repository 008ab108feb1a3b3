"""Random search, FREVO's ``RandomSearch``: the baseline that other methods must beat.

As in FREVO, the best individual survives, and is not evaluated again on the same seeds.
"""

from typing import Annotated

import numpy as np

from zswarm.config.meta import PartSettings, about
from zswarm.nets.representation import Representation
from zswarm.ot.optimizers.base import BaseOptimizer
from zswarm.ot.optimizers.breeding import Population


class RandomSearchSettings(PartSettings, frozen=True):
    """Settings of ``[optimizer]`` with ``kind = "random"``."""

    population: Annotated[Population, about("individuals, including the best so far")] = (
        50
    )


class RandomSearch(BaseOptimizer):
    """Random search: new random genomes in every generation; what other methods must beat.

    With fresh seeds the best is evaluated again.

    Statistics: best, mean of those evaluated in the last generation, evaluations.
    """

    settings_type = RandomSearchSettings
    competes = True
    settings: RandomSearchSettings

    def __init__(
        self, settings: RandomSearchSettings, representation: Representation, seed: int
    ) -> None:
        super().__init__(settings, representation, seed)
        self.candidates = settings.population
        self.survivors = 1

    def _ask(self) -> list[bytes]:
        stream, (best, _) = self._stream("random"), self._best
        genomes = self.representation.random(
            self.settings.population - bool(best), stream
        )
        return [best, *genomes] if best and (self.relative or self.fresh) else genomes

    def _tell(self, fitness: np.ndarray, measures: np.ndarray) -> None:  # noqa: ARG002  unused
        self._count(fitness)
