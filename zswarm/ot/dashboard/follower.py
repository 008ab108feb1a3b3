"""One run, followed in its record: each look reads what was added since the one before, so a long run costs no more."""

import itertools
import time
from pathlib import Path
from typing import Any

from zswarm.errors import ConfigError
from zswarm.experiment import Experiment
from zswarm.ot import control
from zswarm.ot.dashboard.fleet import RATE_S, Batch, Event, Fleet
from zswarm.ot.dashboard.shelf import stamp, status
from zswarm.ot.reading import Run
from zswarm.protocol.codec import clean

EVENTS = 300  # the last ones, that a page begins with
LIVE = 2000  # the last batches, that are looked at one by one; of those before, sums
BEFORE = 20_000  # batches of before that a look sums up
AT_MOST = 2000  # rows of a kind that a look reads
PACE = 20  # generations whose mean time says how long the rest will take
EVENT = "SELECT rowid, at, generation, event, coalesce(server, ''), coalesce(text, ''), coalesce(count, 0) FROM events "
AFTER_ROW = EVENT + "WHERE rowid > ? ORDER BY rowid LIMIT ?"
BEFORE_ROW = EVENT + "WHERE rowid <= ? ORDER BY rowid DESC LIMIT ?"
SERVERS_S = 1.0  # between two looks at all servers, where nothing happened to one
GOING_ON = ("running", "paused", "stopping")


class Follower:
    """Follows one run from its last generations on.

    Args:
        folder: of the run.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.events: list[dict[str, Any]] = []  # the last ones
        self.state: dict[str, Any] = {"status": "reading"}
        self._read_up_to: tuple[Any, ...] | None = None  # what the record was like when all of it had been read
        self._run: Run | None = None  # as it was read last
        self._complete: Experiment | None = None  # its experiment
        self._generation, self._event, self._outcome, self._before = -1, 0, 0, 0
        self._finished: list[tuple[int, float]] = []  # the last generations, and when
        self._last: tuple[float | None, float | None] = (None, None)  # best and mean
        self._evaluations = self._candidates = self._requeued = 0
        self._counted: dict[int, int] = {}  # trials of the generation that runs
        self._recent: list[tuple[float, int]] = []  # when how many trials came, of the last seconds
        self._fleet = Fleet()
        self._servers_at = 0.0
        self._shown: dict[str, dict[str, Any]] = {}  # rows of servers as they were told

    def servers(self) -> list[dict[str, Any]]:
        """All rows, as they were told."""
        return list(self._shown.values())

    def look(self) -> dict[str, Any]:
        """What is new: state, generations, events, servers; nothing of what has not changed."""
        now, new = time.time(), {}
        try:
            new = self._read()
            state = self._state(now)
        except ConfigError as error:
            self._read_up_to, state = None, {"status": "unreadable", "error": str(error)}
        if state != self.state:
            self.state = new["state"] = state
        if "events" in new or ("state" in new and now >= self._servers_at + SERVERS_S):
            self._servers_at = now
            going_on = state["status"] in GOING_ON
            rows = self._fleet.rows(now if going_on else self._newest(), going_on=going_on)
            if changed := [row for row in rows if self._shown.get(row["server"]) != row]:
                new["servers"] = changed
                self._shown |= {row["server"]: row for row in changed}
        return new

    def _begin(self, run: Run) -> None:
        """Where to follow from: some generations, events and batches before the last ones, and sums of what was before."""
        ((last,),) = run.rows("SELECT coalesce(max(generation), -1) FROM generations", tuple[int])
        ((newest,),) = run.rows("SELECT coalesce(max(id), 0) FROM outcomes", tuple[int])
        ((event,),) = run.rows("SELECT coalesce(max(rowid), 0) FROM events", tuple[int])
        self._generation = max(-1, last - PACE)
        self._event = max(0, event - EVENTS)
        self._outcome = self._before = max(0, newest - LIVE)
        ((self._evaluations,),) = run.rows(
            "SELECT coalesce(sum(evaluations), 0) FROM generations WHERE generation <= ?", tuple[int], self._generation
        )
        ((self._requeued,),) = run.rows(
            "SELECT coalesce(sum(count), 0) FROM events WHERE event = 'requeued' AND rowid <= ?", tuple[int], self._event
        )
        self._fleet.happened(self._events(run, BEFORE_ROW, self._event)[::-1])

    def _read(self) -> dict[str, Any]:
        """What was added to the record; nothing is opened where nothing was."""
        now = stamp(self.folder)
        if now == self._read_up_to:
            return {}
        run = Run(self.folder)
        self._complete = run.experiment
        if self._run is None:
            self._begin(run)
        self._run = run
        new: dict[str, Any] = {}
        if generations := self._generations(run):
            new["generations"] = generations
        if events := self._events(run, AFTER_ROW, self._event):
            self._event = events[-1].rowid
            self._fleet.happened(events)
            self._requeued += sum(event.count for event in events if event.event == "requeued")
            new["events"] = [shown(event) for event in events]
            self.events = [*self.events, *new["events"]][-EVENTS:]
        batches = self._batches(run)
        if self._before:
            self._sum_up(run)
        if not self._before and max(len(generations), len(events), len(batches)) < AT_MOST:
            self._read_up_to = now
        return new

    def _batches(self, run: Run) -> list[Batch]:
        rows = run.rows(
            "SELECT id, generation, count, server, seconds, at, faulted FROM outcomes WHERE id > ? ORDER BY id LIMIT ?",
            tuple[int, int, int, str, float, float, int],
            self._outcome,
            AT_MOST,
        )
        batches = [Batch(*row[:3], clean(row[3]), *row[4:]) for row in rows]
        self._fleet.computed(batches)
        for batch in batches:
            self._outcome = batch.id
            self._recent.append((batch.at, batch.count))
            if batch.generation > self._generation:
                self._counted[batch.generation] = self._counted.get(batch.generation, 0) + batch.count
        self._counted = {key: value for key, value in self._counted.items() if key > self._generation}
        return batches

    def _generations(self, run: Run) -> list[list[Any]]:
        found = run.rows(
            "SELECT generation, finished_at, best, mean, evaluations FROM generations WHERE generation > ? "
            "ORDER BY generation LIMIT ?",
            tuple[int, float, float | None, float | None, int],
            self._generation,
            AT_MOST,
        )
        rows = []
        for generation, at, best, mean, evaluations in found:
            self._evaluations += evaluations
            self._generation, self._last, self._candidates = generation, (best, mean), evaluations
            self._finished = [*self._finished, (generation, at)][-PACE - 1 :]
            rows.append([generation, at, best, mean, self._evaluations])
        return rows

    def _events(self, run: Run, which: str, row: int) -> list[Event]:
        """Some of them, in the order of the statement."""
        found = run.rows(which, tuple[int, float, int | None, str, str, str, int], row, AT_MOST)
        return [Event(*row[:3], clean(row[3]), clean(row[4]), clean(row[5]), row[6]) for row in found]

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

    def _state(self, now: float) -> dict[str, Any]:
        run, complete = self._run, self._complete
        assert run is not None  # noqa: S101  it was read
        assert complete is not None  # noqa: S101  likewise
        of = status(self.folder, finished=run.finished)
        going_on = of in GOING_ON
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
        between = sorted(b - a for a, b in itertools.pairwise(times))
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
