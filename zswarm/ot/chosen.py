"""Which recorded candidate is meant, by the numbers of its generation and its own."""

import math
from typing import Any

from zswarm.errors import ConfigError
from zswarm.ot.reading import Run
from zswarm.protocol.codec import clean


def generation_of(run: Run, generation: int | None) -> int:
    """A finished one, from 0; None: where the best was found.

    Raises:
        ConfigError: the run has no such generation.
    """
    count = run.generations()
    if not count:
        raise ConfigError(f"{shown(run)}: no generation is finished")
    if generation is None:
        best = run.best()
        found = [int(row["generation"]) for row in run.history() if row["best"] == best]
        return count - 1 if run.relative or not found else found[0]
    if not 0 <= generation < count:
        raise ConfigError(f"{shown(run)}: no generation {generation}; {numbered('generation', count)}")
    return generation


def candidate_of(run: Run, generation: int, candidates: dict[int, dict[str, Any]], candidate: int | None) -> int:
    """One of a generation's, in the order asked, from 0; None: the best.

    Args:
        candidates: rows of ``Run.candidates`` by their number.

    Raises:
        ConfigError: the generation has no such candidate.
    """
    if candidate is None and candidates:
        return max(candidates, key=lambda one: (-math.inf if (f := candidates[one]["fitness"]) is None else f, -one))
    if candidate not in candidates:
        what = f"no candidate {candidate} in generation {generation}"
        raise ConfigError(f"{shown(run)}: {what}; {numbered('candidate', len(candidates))}")
    return candidate


def numbered(what: str, count: int) -> str:
    """Which there are of something that is numbered from 0."""
    return f"it has {what} 0 only" if count == 1 else f"it has {what}s 0 to {count - 1}" if count else f"it has no {what}s"


def shown(run: Run) -> str:
    """Its folder, for a line about what is wrong with it."""
    return clean(str(run.folder))
