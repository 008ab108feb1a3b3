"""The contract of an optimizer: ask for genomes, tell their fitness and measures."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

import msgspec
import numpy as np

from zswarm.nets.representation import Representation


class Told(NamedTuple):
    """A generation that an optimizer was told."""

    genomes: Sequence[bytes]
    fitness: np.ndarray  # (genomes,) float64
    measures: np.ndarray  # (genomes, len(Optimizer.measures)) float64


class Optimizer(ABC):
    """Proposes genomes and learns from their fitness; a child writes ``_ask``, ``_tell``, ``state``, ``restore``.

    Attributes:
        settings_type: the struct of its settings in an experiment file.
        portable: whether it does the same on every machine, bit for bit (linear algebra does not).
        competes: whether it also takes fitness that compares within a generation only, as a tournament gives it.
        relative: whether fitness is such; set before the first ask. Then an ask gives all that shall compete, those that
            were evaluated before again, and ``best`` is of the last generation.
        measures: names of the simulator's metrics that a tell wants beside fitness.
        generation: generations told.
        candidates: genomes that one ask gives at most; None: it cannot say.
        strayed: the first generation in which ``restore`` would have asked other genomes than were told; None: in none.
    """

    settings_type: ClassVar[type[msgspec.Struct]]
    portable: ClassVar[bool]
    competes: ClassVar[bool] = False
    relative: bool = False
    measures: Sequence[str] = ()
    candidates: int | None = None
    strayed: int | None = None

    def __init__(self, settings: msgspec.Struct, representation: Representation, seed: int) -> None:
        self.settings = settings
        self.representation = representation
        self.seed = seed
        self.generation = 0
        self._asked: int | None = None

    def ask(self) -> list[bytes]:
        """The genomes that want evaluation next.

        Raises:
            RuntimeError: the last generation was not told yet.
        """
        if self._asked is not None:
            raise RuntimeError("tell the fitness of the last generation before asking for the next")
        genomes = self._ask()
        self._asked = len(genomes)
        return genomes

    def tell(self, fitness: np.ndarray, measures: np.ndarray | None = None) -> None:
        """Take the fitness of the generation last asked for, in the order asked.

        Args:
            fitness: (genomes asked,) float64, higher is better; NaN marks a failed evaluation.
            measures: (genomes asked, len(self.measures)) float64, the mean of each metric over a candidate's trials, NaN as
                fitness; only where there are any.

        Raises:
            RuntimeError: no generation is waiting.
            ValueError: wrong shape.
        """
        if self._asked is None:
            raise RuntimeError("no generation is waiting for its fitness: ask first")
        if fitness.shape != (self._asked,):
            raise ValueError(f"fitness must have shape ({self._asked},), not {fitness.shape}")
        measures = np.empty((self._asked, 0)) if measures is None else measures
        if measures.shape != (self._asked, len(self.measures)):
            raise ValueError(f"measures must have shape ({self._asked}, {len(self.measures)}), not {measures.shape}")
        self._tell(fitness, measures)
        self.generation += 1
        self._asked = None

    @abstractmethod
    def _ask(self) -> list[bytes]: ...

    @abstractmethod
    def _tell(self, fitness: np.ndarray, measures: np.ndarray) -> None: ...

    @abstractmethod
    def state(self) -> dict[str, Any]:
        """All that ``restore`` needs to go on after the last tell: plain values, bytes, lists, dicts."""

    @abstractmethod
    def restore(self, state: Mapping[str, Any], told: Iterable[Told]) -> None:
        """Go on from a ``state`` of an optimizer with the same settings and seed.

        Args:
            told: all that it was told until then, in order, for those whose state is no plain value; read when it is iterated.
        """

    @abstractmethod
    def best(self) -> tuple[bytes, float]:
        """The best genome told so far and its fitness; (b"", -inf) before the first. An ask does not change it.

        Where fitness is relative, of the last generation told.
        """

    @abstractmethod
    def statistics(self) -> dict[str, float]:
        """Numbers about the last generation told; ``best`` and ``mean`` at least. An ask does not change them.

        The run calls it when servers have the next generation already.
        """
