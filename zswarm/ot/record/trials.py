"""The trials of a generation, from the arrays of its batches."""

from collections.abc import Callable, Iterable, Sequence
from operator import itemgetter
from typing import Any

import numpy as np

from zswarm.system.text import clean


def trials_of(
    batches: Iterable[Sequence[Any]], each: int, names: Callable[[int], list[str]]
) -> list[dict[str, Any]]:
    """Return the trials of batches in order, as ``Run.trials`` does.

    Args:
        batches: count, trials, fitness, metrics, server and participants of each.
        each: trials of a candidate or game.
        names: returns the names of so many metrics.

    Raises:
        ValueError: arrays have other lengths than they should.
    """
    found = []
    for count, trials, fitness, metrics, server, participants in batches:
        indices = np.frombuffer(trials, "<u4").reshape(count).tolist()
        scores, measured = numbers(fitness, count, -1), numbers(metrics, count, -1)
        players = None
        if participants is not None:
            shape = (count, len(scores[0]))
            players = np.frombuffer(participants, "<u4").reshape(shape).tolist()
        named = names(len(measured[0]))
        for row, index in enumerate(indices):
            judged, number = divmod(index, each)
            trial = {
                "trial": number,
                "fitness": scores[row],
                "metrics": dict(zip(named, measured[row], strict=True)),
                "server": clean(server),
            }
            if players is None:
                trial = {"candidate": judged, **trial}
            else:
                trial = {"game": judged, "candidates": players[row], **trial}
            found.append((index, trial))
    return [trial for _, trial in sorted(found, key=itemgetter(0))]


def numbers(raw: bytes, *shape: int) -> list[Any]:
    """Return float64 numbers as nested lists of a shape; NaN is None.

    Raises:
        ValueError: they are of another size.
    """
    array = np.frombuffer(raw, "<f8").reshape(shape).astype(object)
    array[array != array] = None
    found: list[Any] = array.tolist()
    return found
