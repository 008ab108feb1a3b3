"""A base class of the bundled optimizers: best genome, statistics and state."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Annotated, Any, ClassVar

import msgspec
import numpy as np

from zswarm.config.meta import about
from zswarm.errors import ConfigError
from zswarm.kernels.random import Stream, derive_seed
from zswarm.kernels.sums import mean
from zswarm.nets.representation import Representation
from zswarm.ot.optimizers.optimizer import Optimizer, Told

Measures = Annotated[list[str], about("metrics that describe behaviour; at least one")]

COUNTED = ("best", "evaluations", "statistics")


class BaseOptimizer(Optimizer):
    """An optimizer that counts evaluations; a child writes ``_ask`` and ``_tell``.

    Attributes:
        stored: names of the attributes, without the underscore, that are its state besides the
            counts: tables of float64, vectors, genomes, structs, numbers.
        types: types of those that hold structs.
    """

    portable = True
    stored: ClassVar[Sequence[str]] = ()
    types: ClassVar[Mapping[str, Any]] = {}

    def __init__(
        self, settings: msgspec.Struct, representation: Representation, seed: int
    ) -> None:
        super().__init__(settings, representation, seed)
        self._best = (b"", float("-inf"))
        self._evaluations = 0
        self._statistics: dict[str, float] = {}

    def state(self) -> dict[str, Any]:
        """See ``Optimizer``."""
        stored = {
            name: _plain(getattr(self, f"_{name}")) for name in (*COUNTED, *self.stored)
        }
        return {"generation": self.generation, **stored}

    def restore(self, state: Mapping[str, Any], told: Iterable[Told]) -> None:  # noqa: ARG002  the state is enough
        """See ``Optimizer``."""
        self.generation = state["generation"]
        for name in (*COUNTED, *self.stored):
            value, current = state[name], getattr(self, f"_{name}")
            if isinstance(value, bytes):
                value = np.frombuffer(value, np.float64).reshape(-1, current.shape[1])
            elif isinstance(current, np.ndarray):
                value = np.array(value)
            else:
                value = msgspec.convert(value, self.types.get(name, type(current)))
            setattr(self, f"_{name}", value)

    def best(self) -> tuple[bytes, float]:
        """See ``Optimizer``."""
        return self._best

    def statistics(self) -> dict[str, float]:
        """Return the statistics that the class's docstring names."""
        return dict(self._statistics)

    def _count(self, fitness: np.ndarray, **statistics: float) -> None:
        """Count the generation asked for.

        Args:
            fitness: (genomes asked,) float64, NaN where evaluation failed.
            statistics: added to ``best``, ``mean`` and ``evaluations``, or replacing them.
        """
        genome = self._best[0]
        if self.relative or (self.fresh and genome in self._asked):
            # Its former fitness is outdated.
            self._best = (b"", float("-inf"))
        for genome, value in zip(self._asked, fitness.tolist(), strict=True):
            if value > self._best[1]:
                self._best = (genome, value)
        self._evaluations += len(fitness)
        self._statistics = {
            "best": self._best[1],
            "mean": mean(fitness),
            "evaluations": float(self._evaluations),
            **statistics,
        }

    def _stream(self, purpose: str) -> Stream:
        """Return the random numbers of this generation."""
        return Stream(derive_seed(self.seed, purpose, self.generation))


def check_measures(measures: Sequence[str]) -> None:
    """Refuse to search without measures."""
    if not measures:
        raise setting_error(
            "measures", "expected the names of metrics that describe behaviour"
        )


def setting_error(key: str, text: str) -> ConfigError:
    """Return the error about a key of ``[optimizer]``."""
    return ConfigError(f"optimizer: {key}: {text}")


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tobytes() if value.ndim == 2 else value.tolist()
    return msgspec.to_builtins(value, builtin_types=(bytes,))
