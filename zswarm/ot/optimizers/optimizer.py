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
    """Proposes genomes and learns from their fitness; a child writes the abstract methods.

    Attributes:
        settings_type: the struct of its settings in an experiment file.
        portable: whether it gives the same bits on every machine (linear algebra does not).
        replays: whether ``restore`` tells all generations again, for which the record keeps all
            genomes; then the state is the number of generations, ``{"generation": n}``.
        competes: whether it accepts fitness that compares within a generation only, as of a
            tournament.
        relative: whether fitness is such; set before the first ask. Then an ask returns all genomes
            that compete, also those evaluated before, and ``best`` is of the last generation.
        fresh: whether trials have new seeds in each generation; set by ``use_fresh_seeds``. Then an
            ask also returns the genomes that survive, and tells give the mean over all seeds that a
            genome has seen in generations one after the other. ``best`` is of what is known.
        measures: names of the simulator's metrics that a tell takes in addition to fitness.
        generation: number of generations told.
        candidates: most genomes of one ask, or None if that is unknown.
        survivors: how many of the genomes last asked for may survive, or count by more than being
            worse than these, if it uses the order of fitness only; None: it needs all numbers. Then
            racing may stop trials of the others, whose fitness becomes an estimate.
        resamples: whether a genome that is asked for several times in one generation plays further
            seeds each time, instead of the same ones.
        diverged: the first generation in which ``restore`` would have asked other genomes than
            were told, or None.
    """

    settings_type: ClassVar[type[msgspec.Struct]]
    portable: ClassVar[bool]
    replays: ClassVar[bool] = False
    competes: ClassVar[bool] = False
    relative: bool = False
    fresh: bool = False
    measures: Sequence[str] = ()
    candidates: int | None = None
    survivors: int | None = None
    resamples: bool = False
    diverged: int | None = None

    def __init__(
        self, settings: msgspec.Struct, representation: Representation, seed: int
    ) -> None:
        self.settings = settings
        self.representation = representation
        self.seed = seed
        self.generation = 0
        self._asked: list[bytes] = []  # the last generation asked for
        self._waiting = False  # for its fitness

    def use_fresh_seeds(self) -> None:
        """Evaluate what survives again in each generation; called before the first ask, if ever."""
        self.fresh = True

    def ask(self) -> list[bytes]:
        """Return the genomes to evaluate next.

        Raises:
            RuntimeError: the last generation was not told yet.
        """
        if self._waiting:
            raise RuntimeError(
                "tell the fitness of the last generation before asking for the next"
            )
        self._asked, self._waiting = self._ask(), True
        return self._asked

    def tell(self, fitness: np.ndarray, measures: np.ndarray | None = None) -> None:
        """Take the fitness of the generation last asked for, in the order asked.

        Args:
            fitness: (genomes asked,) float64, higher is better; NaN marks a failed evaluation.
            measures: (genomes asked, len(self.measures)) float64, the mean of each metric over a
                candidate's trials; NaN where fitness is. Only where there are any.

        Raises:
            RuntimeError: no generation is waiting.
            ValueError: wrong shape.
        """
        if not self._waiting:
            raise RuntimeError("no generation is waiting for its fitness: ask first")
        asked = len(self._asked)
        measures = np.empty((asked, 0)) if measures is None else measures
        for name, given, shape in (
            ("fitness", fitness, (asked,)),
            ("measures", measures, (asked, len(self.measures))),
        ):
            if given.shape != shape:
                raise ValueError(f"{name} must have shape {shape}, not {given.shape}")
        self._tell(fitness, measures)
        self.generation += 1
        self._waiting = False

    @abstractmethod
    def _ask(self) -> list[bytes]: ...

    @abstractmethod
    def _tell(self, fitness: np.ndarray, measures: np.ndarray) -> None: ...

    @abstractmethod
    def state(self) -> dict[str, Any]:
        """Return the state after the last tell: plain values, bytes, lists, dicts."""

    @abstractmethod
    def restore(self, state: Mapping[str, Any], told: Iterable[Told]) -> None:
        """Resume from a ``state`` of an optimizer with the same settings and seed.

        Args:
            state: as returned by ``state``.
            told: all generations told until then, read when iterated, for optimizers whose state is
                not a plain value.
        """

    @abstractmethod
    def best(self) -> tuple[bytes, float]:
        """Return the best genome told so far and its fitness; (b"", -inf) before the first tell.

        If fitness is relative, the best of the last generation. An ask does not change it.
        """

    @abstractmethod
    def statistics(self) -> dict[str, float]:
        """Return numbers about the last generation told, at least ``best`` and ``mean``.

        An ask does not change them. A run calls it while servers evaluate the next generation.
        """
