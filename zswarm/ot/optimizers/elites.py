"""MAP-Elites and CMA-ME: the best candidate for each kind of behaviour, by the package ``ribs`` (pyribs.org).

J.-B. Mouret and J. Clune, "Illuminating search spaces by mapping elites", arXiv:1504.04909; V. Vassiliades and J.-B. Mouret,
"Discovering the Elite Hypervolume by Leveraging Interspecies Correlation", GECCO 2018 (the line of variation); M. Fontaine,
J. Togelius, S. Nikolaidis and A. Hoover, "Covariance Matrix Adaptation for the Rapid Illumination of Behavior Space", GECCO 2020.
"""

import math
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta

from zswarm.draws import Stream, derive_seed
from zswarm.errors import ConfigError
from zswarm.extras import need
from zswarm.nets.representation import Representation
from zswarm.ot.optimizers.adapter import Adapter

MOST_CELLS = 1_000_000
FEWEST = 4  # candidates of an evolution strategy
COMPILED = ("_transform_and_check_sol", "_calc_cov_update", "_calc_mean")  # functions that ribs has numba compile


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What both have; lows, highs and cells stand in the order of the measures."""

    measures: Annotated[list[str], Meta(description="metrics of the simulator that tell behaviours apart; at least one")] = []
    lows: Annotated[
        list[float], Meta(description="of each measure, where its cells begin; what is lower is in the first one")
    ] = []
    highs: Annotated[list[float], Meta(description="where they end; what is higher is in the last one")] = []
    cells: Annotated[list[int], Meta(description="of each measure, how many cells lie between its low and its high")] = []
    qd_score_offset: Annotated[
        float, Meta(description="what each elite adds to `qd_score` is its fitness minus this: the lowest there is")
    ] = 0.0


class MapElitesSettings(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of ``[optimizer]`` with ``kind = "map-elites"``."""

    population: Annotated[int, Meta(ge=1, le=1_000_000, description="candidates of a generation")] = 50
    sigma: Annotated[
        float, Meta(ge=0, le=1e3, description="standard deviation of a gene from its parent's, in ranges of new weights")
    ] = 0.05
    line: Annotated[
        float, Meta(ge=0, le=1e3, description="of a step along the line to a second elite, in distances to it; 0: none")
    ] = 0.2


class CmaMeSettings(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of ``[optimizer]`` with ``kind = "cma-me"``."""

    emitters: Annotated[int, Meta(ge=1, le=1_000, description="evolution strategies that fill the archive together")] = 5
    population: Annotated[
        int, Meta(ge=0, le=100_000, description="candidates of an emitter, from 4; 0: 4 + 3 ln(genes), 16 for 60 genes")
    ] = 0
    sigma: Annotated[float, Meta(gt=0, le=1e3, description="first standard deviation of each, in ranges of new weights")] = 0.2
    separable: Annotated[
        bool, Meta(description="emitters learn a scale per gene and no correlations: for genomes of more than some 200 genes")
    ] = False


class Elites(Adapter):
    """An archive with a cell for each kind of behaviour, and emitters that fill it; a child makes the emitters.

    Statistics: elites (cells that have one), coverage (their share), qd_score (the sum of their fitness, each minus
    ``qd_score_offset``).
    """

    settings: Settings

    def __init__(self, settings: Settings, representation: Representation, seed: int) -> None:
        super().__init__(settings, representation, seed)
        self._ribs = need("ribs.emitters", "qd", "an optimizer with an archive")
        self.measures = tuple(settings.measures)
        self.archive = need("ribs.archives", "qd", "an optimizer with an archive").GridArchive(
            solution_dim=self.genes,
            dims=settings.cells,
            ranges=_ranges(settings),
            qd_score_offset=settings.qd_score_offset,
            seed=derive_seed(seed, "archive"),
        )
        self._emitters: list[Any] = []

    def _propose(self) -> np.ndarray:
        self._proposed = [emitter.ask() for emitter in self._emitters]
        return np.concatenate(self._proposed)

    def _learn(self, solutions: np.ndarray, fitness: np.ndarray, measures: np.ndarray) -> None:
        failed = np.isnan(measures).any(axis=1)
        if failed.all():
            return
        added = self.archive.add(solutions[~failed], fitness[~failed], measures[~failed])
        status, value = np.zeros(len(failed), np.int32), np.full(len(failed), added["value"].min())  # failed ones rank last
        status[~failed], value[~failed] = added["status"], added["value"]
        self._teach(solutions, fitness, np.where(failed[:, None], 0.0, measures), {"status": status, "value": value})

    def _teach(self, solutions: np.ndarray, fitness: np.ndarray, measures: np.ndarray, added: dict[str, np.ndarray]) -> None:
        """Tell the emitters, where they learn."""

    def _numbers(self) -> dict[str, float]:
        stats = self.archive.stats
        return {
            "elites": float(stats.num_elites),
            "coverage": float(stats.coverage),
            "qd_score": float(stats.qd_score),
        }


class MapElites(Elites):
    """A candidate is an elite's child: each gene a little off, and the whole drawn towards or away from another elite.

    The first ones are random. Statistics: those of ``Elites``. Portable: no.
    """

    settings_type = MapElitesSettings
    settings: MapElitesSettings

    def __init__(self, settings: MapElitesSettings, representation: Representation, seed: int) -> None:
        super().__init__(settings, representation, seed)
        self.candidates = settings.population
        first = representation.random(self.candidates, Stream(derive_seed(seed, "map-elites")))
        emitter = self._ribs.IsoLineEmitter(
            self.archive,
            iso_sigma=settings.sigma,
            line_sigma=settings.line,
            initial_solutions=self._space.of(first),
            batch_size=self.candidates,
            seed=derive_seed(seed, "emitter"),
        )
        self._emitters = [emitter]


class CmaMe(Elites):
    """Several CMA-ES that are told which of their candidates are new in the archive or improve it, most of all new ones.

    One that finds neither starts again from an elite. Statistics: those of ``Elites``, and restarts. Portable: no.
    """

    settings_type = CmaMeSettings
    settings: CmaMeSettings

    def __init__(self, settings: CmaMeSettings, representation: Representation, seed: int) -> None:
        super().__init__(settings, representation, seed)
        population = settings.population or FEWEST + math.floor(3 * math.log(self.genes))
        if population < FEWEST:
            raise ConfigError(f"optimizer: population: expected 0, or {FEWEST} at least, not {settings.population}")
        self.candidates = settings.emitters * population
        self._emitters = [
            self._ribs.EvolutionStrategyEmitter(
                self.archive,
                x0=np.zeros(self.genes),
                sigma0=settings.sigma,
                ranker="2imp",  # Fontaine 2020, algorithm 2: new cells first, then by improvement
                es="sep_cma_es" if settings.separable else "cma_es",
                batch_size=population,
                seed=derive_seed(seed, "emitter", emitter),
            )
            for emitter in range(settings.emitters)
        ]
        for emitter in self._emitters:
            for name in COMPILED:  # that takes 8 s, more than it gives a run
                plain = getattr(getattr(emitter._opt, name, None), "py_func", None)
                if plain is not None:
                    setattr(emitter._opt, name, plain)

    def _teach(self, solutions: np.ndarray, fitness: np.ndarray, measures: np.ndarray, added: dict[str, np.ndarray]) -> None:
        begin = 0
        for emitter in self._emitters:
            own = slice(begin, begin := begin + emitter.batch_size)
            emitter._opt._solutions = solutions[own]  # it learns from those, and takes them for what it proposed
            emitter.tell(
                solution=solutions[own],
                objective=fitness[own],
                measures=measures[own],
                add_info={name: values[own] for name, values in added.items()},
            )

    def _numbers(self) -> dict[str, float]:
        return super()._numbers() | {"restarts": float(sum(emitter.restarts for emitter in self._emitters))}


def _ranges(settings: Settings) -> list[tuple[float, float]]:
    """From low to high, per measure.

    Raises:
        ConfigError: they do not fit together.
    """
    count = len(settings.measures)
    if not count:
        raise ConfigError("optimizer: measures: expected the names of metrics that tell behaviours apart")
    if len(set(settings.measures)) < count:
        raise ConfigError(f"optimizer: measures: a name stands there twice: {', '.join(settings.measures)}")
    for key in ("lows", "highs", "cells"):
        if len(getattr(settings, key)) != count:
            raise ConfigError(f"optimizer: {key}: expected {count} numbers, one per measure, not {len(getattr(settings, key))}")
    for name, low, high, cells in zip(settings.measures, settings.lows, settings.highs, settings.cells, strict=True):
        if not low < high or not math.isfinite(high - low):
            raise ConfigError(f"optimizer: {name}: expected a low below its high, not {low:g} and {high:g}")
        if cells < 1:
            raise ConfigError(f"optimizer: cells: expected 1 at least for {name}, not {cells}")
    if math.prod(settings.cells) > MOST_CELLS:
        raise ConfigError(f"optimizer: cells: expected {MOST_CELLS:,} in all at most, not {math.prod(settings.cells):,}")
    return list(zip(settings.lows, settings.highs, strict=True))
