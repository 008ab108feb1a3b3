"""Points of a run's charts: a limited number, chosen in the database, however long the run is.

Fitness is the mean of a candidate's trials, as everywhere in the dashboard.
"""

import json
from typing import Any

import numpy as np

from zswarm.ot.dashboard.rows import BatchRow, read_batches
from zswarm.ot.notes import RunEvent, severity
from zswarm.ot.record.reader import Run
from zswarm.system.format import mean
from zswarm.system.text import clean

MOST = 2000  # points of a curve
SOME = 300  # points of what reads all candidates of a generation, or the optimizer's statistics
BATCHES = 20_000  # the last ones, of which a timeline is made
BINS = 240  # of a timeline
QUARTILES = {"worst": 0.0, "lower": 0.25, "median": 0.5, "upper": 0.75, "top": 1.0}
# Events that a timeline shows, and their signs; a line for the one without.
SIGNS: dict[str, str] = {
    RunEvent.SERVER_LEFT: "◁",
    RunEvent.SERVER_LOST: "✕",
    RunEvent.SERVER_JOINED: "▷",
    RunEvent.SERVER_BACK: "▷",
    RunEvent.FAULT: "▲",
    RunEvent.BEGAN: "",
}


def curve(run: Run, most: int = MOST) -> dict[str, list[Any]]:
    """Return best and mean fitness; a point of several generations has the range of their means.

    Returns:
        Columns: generation (the last one of the point), at, best, mean, low, high, evaluations.
    """
    step = max(1, -(-run.generations() // most))
    rows = run.rows(
        "SELECT max(generation), max(finished_at), max(best), avg(mean), min(mean), max(mean), "
        "sum(sum(evaluations)) OVER (ORDER BY max(generation)) "
        "FROM generations GROUP BY generation / ? ORDER BY 1",
        tuple[int, float, float | None, float | None, float | None, float | None, int],
        step,
    )
    trials = run.fitness_trials
    means = [
        (*row[:2], *(mean(value, trials) for value in row[2:6]), row[6]) for row in rows
    ]
    return _columns("generation at best mean low high evaluations", means)


def track(run: Run) -> dict[str, list[Any]]:
    """Return what the best of tracked generations did on held-out seeds, and in search.

    Returns:
        Columns: generation, at, mean, low, high, in_search.
    """
    at = dict(
        run.rows("SELECT generation, finished_at FROM generations", tuple[int, float])
    )
    rows = [
        (
            one.generation,
            at.get(one.generation),
            found.mean,
            found.low,
            found.high,
            found.in_search,
        )
        for one in run.track
        for found in [one.held_out.per_trial(run.fitness_trials)]
    ]
    return _columns("generation at mean low high in_search", rows)


def spread(run: Run, most: int = SOME) -> dict[str, list[Any]]:
    """Return quartiles of the candidates' fitness; generations that failed are left out.

    Returns:
        Columns: generation, at, worst, lower, median, upper, top.
    """
    fitness: dict[tuple[int, float], list[float]] = {}
    for generation, at, value in run.rows(
        "SELECT g.generation, g.finished_at, c.fitness FROM generations g "
        "JOIN candidates c ON c.generation = g.generation "
        "WHERE g.generation IN (SELECT value FROM json_each(?)) AND c.fitness IS NOT NULL "
        "ORDER BY g.generation",
        tuple[int, float, float],
        _chosen(run, most),
    ):
        fitness.setdefault((generation, at), []).append(value / run.fitness_trials)
    shares = list(QUARTILES.values())
    rows = [
        (*key, *np.quantile(values, shares).tolist()) for key, values in fitness.items()
    ]
    return _columns(f"generation at {' '.join(QUARTILES)}", rows)


def statistics(run: Run, most: int = SOME) -> dict[str, Any]:
    """Return generation, at, and under ``values`` a column for each of the optimizer's numbers."""
    rows = run.rows(
        "SELECT generation, finished_at, statistics FROM generations "
        "WHERE generation IN (SELECT value FROM json_each(?)) ORDER BY generation",
        tuple[int, float, str],
        _chosen(run, most),
    )
    read = [_numbers(text) for _, _, text in rows]
    names = dict.fromkeys(name for numbers in read for name in numbers)
    return {
        **_columns("generation at", [row[:2] for row in rows]),
        "values": {
            clean(name): [numbers.get(name) for numbers in read] for name in names
        },
    }


def timeline(run: Run, last_s: int = 0) -> dict[str, Any]:
    """Return how many slots of each server computed, over the time of the last batches.

    Args:
        last_s: limits the time; 0: no limit.
    """
    joined = run.rows(
        "SELECT server, max(count) FROM events WHERE event IN (?, ?) AND server <> '' "
        "GROUP BY server",
        tuple[str, int],
        RunEvent.SERVER_JOINED,
        RunEvent.SERVER_SLOTS,
    )
    slots = {clean(server): max(1, count) for server, count in joined}
    batches = read_batches(run, "WHERE server <> '' ORDER BY id DESC LIMIT ?", BATCHES)
    if not batches:
        return {"begin": None, "end": None, "busy": {}, "events": [], "slots": slots}
    end = max(batch.at for batch in batches)
    begin = min(
        batch.at - batch.seconds / slots.get(batch.server, 1) for batch in batches
    )
    begin = min(max(begin, end - last_s) if last_s else begin, end - 1e-3)
    events = run.rows(
        "SELECT at, event, coalesce(server, '') FROM events WHERE at >= ? "
        "AND event IN (SELECT value FROM json_each(?)) ORDER BY rowid DESC LIMIT 500",
        tuple[float, str, str],
        begin,
        json.dumps(list(SIGNS)),
    )
    return {
        "begin": begin,
        "end": end,
        "busy": busy(batches, slots, np.linspace(begin, end, BINS + 1)),
        "events": [
            {
                "at": at,
                "sign": SIGNS[event],
                "level": severity(event),
                "server": clean(server),
            }
            for at, event, server in reversed(events)
        ],
        "slots": slots,
    }


def busy(
    batches: list[BatchRow], slots: dict[str, int], times: np.ndarray
) -> dict[str, list[float]]:
    """Return how many slots of each server were computing, between each two of the times.

    The seconds of a batch are those of all its slots; they are placed before the time at which it
    was counted, in parallel on the server's slots.

    Args:
        slots: of each server, by default 1.
        times: (bins + 1,) float64 seconds since 1970.
    """
    found: dict[str, list[tuple[float, float]]] = {}
    for batch in batches:
        duration = batch.seconds / slots.get(batch.server, 1)
        found.setdefault(batch.server, []).append((batch.at, duration))

    def computing(server: str) -> list[float]:
        ended, duration = np.array(found[server]).T[..., None]
        worked = np.clip(times - (ended - duration), 0.0, duration).sum(axis=0)
        shares = np.diff(worked) / np.diff(times)
        return [round(share * slots.get(server, 1), 3) for share in shares.tolist()]

    return {server: computing(server) for server in found}


def generation(run: Run, number: int) -> list[dict[str, Any]]:
    """Return the candidates of a finished generation, the best first, NaN last."""
    rows = run.rows(
        "SELECT candidate, fitness FROM candidates WHERE generation = ? "
        "ORDER BY fitness IS NULL, fitness DESC, candidate",
        tuple[int, float | None],
        number,
    )
    return [
        {"candidate": candidate, "fitness": mean(fitness, run.fitness_trials)}
        for candidate, fitness in rows
    ]


def champions(run: Run, most: int = SOME) -> list[dict[str, Any]]:
    """Return the best candidates of the last generations that improved; of scores, of the last."""
    last: float | None = None
    found: list[int] = []
    for number, best in run.rows(
        "SELECT generation, best FROM generations WHERE best IS NOT NULL ORDER BY generation",
        tuple[int, float],
    ):
        if run.relative or last is None or best > last:
            found.append(number)
        last = best
    rows = run.rows(
        "SELECT generation, candidate, fitness FROM (SELECT *, row_number() OVER "
        "(PARTITION BY generation ORDER BY fitness DESC, candidate) AS place FROM candidates "
        "WHERE generation IN (SELECT value FROM json_each(?)) AND fitness IS NOT NULL) "
        "WHERE place = 1 ORDER BY generation",
        tuple[int, int, float],
        json.dumps(found[-most:]),
    )
    return [
        {
            "generation": of,
            "candidate": candidate,
            "fitness": mean(fitness, run.fitness_trials),
        }
        for of, candidate, fitness in rows
    ]


def _columns(names: str, rows: list[Any]) -> dict[str, list[Any]]:
    return {
        name: [row[place] for row in rows] for place, name in enumerate(names.split())
    }


def _chosen(run: Run, most: int) -> str:
    """Return a JSON list of generations at equal distances, the last one among them."""
    count = run.generations()
    step = max(1, -(-count // most))
    return json.dumps(list(range(count - 1, -1, -step)))


def _numbers(text: str) -> dict[str, float]:
    """Return the numbers among the optimizer's statistics; none if they are damaged."""
    try:
        values = json.loads(text)
    except (ValueError, RecursionError):
        return {}
    if not isinstance(values, dict):
        return {}
    numbers = {
        str(key): value for key, value in values.items() if not isinstance(value, bool)
    }
    return {
        key: value for key, value in numbers.items() if isinstance(value, int | float)
    }
