"""OpenAI's evolution strategy, for long genomes.

Source: T. Salimans, J. Ho, X. Chen, S. Sidor, I. Sutskever, "Evolution Strategies as a Scalable
Alternative to Reinforcement Learning", 2017 (arXiv:1703.03864); the step: D. Kingma, J. Ba, "Adam",
ICLR 2015, algorithm 1. Unlike there, the mean is evaluated, too, and equal fitness shares its rank,
so that nothing moves where all is equal. Maths: docs/optimizers.md.
"""

from typing import Annotated

import numpy as np

from zswarm.config.meta import PartSettings, about, within
from zswarm.kernels.random import Stream, derive_seed
from zswarm.kernels.sums import mean, total
from zswarm.nets.representation import Representation
from zswarm.ot.optimizers import uncertainty
from zswarm.ot.optimizers.base import BaseOptimizer, setting_error
from zswarm.ot.optimizers.breeding import Population
from zswarm.ot.optimizers.space import Positive, Space
from zswarm.ot.optimizers.uncertainty import Evaluations

BETA_1, BETA_2, EPSILON = 0.9, 0.999, 1e-8  # as recommended for Adam


class OpenAIESSettings(PartSettings, frozen=True):
    """Settings of ``[optimizer]`` with ``kind = "openai-es"``."""

    population: Annotated[
        Population, about("steps of a generation: even, two per direction")
    ] = 50
    deviation: Annotated[Positive, about("standard deviation of a step, in ranges")] = 0.5
    learning_rate: Annotated[
        Positive, about("Adam's learning rate, in ranges of new genomes")
    ] = 0.1
    weight_decay: Annotated[
        float, within(0, 1e6, "pull to zero, per range and generation")
    ] = 0.005
    evaluations: Evaluations = 1


class OpenAIES(BaseOptimizer):
    """OpenAI's evolution strategy: moves one genome along an estimated gradient. For vectors.

    With fresh seeds nothing needs another evaluation: only the mean survives, and is evaluated in
    each generation.

    Statistics: best, mean, evaluations; ``centre``, the fitness of the mean genome; ``gradient``,
    the length of the estimated gradient; ``size``, the mean distance of the mean genome's numbers
    from zero, in ranges of new genomes; with ``evaluations`` above 1 ``evaluated``, how often each
    candidate was, and ``noise`` of their ranks.
    """

    settings_type = OpenAIESSettings
    competes = True
    stored = ("centre", "momentum", "squares", "decays", "effort")
    settings: OpenAIESSettings

    def __init__(
        self, settings: OpenAIESSettings, representation: Representation, seed: int
    ) -> None:
        super().__init__(settings, representation, seed)
        if settings.population % 2:
            text = (
                f"expected an even number, two per direction, not {settings.population}"
            )
            raise setting_error("population", text)
        self.candidates = settings.population + 1
        self.resamples = settings.evaluations > 1
        self._effort = 1.0  # see uncertainty
        if self.resamples:
            self.candidates += uncertainty.again(self.candidates)
            self.candidates *= settings.evaluations
        self._space = Space(representation)
        self._centre = self._space.uniform(
            -1.0, 1.0, 1, Stream(derive_seed(seed, "openai-es"))
        )
        self._momentum, self._squares = np.zeros((2, *self._centre.shape))
        self._decays = [1.0, 1.0]  # powers of beta 1 and beta 2

    def _ask(self) -> list[bytes]:
        """Return the mean, a step along each direction, and a step back along each."""
        steps = self.settings.deviation * self._directions()
        points = [self._centre, self._centre + steps, self._centre - steps]
        genomes = self._space.genomes(np.vstack(points))
        return [genomes[row] for row in self._rows()] if self.resamples else genomes

    def _rows(self) -> np.ndarray:
        return uncertainty.rows(self.settings.population + 1, self._effort)

    def _tell(self, fitness: np.ndarray, measures: np.ndarray) -> None:  # noqa: ARG002  unused
        settings, pairs = self.settings, self.settings.population // 2
        more: dict[str, float] = {}
        counted = fitness
        if self.resamples:
            rows = self._rows()
            fitness, noise = uncertainty.judge(
                fitness, settings.population + 1, self._effort
            )
            counted = fitness[rows]
            more = {"evaluated": float(int(self._effort)), "noise": noise}
            self._effort = uncertainty.adapted(self._effort, noise, settings.evaluations)
        shaped = _centred_ranks(fitness[1:])
        weights = shaped[:pairs] - shaped[pairs:]
        scale = settings.population * settings.deviation
        # Algorithm 1, line 7.
        gradient = total(weights[:, None] * self._directions()) / scale
        self._count(
            counted,
            centre=float(fitness[0]),
            gradient=float(np.sqrt(total(gradient * gradient))),
            size=mean(np.abs(self._centre)),
            **more,
        )
        self._step(gradient - settings.weight_decay * self._centre)

    def _directions(self) -> np.ndarray:
        """Return (pairs, genes), standard normal, the same throughout a generation."""
        return self._space.normal(
            self.settings.population // 2, self._stream("openai-es")
        )

    def _step(self, gradient: np.ndarray) -> None:
        """Follow the gradient upwards by Adam's algorithm 1."""
        self._momentum = BETA_1 * self._momentum + (1.0 - BETA_1) * gradient
        self._squares = BETA_2 * self._squares + (1.0 - BETA_2) * (gradient * gradient)
        self._decays = [BETA_1 * self._decays[0], BETA_2 * self._decays[1]]
        momentum = self._momentum / (1.0 - self._decays[0])
        squares = self._squares / (1.0 - self._decays[1])
        step = self.settings.learning_rate * momentum / (np.sqrt(squares) + EPSILON)
        self._centre = self._centre + step


def _centred_ranks(fitness: np.ndarray) -> np.ndarray:
    """Return ranks from -1/2, the worst, to 1/2, the best.

    Equal fitness shares the mean of its ranks. NaN is as bad as minus infinity.
    """
    values = np.where(np.isnan(fitness), -np.inf, fitness)
    ordered = np.sort(values)
    below, above = (np.searchsorted(ordered, values, side) for side in ("left", "right"))
    ranks: np.ndarray = (below + above - 1) / 2.0
    return ranks / (len(fitness) - 1) - 0.5
