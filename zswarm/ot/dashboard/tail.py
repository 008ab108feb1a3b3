"""Follow a run by its record: each look reads only what was added since the last one."""

import itertools
import statistics
import time
from collections import deque
from pathlib import Path
from typing import Any

import msgspec

from zswarm.errors import ConfigError
from zswarm.experiment import Experiment
from zswarm.ot.assessment import amount
from zswarm.ot.dashboard.rows import BatchRow, EventRow, read_batches, read_events
from zswarm.ot.dashboard.servers import ServerTable
from zswarm.ot.notes import RunEvent
from zswarm.ot.record import control_file, stopping
from zswarm.ot.record.reader import Run
from zswarm.ot.record.schema import ASSESSMENT
from zswarm.ot.record.summary import stamp, status
from zswarm.system.format import mean as per_trial
from zswarm.system.text import clean

EVENTS = 300  # the last ones, with which a page begins
LIVE = 2000  # the last batches, which are read one by one; of earlier ones, sums
EARLIER = 20_000  # batches that a look sums up
AT_MOST = 2000  # rows of a kind that a look reads
PACE = 20  # generations from whose time the remaining time is estimated
# Without an outcome, and for some generations, until a run is known to be quiet.
QUIET_S, QUIET_GENERATIONS = 60.0, 3
SERVERS_S = 1.0  # between updates of servers without an event
RUNNING = ("running", "paused", "stopping")
BEGIN = """
    SELECT (SELECT coalesce(max(rowid), 0) FROM events), coalesce(max(generation), -1),
        (SELECT coalesce(max(id), 0) FROM outcomes),
        (SELECT coalesce(max(at), 0.0) FROM events WHERE event = ?) FROM generations"""
BEFORE = """
    SELECT (SELECT coalesce(sum(count), 0) FROM events WHERE event = ? AND rowid <= ?),
        coalesce(sum(evaluations), 0) FROM generations WHERE generation <= ?"""


class RecordTail:
    """Follows one run, from its last generations on.

    Attributes:
        state: of the run, as last returned by ``look``; fitness is the mean of a trial.
        events: the last ones.
        servers: rows of all servers, by their ids, as last returned.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.state: dict[str, Any] = {"status": "reading"}
        self.events: list[dict[str, Any]] = []
        self.servers: dict[str, dict[str, Any]] = {}
        # Stamp of the record when all was read.
        self._read_up_to: tuple[Any, ...] | None = None
        self._began = False
        self._run: Run  # as it was read last
        self._began_at: float  # when the run began, or was resumed last
        # What was read last.
        self._generation, self._event, self._outcome, self._earlier = -1, 0, 0, 0
        self._finished: deque[float] = deque(maxlen=PACE + 1)  # when generations were
        self._best: float | None = None
        self._mean: float | None = None
        self._evaluations = self._candidates = self._requeued = 0
        self._counted: dict[int, int] = {}  # trials of unfinished generations
        self._table = ServerTable()
        self._servers_at = 0.0

    def look(self) -> dict[str, Any]:
        """Return what changed of state, generations, events and servers."""
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
            running = state["status"] in RUNNING
            rows = self._table.rows(now if running else self._newest(), running=running)
            if changed := [row for row in rows if self.servers.get(row["server"]) != row]:
                new["servers"] = changed
                self.servers |= {row["server"]: row for row in changed}
        return new

    def _read(self) -> dict[str, Any]:
        """Read what was added; without a change nothing is opened."""
        now = stamp(self.folder)
        if now == self._read_up_to:
            return {}
        run = self._run = Run(self.folder)
        if not self._began:
            self._begin(run)
            self._began = True
        generations, events = self._generations(run), self._events(run)
        batches = self._batches(run)
        if self._earlier:
            self._sum_up(run)
        elif max(len(generations), len(events), len(batches)) < AT_MOST:
            self._read_up_to = now
        shown = [event.as_mapping() for event in events]
        self.events = [*self.events, *shown][-EVENTS:]
        new = {"generations": generations, "events": shown}
        return {name: rows for name, rows in new.items() if rows}

    def _begin(self, run: Run) -> None:
        """Choose where to begin, and sum up what was before."""
        ((event, generation, outcome, self._began_at),) = run.rows(
            BEGIN, tuple[int, int, int, float], RunEvent.BEGAN
        )
        self._generation = max(-1, generation - PACE)
        self._event = max(0, event - EVENTS)
        self._outcome = self._earlier = max(0, outcome - LIVE)
        ((self._requeued, self._evaluations),) = run.rows(
            BEFORE, tuple[int, int], RunEvent.REQUEUED, self._event, self._generation
        )
        which = "WHERE rowid <= ? ORDER BY rowid DESC LIMIT ?"
        self._table.add_events(read_events(run, which, self._event, AT_MOST)[::-1])

    def _generations(self, run: Run) -> list[list[Any]]:
        rows = []
        for generation, at, best, mean, evaluations in run.rows(
            "SELECT generation, finished_at, best, mean, evaluations FROM generations "
            "WHERE generation > ? ORDER BY generation LIMIT ?",
            tuple[int, float, float | None, float | None, int],
            self._generation,
            AT_MOST,
        ):
            self._evaluations += evaluations
            self._generation, self._best, self._mean = generation, best, mean
            self._candidates = evaluations
            self._finished.append(at)
            means = [per_trial(value, run.fitness_trials) for value in (best, mean)]
            rows.append([generation, at, *means, self._evaluations])
        return rows

    def _events(self, run: Run) -> list[EventRow]:
        events = read_events(
            run, "WHERE rowid > ? ORDER BY rowid LIMIT ?", self._event, AT_MOST
        )
        self._table.add_events(events)
        for event in events:
            self._event = event.id
            if event.event == RunEvent.BEGAN:
                self._began_at = event.at
            self._requeued += event.count * (event.event == RunEvent.REQUEUED)
        return events

    def _batches(self, run: Run) -> list[BatchRow]:
        batches = read_batches(
            run, "WHERE id > ? ORDER BY id LIMIT ?", self._outcome, AT_MOST
        )
        self._table.add_batches(batches)
        for batch in batches:
            self._outcome = batch.id
            counted = self._counted.get(batch.generation, 0)
            self._counted[batch.generation] = counted + batch.count
        counts = self._counted.items()
        self._counted = {key: value for key, value in counts if key > self._generation}
        return batches

    def _sum_up(self, run: Run) -> None:
        """Sum up some of the earlier batches, the newest first; a long run has many."""
        begin = max(0, self._earlier - EARLIER)
        for server, trials, seconds, last_at in run.rows(
            "SELECT server, sum(count), sum(seconds), max(at) FROM outcomes "
            "WHERE id > ? AND id <= ? AND server <> '' GROUP BY server",
            tuple[str, int, float, float],
            begin,
            self._earlier,
        ):
            self._table[clean(server)].add_earlier(trials, seconds, last_at)
        self._earlier = begin

    def _state(self, now: float) -> dict[str, Any]:
        complete, servers = self._run.experiment, self._table.values()
        found = status(self.folder, finished=self._run.finished)
        running = found in RUNNING
        rate = sum(server.rate(now) for server in servers) if running else 0.0
        each = complete.problem.trials if complete.ranking.kind == "absolute" else 0
        current, pace = self._generation + 1, self._pace()
        champion, means = self._run.held_out, self._run.fitness_trials
        last = current
        if not self._run.finished:
            last = stopping.expected_generations(
                complete, current, self._evaluations, self._candidates
            )
        left = last - current
        after = self._trials_after(complete, each, last)
        if left or not running:
            counted = self._counted.get(current, 0)
            trials = self._candidates * each if left else 0
        else:
            counted, trials = self._counted.get(ASSESSMENT, 0), after
        searching = max(1, last * self._candidates * each)
        left_s = left * pace + last * pace * after / searching
        if not left and trials:
            left_s *= max(0.0, 1 - counted / trials)
        newest = self._newest()
        quiet_s = now - max(newest, self._began_at)
        quiet = found == "running" and quiet_s > max(QUIET_S, QUIET_GENERATIONS * pace)
        expected = pace and found == "running" and not quiet
        return {
            "status": found,
            "running": running,
            "asked": control_file.asked(self.folder) if running else "",
            "generation": current,  # finished ones
            "generations": last,  # expected, by the budgets
            "counted": counted if running else 0,
            "trials": trials if running else 0,
            "evaluations": self._evaluations,
            "rate": round(rate / each, 2) if each else None,
            "trial_rate": round(rate, 1),
            "eta_s": round(left_s, 1) if expected else None,
            "quiet_s": quiet_s // QUIET_S * QUIET_S if quiet else 0.0,  # in minutes
            "best": per_trial(self._best, means),
            "champion": msgspec.to_builtins(champion and champion.per_trial(means)),
            "mean": per_trial(self._mean, means),
            "best_sum": self._best,  # as in the record
            "fitness_trials": means,
            "at": newest or None,
            "servers": sum(server.slots > 0 for server in servers) if running else 0,
            "slots": sum(server.slots for server in servers) if running else 0,
            "requeued": self._requeued,
        }

    def _trials_after(self, complete: Experiment, each: int, last: int) -> int:
        """Return how many trials follow the last generation, at most."""
        searched = round(amount.played(complete) * self._evaluations * each)
        if current := self._generation + 1:
            searched = searched * last // current
        return amount.trials_after(complete, searched, last, fit=each > 0)

    def _pace(self) -> float:
        """Return the median seconds of the last generations, which ignores pauses; 0: unknown."""
        between = [after - before for before, after in itertools.pairwise(self._finished)]
        return statistics.median_high(between) if between else 0.0

    def _newest(self) -> float:
        """Return when the record was last added to."""
        return max(
            [*self._finished, 0.0, *(server.last_at for server in self._table.values())]
        )
