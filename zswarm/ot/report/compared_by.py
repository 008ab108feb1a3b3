"""Compare the groups of a report by the most honest number that all of their runs have."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from zswarm.errors import ConfigError
from zswarm.ot.analysis import compared, measure
from zswarm.ot.analysis.comparison import Comparison
from zswarm.ot.analysis.measure import FITNESS
from zswarm.ot.record.reader import Run

PARTLY = (
    "what zswarm-ot evaluate found is not compared: it played only some of the champions, or "
    "earlier ones"
)


class Measured(NamedTuple):
    """Groups, compared."""

    found: Comparison
    evaluated: list[measure.Evaluated]  # of each run, if they are compared by fitness

    @property
    def trials(self) -> str:
        """Return how many trials each champion played in ``evaluate``, or ""."""
        counts = {len(one.fitness) for one in self.evaluated}
        ends = sorted({min(counts), max(counts)}) if counts else []
        return " to ".join(f"{count:,}" for count in ends)


def compare(groups: Mapping[str, Sequence[Run]]) -> Measured:
    """Compare groups: by what ``evaluate`` found of all runs, else as ``compare`` does.

    Raises:
        ConfigError: no run finished a generation, or runs cannot be compared.
    """
    runs = [run for members in groups.values() for run in members]
    if all(run.finished for run in runs) and _all_evaluated(groups):
        found = compared.compare(groups, None, FITNESS)
        return Measured(found, [measure.load(run) for run in runs])
    found = compared.compare(groups)
    if any((run.folder / measure.FILE).exists() for run in runs):
        found = found._replace(notes=[PARTLY, *found.notes])
    return Measured(found, [])


def _all_evaluated(groups: Mapping[str, Sequence[Run]]) -> bool:
    try:
        measure.values(groups, FITNESS)
    except ConfigError:
        return False
    return True
