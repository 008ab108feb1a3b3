"""The best distinct candidates of a run so far, which its assessment may race."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

from zswarm.ot.record.packing import Place


class Contender(NamedTuple):
    """A candidate: its digest, the best fitness that the optimizer was told, and where first."""

    digest: bytes
    fitness: float
    place: Place

    @property
    def rank(self) -> tuple[float, Place]:
        """Return a key that sorts the best first, and earlier candidates before equal ones."""
        return -self.fitness, self.place


class Contenders:
    """At most so many distinct candidates, the best of all that were added."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._found: dict[bytes, Contender] = {}

    def add(self, contenders: Iterable[Contender]) -> None:
        """Add candidates; one whose fitness is NaN is none."""
        for one in contenders:
            known = self._found.get(one.digest, one)
            if one.fitness == one.fitness and one.rank <= known.rank:
                self._found[one.digest] = one
        for worst in self.ranked()[self._most :]:
            del self._found[worst.digest]

    def ranked(self) -> list[Contender]:
        """Return them, the best first."""
        return sorted(self._found.values(), key=lambda one: one.rank)

    def places(self) -> set[Place]:
        """Return where their genomes are recorded."""
        return {one.place for one in self._found.values()}


def of_generation(
    generation: int, digests: Sequence[bytes], fitness: Sequence[float]
) -> list[Contender]:
    """Return the candidates of a generation."""
    rows = zip(digests, fitness, range(len(digests)), strict=True)
    return [Contender(one, value, (generation, at)) for one, value, at in rows]
