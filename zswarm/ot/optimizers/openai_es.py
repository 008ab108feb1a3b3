"""OpenAI's evolution strategy, for long genomes.

After T. Salimans, J. Ho, X. Chen, S. Sidor, I. Sutskever, "Evolution Strategies as a Scalable Alternative to Reinforcement
Learning", 2017 (arXiv:1703.03864). One genome, the mean, is moved along an estimate of the gradient: the sum of random
directions, each weighted by the fitness that a step along it has. As there: every direction is tried both ways (antithetic
sampling, section 2.1), fitness is replaced by its rank (fitness shaping), weights decay (section 3), and Adam takes the step (D.
Kingma, J. Ba, "Adam", ICLR 2015, algorithm 1).
Of its own: the mean is evaluated, too, and equal fitness shares its rank, so that where all is equal nothing moves.
"""

from collections.abc import Iterable, Mapping
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta

from zswarm.draws import Stream, derive_seed
from zswarm.errors import ConfigError
from zswarm.nets.representation import Representation
from zswarm.ot.optimizers.optimizer import Optimizer, Told
from zswarm.ot.optimizers.space import Space
from zswarm.ot.optimizers.tally import Tally, mean, total

BETA_1, BETA_2, EPSILON = 0.9, 0.999, 1e-8  # of Adam, as its authors recommend


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of ``[optimizer]`` with ``kind = "openai-es"``."""

    population: Annotated[
        int, Meta(ge=2, le=1_000_000, description="steps tried in a generation, two of each direction: even")
    ] = 50
    deviation: Annotated[float, Meta(gt=0, le=1e6, description="standard deviation of a step, in ranges of new genomes")] = 0.5
    learning_rate: Annotated[float, Meta(gt=0, le=1e6, description="of Adam, in ranges of new genomes")] = 0.1
    weight_decay: Annotated[
        float, Meta(ge=0, le=1e6, description="pull to zero, per range and generation, beside the gradient")
    ] = 0.005


class OpenAIES(Optimizer):
    """OpenAI's evolution strategy: moves one genome along an estimated gradient. For vectors of numbers, also long ones.

    Statistics: best, mean, evaluations; ``centre``, the fitness of the mean genome; ``gradient``, the length of the estimated
    gradient; ``size``, how far from zero the mean's numbers are, on average, in ranges of new genomes.
    """

    settings_type = Settings
    portable = True
    competes = True
    settings: Settings

    def __init__(self, settings: Settings, representation: Representation, seed: int) -> None:
        super().__init__(settings, representation, seed)
        if settings.population % 2:
            raise ConfigError(
                f"optimizer: population: expected an even number, two for each direction, not {settings.population}"
            )
        self.candidates = settings.population + 1
        self._space = Space(representation)
        self._tally = Tally()
        self._centre = self._space.uniform(-1.0, 1.0, 1, Stream(derive_seed(seed, "openai-es")))[0]
        self._momentum, self._squares = np.zeros((2, self._space.dimensions))
        self._decays = (1.0, 1.0)  # powers of beta 1 and beta 2

    def _ask(self) -> list[bytes]:
        return self._space.genomes(np.vstack([self._centre, self._samples()]))

    def _tell(self, fitness: np.ndarray, measures: np.ndarray) -> None:  # noqa: ARG002  it wants none
        settings, pairs = self.settings, self.settings.population // 2
        shaped = _centred_ranks(fitness[1:])
        weights = shaped[:pairs] - shaped[pairs:]
        gradient = total(weights[:, None] * self._directions()) / (
            settings.population * settings.deviation
        )  # algorithm 1, line 7
        numbers = {
            "centre": float(fitness[0]),
            "gradient": float(np.sqrt(total(gradient * gradient))),
            "size": mean(np.abs(self._centre)),
        }
        self._tally.add(self._space.genomes(np.vstack([self._centre, self._samples()])), fitness, numbers, relative=self.relative)
        self._step(gradient - settings.weight_decay * self._centre)

    def _directions(self) -> np.ndarray:
        """(pairs, genes), standard normal; of a generation always the same."""
        return self._space.normal(self.settings.population // 2, Stream(derive_seed(self.seed, "openai-es", self.generation)))

    def _samples(self) -> np.ndarray:
        """(population, genes): a step along each direction, then a step back along each."""
        steps = self.settings.deviation * self._directions()
        return np.vstack([self._centre + steps, self._centre - steps])

    def _step(self, gradient: np.ndarray) -> None:
        """Adam, algorithm 1, upwards."""
        self._momentum = BETA_1 * self._momentum + (1.0 - BETA_1) * gradient
        self._squares = BETA_2 * self._squares + (1.0 - BETA_2) * (gradient * gradient)
        self._decays = (BETA_1 * self._decays[0], BETA_2 * self._decays[1])
        momentum = self._momentum / (1.0 - self._decays[0])
        squares = self._squares / (1.0 - self._decays[1])
        self._centre = self._centre + self.settings.learning_rate * momentum / (np.sqrt(squares) + EPSILON)

    def state(self) -> dict[str, Any]:
        """See ``Optimizer.state``."""
        return {
            "generation": self.generation,
            "tally": self._tally.state(),
            "centre": self._centre.tobytes(),
            "momentum": self._momentum.tobytes(),
            "squares": self._squares.tobytes(),
            "decays": list(self._decays),
        }

    def restore(self, state: Mapping[str, Any], told: Iterable[Told]) -> None:  # noqa: ARG002  the state is all
        """See ``Optimizer.restore``."""
        self.generation = state["generation"]
        self._tally = Tally(**state["tally"])
        self._centre, self._momentum, self._squares = (
            self._space.points(state[name])[0] for name in ("centre", "momentum", "squares")
        )
        self._decays = (state["decays"][0], state["decays"][1])

    def best(self) -> tuple[bytes, float]:
        """See ``Optimizer.best``."""
        return self._tally.best()

    def statistics(self) -> dict[str, float]:
        """See the class."""
        return dict(self._tally.statistics)


def _centred_ranks(fitness: np.ndarray) -> np.ndarray:
    """From -1/2 of the worst to 1/2 of the best; equals share the mean of their ranks; NaN is as bad as minus infinity."""
    known = np.isnan(fitness)
    ordered = np.sort(np.where(known, -np.inf, fitness))
    values = np.where(known, -np.inf, fitness)
    ranks = (np.searchsorted(ordered, values, "left") + np.searchsorted(ordered, values, "right") - 1) / 2.0
    return ranks / (len(fitness) - 1) - 0.5
