"""CMA-ES: covariance matrix adaptation, by the package ``cmaes`` (github.com/CyberAgentAILab/cmaes).

N. Hansen, "The CMA Evolution Strategy: A Tutorial", arXiv:1604.00772; the separable form: R. Ros and N. Hansen, "A Simple
Modification in CMA-ES Achieving Linear Time and Space Complexity", PPSN 2008. Restarts: A. Auger and N. Hansen, "A Restart
CMA Evolution Strategy With Increasing Population Size", CEC 2005 (ipop); N. Hansen, "Benchmarking a BI-Population CMA-ES on
the BBOB-2009 Function Testbed", GECCO 2009 (bipop).
"""

import math
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from msgspec import Meta

from zswarm.draws import Stream, derive_seed
from zswarm.errors import ConfigError
from zswarm.extras import need
from zswarm.nets.representation import Representation
from zswarm.ot.optimizers.adapter import Adapter

FEWEST = 4  # candidates: with less the best of them alone would decide, and no covariance be learned
GROWTH = 2  # of the population from restart to restart


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of ``[optimizer]`` with ``kind = "cmaes"``."""

    population: Annotated[
        int, Meta(ge=0, le=1_000_000, description="candidates of a generation, from 4; 0: 4 + 3 ln(genes), 16 for 60 genes")
    ] = 0
    sigma: Annotated[
        float, Meta(gt=0, le=1e3, description="first standard deviation, in ranges of new weights: 0.5 of 2.0 is 1.0")
    ] = 0.5
    separable: Annotated[
        bool, Meta(description="learns a scale per gene and no correlations: for genomes of more than some 200 genes")
    ] = False
    restarts: Annotated[
        Literal["none", "ipop", "bipop"],
        Meta(
            description="what follows when it has converged. none: nothing; ipop: a start elsewhere with twice the population; "
            "bipop: such ones, and small ones between them"
        ),
    ] = "ipop"
    largest: Annotated[
        int, Meta(ge=0, le=1_000_000, description="candidates of a generation after restarts at most; 0: 16 times the first")
    ] = 0


class CMAES(Adapter):
    """Learns a normal distribution: its mean, step size and the correlations of genes; few candidates, no crossover.

    The first mean is zero, that of a restart uniform in the ranges. Statistics: sigma (in ranges), condition (of the
    covariance: the longest axis by the shortest, squared), population, restarts. Portable: no. It takes relative fitness.
    """

    settings_type = Settings
    competes = True
    settings: Settings

    def __init__(self, settings: Settings, representation: Representation, seed: int) -> None:
        super().__init__(settings, representation, seed)
        package = need("cmaes", "cmaes", "optimizer cmaes")
        self._make = package.SepCMA if settings.separable else package.CMA
        if settings.separable and self.genes < 2:
            raise ConfigError(f"optimizer: separable: expected a genome of 2 genes at least, not {self.genes}")
        self._first = settings.population or FEWEST + math.floor(3 * math.log(self.genes))
        if self._first < FEWEST:
            raise ConfigError(f"optimizer: population: expected 0, or {FEWEST} at least, not {settings.population}")
        self._largest = max(self._first, settings.largest or 16 * self._first)
        if 0 < settings.largest < self._first:
            raise ConfigError(
                f"optimizer: largest: expected 0, or the population of {self._first} at least, not {settings.largest}"
            )
        self.candidates = self._first if settings.restarts == "none" else self._largest
        self._restarts = 0
        self._grown = 0  # starts with a larger population
        self._small = True  # whether this start is one of bipop's small ones; the first counts as one
        self._spent = {False: 0, True: 0}  # evaluations of large and small starts
        self._told: dict[str, float] = {}
        self._search = self._start(self._first, settings.sigma, np.zeros(self.genes))

    def _propose(self) -> np.ndarray:
        return np.array([self._search.ask() for _ in range(self._search.population_size)])

    def _learn(self, solutions: np.ndarray, fitness: np.ndarray, measures: np.ndarray) -> None:  # noqa: ARG002  it wants none
        search = self._search
        search.tell([(solution, -value) for solution, value in zip(solutions, fitness.tolist(), strict=True)])  # it minimizes
        stops = search.should_stop()
        axes = search._D  # square roots of the covariance's eigenvalues; should_stop has computed them
        self._told = {
            "sigma": float(search._sigma),
            "condition": float((axes.max() / axes.min()) ** 2),
            "population": float(search.population_size),
        }
        self._spent[self._small] += len(fitness)
        if stops and self.settings.restarts != "none":
            self._restart()
        self._told["restarts"] = float(self._restarts)

    def _numbers(self) -> dict[str, float]:
        return self._told

    def _restart(self) -> None:
        self._restarts += 1
        stream = Stream(derive_seed(self.seed, "cmaes", self._restarts))
        mean = stream.uniform(-1.0, 1.0, self.genes)
        self._small = self.settings.restarts == "bipop" and self._spent[True] < self._spent[False]
        if not self._small:
            self._grown += 1
        large = min(self._largest, self._first * GROWTH**self._grown)
        if self._small:  # Hansen 2009, section 2: between the first population and half of the large one, and smaller steps
            power, steps = stream.uniform(0.0, 1.0, 2).tolist()
            population = math.floor(self._first * (0.5 * large / self._first) ** (power**2))
            self._search = self._start(max(self._first, population), self.settings.sigma * 10 ** (-2 * steps), mean)
        else:
            self._search = self._start(large, self.settings.sigma, mean)

    def _start(self, population: int, sigma: float, mean: np.ndarray) -> Any:
        seed = derive_seed(self.seed, "cmaes", self._restarts) >> 32
        return self._make(mean=mean, sigma=sigma, seed=seed, population_size=population)
