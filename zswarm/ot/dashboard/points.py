"""What the charts of a run show: so many points at most, chosen by the database, however long the run is."""

import json
from typing import Any

import numpy as np

from zswarm.ot.dashboard.fleet import Batch, busy
from zswarm.ot.reading import Run
from zswarm.protocol.codec import clean

MOST = 2000  # points of a curve
SOME = 300  # points of what takes all candidates of a generation, or the optimizer's numbers
BATCHES = 20_000  # the last ones, of which a timeline is made
BINS = 240
QUARTILES = (0.0, 0.25, 0.5, 0.75)  # of fitness; the best is the last


def curve(run: Run, most: int = MOST) -> dict[str, list[Any]]:
    """Best and mean fitness per generation; of several in one point the best, the mean, and the least and greatest mean.

    Returns:
        Columns: generation (the last one of the point), at, best, mean, low, high, evaluations (so far).
    """
    step = _step(run, most)
    rows = run.rows(
        "SELECT max(generation), max(finished_at), max(best), avg(mean), min(mean), max(mean), sum(evaluations) "
        "FROM generations GROUP BY generation / ? ORDER BY 1",
        tuple[int, float, float | None, float | None, float | None, float | None, int],
        step,
    )
    columns: dict[str, list[Any]] = {
        name: [row[place] for row in rows] for place, name in enumerate(("generation", "at", "best", "mean", "low", "high"))
    }
    columns["evaluations"] = np.cumsum([row[6] for row in rows], dtype=np.int64).tolist()
    return columns


def spread(run: Run, most: int = SOME) -> dict[str, list[Any]]:
    """Worst, quartiles and best of the candidates' fitness in some generations; of a generation of which none has any, None.

    Returns:
        Columns: generation, at, worst, lower, median, upper, top.
    """
    chosen = _chosen(run, most)
    rows = run.rows(
        "SELECT g.generation, g.finished_at, c.fitness FROM generations g JOIN candidates c ON c.generation = g.generation "
        "WHERE g.generation IN (SELECT value FROM json_each(?)) AND c.fitness IS NOT NULL",
        tuple[int, float, float],
        json.dumps(chosen),
    )
    by_generation: dict[tuple[int, float], list[float]] = {}
    for generation, at, fitness in rows:
        by_generation.setdefault((generation, at), []).append(fitness)
    names = ("generation", "at", "worst", "lower", "median", "upper", "top")
    found: dict[str, list[Any]] = {name: [] for name in names}
    for generation, at in sorted(by_generation):
        values = np.quantile(by_generation[generation, at], (*QUARTILES, 1.0)).tolist()
        for name, value in zip(names, (generation, at, *values), strict=True):
            found[name].append(value)
    return found


def statistics(run: Run, most: int = SOME) -> dict[str, Any]:
    """The optimizer's numbers in some generations.

    Returns:
        generation and at, and under ``values`` a column per number; None where there is none.
    """
    chosen = _chosen(run, most)
    rows = run.rows(
        "SELECT generation, finished_at, statistics FROM generations WHERE generation IN (SELECT value FROM json_each(?)) "
        "ORDER BY generation",
        tuple[int, float, str],
        json.dumps(chosen),
    )
    read = [_numbers(text) for _, _, text in rows]
    names = dict.fromkeys(name for numbers in read for name in numbers)
    return {
        "generation": [row[0] for row in rows],
        "at": [row[1] for row in rows],
        "values": {clean(name): [numbers.get(name) for numbers in read] for name in names},
    }


def timeline(run: Run, slots: dict[str, int], bins: int = BINS, last_s: float | None = None) -> dict[str, Any]:
    """How many slots of each server computed, over the time of the last batches.

    Args:
        slots: of each server.
        bins: equal parts of the time.
        last_s: of the last seconds only.
    """
    rows = run.rows(
        "SELECT id, generation, count, server, seconds, at, faulted FROM outcomes ORDER BY id DESC LIMIT ?",
        tuple[int, int, int, str, float, float, int],
        BATCHES,
    )
    batches = [Batch(*row[:3], clean(row[3]), *row[4:]) for row in rows]
    if not batches:
        return {"begin": None, "end": None, "bins": bins, "busy": {}, "events": []}
    end = max(batch.at for batch in batches)
    begin = min(batch.at - batch.seconds / max(1, slots.get(batch.server, 1)) for batch in batches)
    if last_s is not None:
        begin = max(begin, end - last_s)
    begin = min(begin, end - 1e-3)
    events = run.rows(
        "SELECT at, event, server FROM events WHERE at >= ? AND event IN ('server_left', 'server_lost', 'server_joined', "
        "'server_back', 'fault', 'began') ORDER BY rowid DESC LIMIT 500",
        tuple[float, str, str | None],
        begin,
    )
    return {
        "begin": begin,
        "end": end,
        "bins": bins,
        "busy": busy(batches, slots, begin, end, bins),
        "events": [{"at": at, "event": clean(event), "server": clean(server or "")} for at, event, server in reversed(events)],
    }


def generation(run: Run, number: int) -> list[dict[str, Any]]:
    """The candidates of a finished generation, the best first; NaN is last."""
    rows = run.rows(
        "SELECT candidate, fitness FROM candidates WHERE generation = ? ORDER BY fitness IS NULL, fitness DESC, candidate",
        tuple[int, float | None],
        number,
    )
    return [{"candidate": candidate, "fitness": fitness} for candidate, fitness in rows]


def champions(run: Run, most: int = SOME) -> list[dict[str, Any]]:
    """The last generations in which the best rose, and who has it; where scores are relative, the last ones."""
    last: float | None = None
    found: list[int] = []
    for number, best in run.rows("SELECT generation, best FROM generations ORDER BY generation", tuple[int, float | None]):
        if best is not None and (run.relative or last is None or best > last):
            found.append(number)
        last = best if best is not None else last
    rows = run.rows(
        "SELECT generation, candidate, fitness FROM candidates WHERE generation IN (SELECT value FROM json_each(?)) "
        "AND fitness IS NOT NULL ORDER BY generation, fitness DESC, candidate",
        tuple[int, int, float],
        json.dumps(found[-most:]),
    )
    champions: dict[int, dict[str, Any]] = {}
    for number, candidate, fitness in rows:
        champions.setdefault(number, {"generation": number, "candidate": candidate, "fitness": fitness})
    return list(champions.values())


def _step(run: Run, most: int) -> int:
    return max(1, -(-run.generations() // most))


def _chosen(run: Run, most: int) -> list[int]:
    """Some generations, evenly, the last one among them."""
    count = run.generations()
    step = max(1, -(-count // most))
    return list(range(count - 1, -1, -step))[::-1]


def _numbers(text: str) -> dict[str, float]:
    """The numbers among the optimizer's statistics; what is damaged has none."""
    try:
        values = json.loads(text)
    except (ValueError, RecursionError):
        return {}
    if not isinstance(values, dict):
        return {}
    return {str(key): value for key, value in values.items() if isinstance(value, (int, float)) and not isinstance(value, bool)}
