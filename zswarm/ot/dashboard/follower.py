"""One run, followed in its record: each look reads only what was added since the one before, so it costs the same in a long run."""

import time
from pathlib import Path
from typing import Any

from zswarm.errors import ConfigError
from zswarm.ot import control
from zswarm.ot.dashboard.fleet import RATE_S, Batch, Event, Fleet
from zswarm.ot.dashboard.shelf import status
from zswarm.ot.reading import Run
from zswarm.protocol.codec import clean

EVENTS = 300  # the last ones, that a page begins with
LIVE = 2000  # the last batches, that are looked at one by one; of those before, sums
BEFORE = 20_000  # batches of before that a look sums up
AT_MOST = 2000  # rows of a kind that a look reads
PACE = 20  # generations whose mean time says how long the rest will take
COLUMNS = "id, generation, count, server, seconds, at, faulted"


class Follower:
    """Follows one run from its last generations on.

    Args:
        folder: of the run.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.events: list[dict[str, Any]] = []  # the last ones
        self.state: dict[str, Any] = {"status": "reading"}
        self._fleet = Fleet()
        self._shown: dict[str, dict[str, Any]] = {}  # rows of servers as they were told
        self._generation, self._event, self._outcome, self._before = -1, 0, 0, 0
        self._finished: list[tuple[int, float]] = []  # the last generations, and when
        self._counted: dict[int, int] = {}  # trials of the generation that runs
        self._recent: list[tuple[float, int]] = []
        self._last: tuple[float | None, float | None] = (None, None)
        self._evaluations = self._candidates = 0
        self._requeued = 0
        self._begun = False

    def servers(self) -> list[dict[str, Any]]:
        """All rows, as they were told."""
        return list(self._shown.values())

    def look(self) -> dict[str, Any]:
        """What is new: state, generations, events, servers; nothing of what has not changed."""
        now = time.time()
        try:
            run = Run(self.folder)
            if run.meta.get("schema_version") and not self._begun:
                self._begin(run)
            new = self._read(run)
            state = self._state(run, now)
        except ConfigError as error:
            new, state = {}, {"status": "unreadable", "error": str(error)}
        if state != self.state:
            self.state = new["state"] = state
        if self._begun:
            going_on = state["status"] in ("running", "paused", "stopping")
            rows = self._fleet.rows(now if going_on else self._newest(), going_on=going_on)
            if changed := [row for row in rows if self._shown.get(row["server"]) != row]:
                new["servers"] = changed
                self._shown |= {row["server"]: row for row in changed}
        return new

    def _begin(self, run: Run) -> None:
        """Where to follow from."""
        ((last, evaluations),) = run.rows(
            "SELECT coalesce(max(generation), -1), coalesce(sum(evaluations), 0) FROM generations", tuple[int, int]
        )
        ((newest,),) = run.rows("SELECT coalesce(max(id), 0) FROM outcomes", tuple[int])
        ((event,),) = run.rows("SELECT coalesce(max(rowid), 0) FROM events", tuple[int])
        self._generation, self._evaluations = max(-1, last - PACE), 0
        self._outcome = self._before = max(0, newest - LIVE)
        # Of events before, those that say how servers stand; there are few of them.
        self._fleet.happened(self._events(run, 0, max(0, event - EVENTS), AT_MOST))
        self._event = max(0, event - EVENTS)
        ((self._requeued,),) = run.rows(
            f"SELECT coalesce(sum(count), 0) FROM events WHERE event = 'requeued' AND rowid <= {self._event}",  # noqa: S608  a number of ours
            tuple[int],
        )
        ((before,),) = run.rows(
            "SELECT coalesce(sum(evaluations), 0) FROM generations WHERE generation <= ?", tuple[int], self._generation
        )
        self._evaluations, self._begun = before, True

    def _read(self, run: Run) -> dict[str, Any]:
        new: dict[str, Any] = {}
        if generations := self._generations(run):
            new["generations"] = generations
        events = self._events(run, self._event, None, AT_MOST)
        if events:
            self._event = events[-1].rowid
            self._fleet.happened(events)
            self._requeued += sum(event.count for event in events if event.event == "requeued")
            new["events"] = [shown(event) for event in events]
            self.events = [*self.events, *new["events"]][-EVENTS:]
        batches = [
            Batch(*row[:3], clean(row[3]), *row[4:])
            for row in run.rows(
                f"SELECT {COLUMNS} FROM outcomes WHERE id > ? ORDER BY id LIMIT {AT_MOST}",  # noqa: S608  our own words
                tuple[int, int, int, str, float, float, int],
                self._outcome,
            )
        ]
        if batches:
            self._outcome = batches[-1].id
            self._fleet.computed(batches)
            for batch in batches:
                if batch.generation > self._generation:
                    self._counted[batch.generation] = self._counted.get(batch.generation, 0) + batch.count
                self._recent.append((batch.at, batch.count))
        self._counted = {key: value for key, value in self._counted.items() if key > self._generation}
        if self._before:
            self._sum_up(run)
        return new

    def _generations(self, run: Run) -> list[list[Any]]:
        found = run.rows(
            "SELECT generation, finished_at, best, mean, evaluations FROM generations WHERE generation > ? "
            f"ORDER BY generation LIMIT {AT_MOST}",
            tuple[int, float, float | None, float | None, int],
            self._generation,
        )
        rows = []
        for generation, at, best, mean, evaluations in found:
            self._evaluations += evaluations
            self._generation, self._last, self._candidates = generation, (best, mean), evaluations
            self._finished = [*self._finished, (generation, at)][-PACE - 1 :]
            rows.append([generation, at, best, mean, self._evaluations])
        return rows

    def _events(self, run: Run, after: int, until: int | None, limit: int) -> list[Event]:
        """The first ones after a row, up to another; of so many the last."""
        order, and_until = ("", "") if until is None else ("DESC", f"AND rowid <= {until}")
        found = run.rows(
            "SELECT rowid, at, generation, event, coalesce(server, ''), coalesce(text, ''), coalesce(count, 0) "
            f"FROM events WHERE rowid > ? {and_until} ORDER BY rowid {order} LIMIT {limit}",
            tuple[int, float, int | None, str, str, str, int],
            after,
        )
        events = [Event(*row[:3], clean(row[3]), clean(row[4]), clean(row[5]), row[6]) for row in found]
        return events if until is None else events[::-1]

    def _sum_up(self, run: Run) -> None:
        """Some of the batches of before, the newest first: a long run has many, and nobody waits for them."""
        begin = max(0, self._before - BEFORE)
        for server, trials, seconds, last_at in run.rows(
            "SELECT server, sum(count), sum(seconds), max(at) FROM outcomes WHERE id > ? AND id <= ? GROUP BY server",
            tuple[str, int, float, float],
            begin,
            self._before,
        ):
            if server:
                self._fleet.server(clean(server)).computed_before(trials, seconds, last_at)
        self._before = begin

    def _state(self, run: Run, now: float) -> dict[str, Any]:
        of = status(self.folder, finished=run.finished)
        complete = run.experiment
        going_on = of in ("running", "paused", "stopping")
        self._recent = [(at, count) for at, count in self._recent if at >= now - RATE_S]
        rate = sum(count for _, count in self._recent) / RATE_S if going_on else 0.0
        each = complete.problem.trials if complete.ranking.kind == "absolute" else 0
        current = self._generation + 1
        pace = self._pace()
        return {
            "status": of,
            "asked": control.asked(self.folder) if going_on else "",
            "generation": current,  # finished ones
            "generations": complete.generations,
            "counted": self._counted.get(current, 0) if going_on else 0,
            "trials": self._candidates * each if going_on else 0,
            "evaluations": self._evaluations,
            "rate": round(rate / each, 2) if each else None,
            "trial_rate": round(rate, 1),
            "eta_s": round((complete.generations - current) * pace, 1) if pace and of == "running" else None,
            "best": self._last[0],
            "mean": self._last[1],
            "at": self._newest() or None,
            "servers": self._fleet.serving if going_on else 0,
            "slots": self._fleet.slots if going_on else 0,
            "requeued": self._requeued,
        }

    def _pace(self) -> float:
        """Seconds of a generation, lately; the median, for a pause is none of them. 0: not known."""
        times = [at for _, at in self._finished]
        between = sorted(b - a for a, b in zip(times, times[1:], strict=False))
        return between[len(between) // 2] if between else 0.0

    def _newest(self) -> float:
        """When the record was last added to."""
        finished = self._finished[-1][1] if self._finished else 0.0
        return max([finished, *(server.last_at for server in self._fleet.servers.values())])


def shown(event: Event) -> dict[str, Any]:
    """An event for the page."""
    return {
        "id": event.rowid,
        "at": event.at,
        "generation": event.generation,
        "event": event.event,
        "server": event.server,
        "text": event.text,
        "count": event.count,
        "level": event.level,
    }
