"""MAP-Elites and CMA-ME: the best candidate for each kind of behaviour, by the package ``ribs``.

Package: pyribs.org. Sources: J.-B. Mouret, J. Clune, arXiv:1504.04909; V. Vassiliades,
J.-B. Mouret, GECCO 2018 (the line of variation); M. Fontaine, J. Togelius, S. Nikolaidis,
A. Hoover, GECCO 2020. Titles: docs/optimizers.md.
"""

import math
from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np
from msgspec import field

from zswarm.config.meta import PartSettings, about, within
from zswarm.kernels.random import Stream, derive_seed
from zswarm.nets.representation import Representation
from zswarm.ot.optimizers.adapter import Adapter, Separable, Sigma, default_population
from zswarm.ot.optimizers.base import Measures, check_measures, setting_error
from zswarm.system.extras import need

MOST_CELLS = 1_000_000
# Functions that ribs compiles with numba: that takes 8 s, more than a run gains.
COMPILED = ("_transform_and_check_sol", "_calc_cov_update", "_calc_mean")


class ArchiveSettings(PartSettings, frozen=True):
    """Settings of the archive; lows, highs and cells are in the order of the measures."""

    measures: Measures = field(default_factory=list)
    lows: Annotated[list[float], about("lower end of the cells of each measure")] = field(
        default_factory=list
    )
    highs: Annotated[
        list[float], about("upper end; values outside are in the outermost cells")
    ] = field(default_factory=list)
    cells: Annotated[list[int], about("number of cells of each measure")] = field(
        default_factory=list
    )
    qd_score_offset: Annotated[
        float, about("lowest fitness; an elite adds its fitness minus this to `qd_score`")
    ] = 0.0

    def ranges(self) -> list[tuple[float, float]]:
        """Return low and high per measure.

        Raises:
            ConfigError: the settings do not fit together.
        """
        count = len(self.measures)
        check_measures(self.measures)
        if len(set(self.measures)) < count:
            raise setting_error(
                "measures", f"a name stands there twice: {', '.join(self.measures)}"
            )
        for key in ("lows", "highs", "cells"):
            given = len(getattr(self, key))
            if given != count:
                raise setting_error(
                    key, f"expected {count} numbers, one per measure, not {given}"
                )
        ranges = list(zip(self.lows, self.highs, strict=True))
        for name, (low, high), cells in zip(
            self.measures, ranges, self.cells, strict=True
        ):
            if not low < high or not math.isfinite(high - low):
                text = f"expected a low below its high, not {low:g} and {high:g}"
                raise setting_error(name, text)
            if cells < 1:
                raise setting_error(
                    "cells", f"expected at least 1 for {name}, not {cells}"
                )
        total = math.prod(self.cells)
        if total > MOST_CELLS:
            raise setting_error(
                "cells", f"expected at most {MOST_CELLS:,} in all, not {total:,}"
            )
        return ranges


class MapElitesSettings(ArchiveSettings, frozen=True):
    """Settings of ``[optimizer]`` with ``kind = "map-elites"``."""

    population: Annotated[int, within(1, 1_000_000, "candidates of a generation")] = 50
    sigma: Annotated[
        float, within(0, 1e3, "standard deviation of a gene from its parent's")
    ] = 0.05
    line: Annotated[
        float, within(0, 1e3, "of a step towards a second elite, in distances")
    ] = 0.2


class CmaMeSettings(ArchiveSettings, frozen=True):
    """Settings of ``[optimizer]`` with ``kind = "cma-me"``."""

    emitters: Annotated[
        int, within(1, 1_000, "evolution strategies that fill the archive")
    ] = 5
    population: Annotated[
        int, within(0, 100_000, "per emitter, at least 4; 0: 4 + 3 ln(genes)")
    ] = 0
    sigma: Sigma = 0.2
    separable: Separable = False


class Elites(Adapter):
    """An archive with a cell for each kind of behaviour; a child creates the emitters that fill it.

    With fresh seeds all elites are evaluated again, and find their cells again.

    Statistics: elites (cells that have one), coverage (their share), qd_score (the sum of their
    fitness, each minus ``qd_score_offset``).
    """

    settings: ArchiveSettings

    def __init__(
        self, settings: ArchiveSettings, representation: Representation, seed: int
    ) -> None:
        super().__init__(settings, representation, seed)
        self._ribs, archives = (
            need(name, "qd", "an optimizer with an archive")
            for name in ("ribs.emitters", "ribs.archives")
        )
        self.measures = tuple(settings.measures)
        self.archive = archives.GridArchive(
            solution_dim=self.genes,
            dims=settings.cells,
            ranges=settings.ranges(),
            qd_score_offset=settings.qd_score_offset,
            seed=derive_seed(seed, "archive"),
        )
        self._emitters: list[Any] = []
        self._again = 0  # elites that are evaluated again, the first of an ask

    def use_fresh_seeds(self) -> None:
        """See ``Optimizer``: all elites are evaluated again, and find their cells again."""
        super().use_fresh_seeds()
        self.candidates = None

    def _propose(self) -> np.ndarray:
        asked = [emitter.ask() for emitter in self._emitters]
        if self.fresh:
            asked.insert(0, self.archive.data("solution"))
            self._again = len(asked[0])
        return np.concatenate(asked)

    def _learn(
        self, solutions: np.ndarray, fitness: np.ndarray, measures: np.ndarray
    ) -> None:
        if self._again:
            self.archive.clear()
            whole = ~np.isnan(measures[: self._again]).any(axis=1)
            told = (solutions, fitness, measures)
            if whole.any():
                self.archive.add(*(numbers[: self._again][whole] for numbers in told))
            solutions, fitness, measures = (numbers[self._again :] for numbers in told)
        failed = np.isnan(measures).any(axis=1)
        if failed.all():
            return
        added = self.archive.add(solutions[~failed], fitness[~failed], measures[~failed])
        status = np.zeros(len(failed), np.int32)
        value = np.full(len(failed), added["value"].min())  # failed ones rank last
        status[~failed], value[~failed] = added["status"], added["value"]
        measures = np.where(failed[:, None], 0.0, measures)
        results = {"solution": solutions, "objective": fitness, "measures": measures}
        self._teach(results, {"status": status, "value": value})

    def _teach(
        self, results: Mapping[str, np.ndarray], added: Mapping[str, np.ndarray]
    ) -> None:
        """Tell the emitters, if they learn."""

    def _numbers(self) -> dict[str, float]:
        stats = self.archive.stats
        return {
            "elites": float(stats.num_elites),
            "coverage": float(stats.coverage),
            "qd_score": float(stats.qd_score),
        }


class MapElites(Elites):
    """A candidate is an elite's child: each gene slightly moved, and a step to another elite.

    The first ones are random. Statistics: those of ``Elites``. Portable: no.
    """

    settings_type = MapElitesSettings
    settings: MapElitesSettings

    def __init__(
        self, settings: MapElitesSettings, representation: Representation, seed: int
    ) -> None:
        super().__init__(settings, representation, seed)
        self.candidates = settings.population
        first = representation.random(
            self.candidates, Stream(derive_seed(seed, "map-elites"))
        )
        emitter = self._ribs.IsoLineEmitter(
            self.archive,
            iso_sigma=settings.sigma,
            line_sigma=settings.line,
            initial_solutions=self._space.points(first),
            batch_size=self.candidates,
            seed=derive_seed(seed, "emitter"),
        )
        self._emitters = [emitter]


class CmaMe(Elites):
    """Several CMA-ES that learn which of their candidates are new in the archive or improve it.

    One that finds neither restarts from an elite. Statistics: those of ``Elites``, and restarts.
    Portable: no.
    """

    settings_type = CmaMeSettings
    settings: CmaMeSettings

    def __init__(
        self, settings: CmaMeSettings, representation: Representation, seed: int
    ) -> None:
        super().__init__(settings, representation, seed)
        population = default_population(settings.population, self.genes)
        self.candidates = settings.emitters * population
        for number in range(settings.emitters):
            emitter = self._ribs.EvolutionStrategyEmitter(
                self.archive,
                x0=np.zeros(self.genes),
                sigma0=settings.sigma,
                ranker="2imp",  # Fontaine 2020, algorithm 2: new cells first, then improvement
                es="sep_cma_es" if settings.separable else "cma_es",
                batch_size=population,
                seed=derive_seed(seed, "emitter", number),
            )
            for name in COMPILED:
                plain = getattr(getattr(emitter._opt, name, None), "py_func", None)
                if plain is not None:
                    setattr(emitter._opt, name, plain)
            self._emitters.append(emitter)

    def _teach(
        self, results: Mapping[str, np.ndarray], added: Mapping[str, np.ndarray]
    ) -> None:
        begin = 0
        for emitter in self._emitters:
            own = slice(begin, begin := begin + emitter.batch_size)
            # The emitter learns from these as if they were what it proposed.
            emitter._opt._solutions = results["solution"][own]
            info = {name: values[own] for name, values in added.items()}
            part = {name: values[own] for name, values in results.items()}
            emitter.tell(**part, add_info=info)

    def _numbers(self) -> dict[str, float]:
        restarts = int(sum(emitter.restarts for emitter in self._emitters))
        return super()._numbers() | {"restarts": float(restarts)}
