"""Random search, FREVO's ``RandomSearch``: new random genomes in every generation; what others must beat.

As there, one individual stays: the best so far, which is not evaluated again.
"""

from collections.abc import Iterable, Mapping
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta

from zswarm.draws import Stream, derive_seed
from zswarm.nets.representation import Representation
from zswarm.ot.optimizers.optimizer import Optimizer, Told
from zswarm.ot.optimizers.tally import Tally


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of ``[optimizer]`` with ``kind = "random"``."""

    population: Annotated[
        int, Meta(ge=2, le=1_000_000, description="individuals of a generation; the best so far is one of them")
    ] = 50


class RandomSearch(Optimizer):
    """Random search: new random genomes in every generation, beside the best so far; what other methods must beat.

    Statistics: best, mean of those evaluated in the last generation, evaluations.
    """

    settings_type = Settings
    portable = True
    competes = True
    settings: Settings

    def __init__(self, settings: Settings, representation: Representation, seed: int) -> None:
        super().__init__(settings, representation, seed)
        self.candidates = settings.population
        self._tally = Tally()
        self._genomes: list[bytes] = []

    def _ask(self) -> list[bytes]:
        stream = Stream(derive_seed(self.seed, "random", self.generation))
        best = self._tally.genome
        self._genomes = self.representation.random(self.settings.population - bool(best), stream)
        if best and self.relative:
            self._genomes.insert(0, best)
        return self._genomes

    def _tell(self, fitness: np.ndarray, measures: np.ndarray) -> None:  # noqa: ARG002  it wants none
        self._tally.add(self._genomes, fitness, relative=self.relative)

    def state(self) -> dict[str, Any]:
        """See ``Optimizer.state``."""
        return {"generation": self.generation, "tally": self._tally.state()}

    def restore(self, state: Mapping[str, Any], told: Iterable[Told]) -> None:  # noqa: ARG002  the state is all
        """See ``Optimizer.restore``."""
        self.generation = state["generation"]
        self._tally = Tally(**state["tally"])

    def best(self) -> tuple[bytes, float]:
        """See ``Optimizer.best``."""
        return self._tally.best()

    def statistics(self) -> dict[str, float]:
        """See the class."""
        return dict(self._tally.statistics)
