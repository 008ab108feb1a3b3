"""CMA-ES: covariance matrix adaptation, by the package ``cmaes``.

Package: github.com/CyberAgentAILab/cmaes. Method: N. Hansen, arXiv:1604.00772. Separable form:
R. Ros, N. Hansen, PPSN 2008. Restarts: A. Auger, N. Hansen, CEC 2005 (ipop); N. Hansen, GECCO 2009
(bipop). Titles: docs/optimizers.md.
"""

import math
from typing import Annotated, Any, Literal

import numpy as np
from msgspec import Meta

from zswarm.config.meta import PartSettings, about
from zswarm.kernels.random import Stream, derive_seed
from zswarm.nets.representation import Representation
from zswarm.ot.optimizers import uncertainty
from zswarm.ot.optimizers.adapter import Adapter, Separable, Sigma, default_population
from zswarm.ot.optimizers.base import setting_error
from zswarm.ot.optimizers.uncertainty import Evaluations
from zswarm.system.extras import need

GROWTH = 2  # of the population from restart to restart

Count = Annotated[int, Meta(ge=0, le=1_000_000)]


class CmaesSettings(PartSettings, frozen=True):
    """Settings of ``[optimizer]`` with ``kind = "cmaes"``."""

    population: Annotated[
        Count, about("candidates per generation, 4 or more; 0: 4 + 3 ln(genes)")
    ] = 0
    sigma: Sigma = 0.5
    separable: Separable = False
    restarts: Annotated[
        Literal["none", "ipop", "bipop"],
        about(
            "after convergence. none: continue; ipop: restart with twice "
            "the population; bipop: also with small ones"
        ),
    ] = "ipop"
    largest: Annotated[
        Count, about("largest population after restarts; 0: 16 times the first")
    ] = 0
    evaluations: Evaluations = 1


class CMAES(Adapter):
    """Learns a normal distribution of genomes: mean, step size, correlations; few candidates.

    The first mean is zero, that of a restart uniform in the ranges. Statistics: sigma (in ranges),
    condition (of the covariance: longest by shortest axis, squared), population, restarts; with
    ``evaluations`` above 1 evaluated (how often each candidate was), noise (of ranks).
    Portable: no. It accepts relative fitness.
    """

    settings_type = CmaesSettings
    competes = True
    settings: CmaesSettings

    def __init__(
        self, settings: CmaesSettings, representation: Representation, seed: int
    ) -> None:
        super().__init__(settings, representation, seed)
        package = need("cmaes", "cmaes", "optimizer cmaes")
        self._make = package.SepCMA if settings.separable else package.CMA
        if settings.separable and self.genes < 2:
            text = f"expected a genome of at least 2 genes, not {self.genes}"
            raise setting_error("separable", text)
        self._first = default_population(settings.population, self.genes)
        self._largest = max(self._first, settings.largest or 16 * self._first)
        if 0 < settings.largest < self._first:
            text = f"expected 0, or at least the population of {self._first}"
            raise setting_error("largest", f"{text}, not {settings.largest}")
        self.candidates = self._first if settings.restarts == "none" else self._largest
        self.resamples = settings.evaluations > 1
        if self.resamples:
            self.candidates = settings.evaluations * (
                self.candidates + uncertainty.again(self.candidates)
            )
        self._effort = 1.0  # see uncertainty
        self._restarts = 0
        self._grown = 0  # starts with a larger population
        # Whether this is one of bipop's small starts; the first one counts.
        self._small = True
        self._spent = {False: 0, True: 0}  # evaluations of large and small starts
        self._shown: dict[str, float] = {}
        self._search = self._start(self._first, settings.sigma, np.zeros(self.genes))

    def _propose(self) -> np.ndarray:
        count = self._search.population_size
        proposed = np.array([self._search.ask() for _ in range(count)])
        return proposed[self._rows()] if self.resamples else proposed

    def _rows(self) -> np.ndarray:
        return uncertainty.rows(self._search.population_size, self._effort)

    def _tell(self, fitness: np.ndarray, measures: np.ndarray) -> None:
        if not self.resamples:
            super()._tell(fitness, measures)
            return
        search, most, asked = self._search, self.settings.evaluations, self._rows()
        judged = uncertainty.judge(fitness, search.population_size, self._effort)
        used, self._effort = (
            self._effort,
            uncertainty.adapted(self._effort, judged.noise, most),
        )
        super()._tell(judged.fitness[asked], measures)
        if judged.noise > 0.0 and used == most and search is self._search:
            search._sigma *= 1.0 + 2.0 / (self.genes + 10)
        self._statistics |= {"evaluated": float(int(used)), "noise": judged.noise}

    def _learn(
        self,
        solutions: np.ndarray,
        fitness: np.ndarray,
        measures: np.ndarray,  # noqa: ARG002  unused
    ) -> None:
        search = self._search
        count = search.population_size
        solutions, fitness = solutions[:count], fitness[:count]  # each once
        # It minimizes.
        search.tell(list(zip(solutions, (-fitness).tolist(), strict=True)))
        stops = search.should_stop()
        axes = search._D  # square roots of the covariance's eigenvalues, by should_stop
        self._shown = {
            "sigma": float(search._sigma),
            "condition": float((axes.max() / axes.min()) ** 2),
            "population": float(search.population_size),
        }
        self._spent[self._small] += len(fitness)
        if stops and self.settings.restarts != "none":
            self._restart()
        self._shown["restarts"] = float(self._restarts)

    def _numbers(self) -> dict[str, float]:
        return self._shown

    def _restart(self) -> None:
        self._restarts += 1
        stream = Stream(derive_seed(self.seed, "cmaes", self._restarts))
        mean = stream.uniform(-1.0, 1.0, self.genes)
        self._small = (
            self.settings.restarts == "bipop" and self._spent[True] < self._spent[False]
        )
        self._grown += not self._small
        population = min(self._largest, self._first * GROWTH**self._grown)
        sigma = self.settings.sigma
        if self._small:  # Hansen 2009, section 2
            power, steps = stream.uniform(0.0, 1.0, 2).tolist()
            small = math.floor(
                self._first * (0.5 * population / self._first) ** (power**2)
            )
            population = max(self._first, small)
            sigma = sigma * 10 ** (-2 * steps)
        self._search = self._start(population, sigma, mean)

    def _start(self, population: int, sigma: float, mean: np.ndarray) -> Any:
        seed = derive_seed(self.seed, "cmaes", self._restarts) >> 32
        if not self.resamples:
            self.survivors = population // 2  # those that the mean moves to
        return self._make(mean=mean, sigma=sigma, seed=seed, population_size=population)
