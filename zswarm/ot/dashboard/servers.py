"""The servers of a run, from its events and batches: who computes, how fast, what went wrong."""

from collections import deque
from collections.abc import Iterable
from typing import Any

from zswarm.ot.dashboard.rows import BatchRow, EventRow
from zswarm.ot.notes import RunEvent

RATE_S = 10.0  # over which trials per second are counted
SPARK_BINS, SPARK_BIN_S = 30, 2.0  # of a server's small curve: a minute
# The state of a server after an event.
STATES: dict[str, str] = {
    RunEvent.LEASE_WAITING: "waiting for a slot",
    RunEvent.LEASE_PREPARING: "getting ready",
    RunEvent.LEASE_READY: "ready",
    RunEvent.SERVER_JOINED: "computing",
    RunEvent.SERVER_SLOTS: "computing",
    RunEvent.SERVER_BACK: "computing",
    RunEvent.SERVER_SPARE: "not needed",
    RunEvent.SERVER_LEFT: "left",
    RunEvent.SERVER_LOST: "lost",
    RunEvent.LEASE_LOST: "lease lost",
    RunEvent.SERVER_SILENT: "silent",
    RunEvent.SERVER_REFUSED: "refused",
    RunEvent.SERVER_MISMATCH: "does not match",
    RunEvent.SERVER_DIFFERS: "differs",
    RunEvent.SERVER_FAULTY: "backed off",
    RunEvent.SERVER_WRONG: "computes wrong",
    RunEvent.SERVER_BANNED: "computes wrong",
}
LEASES = {RunEvent.LEASE_WAITING, RunEvent.LEASE_PREPARING, RunEvent.LEASE_READY}
JOINS = {RunEvent.SERVER_JOINED, RunEvent.SERVER_SLOTS}
COMPUTING = "computing"
HOLDING = {COMPUTING, "ready", "getting ready"}  # slots
HEALTH = {
    **dict.fromkeys(("computes wrong", "backed off", "differs"), "bad"),
    **dict.fromkeys(("left", "lost", "lease lost", "silent"), "away"),
}
FAULTS = {RunEvent.FAULT, RunEvent.SIMULATOR_RAISED, RunEvent.MALFORMED}
LOSSES = {RunEvent.SERVER_LOST, RunEvent.LEASE_LOST, RunEvent.SERVER_SILENT}


class ServerState:
    """One server."""

    def __init__(self, id_: str) -> None:
        self.id = id_
        self.state, self.why = "", ""
        self.leased = self.slots = self.trials = self.faults = self.losses = 0
        self.seconds = self.last_at = 0.0
        self._recent: deque[tuple[float, int]] = deque()  # times and trials

    def add_event(self, event: EventRow) -> None:
        """Follow an event of this server."""
        if state := STATES.get(event.event):
            self.state, self.why = state, event.text
            if event.event in LEASES:
                self.leased = event.count
            elif event.event in JOINS:
                self.slots, self.leased = event.count, max(self.leased, event.count)
            elif state not in HOLDING:
                self.leased = self.slots = 0
        if event.event in FAULTS:
            self.faults, self.why = self.faults + 1, event.text
        self.losses += event.event in LOSSES

    def add_batch(self, batch: BatchRow) -> None:
        """Count a batch that this server computed."""
        self.add_earlier(batch.count, batch.seconds, batch.at)
        self._recent.append((batch.at, batch.count))

    def add_earlier(self, trials: int, seconds: float, last_at: float) -> None:
        """Count batches by their sums."""
        self.trials += trials
        self.seconds += seconds
        self.last_at = max(self.last_at, last_at)

    def rate(self, now: float) -> float:
        """Return the trials per second until now, in seconds since 1970."""
        return sum(count for at, count in self._recent if at >= now - RATE_S) / RATE_S

    def row(self, now: float, total: int, *, running: bool) -> dict[str, Any]:
        """Return a row for the page.

        Args:
            now: seconds since 1970.
            total: trials of all servers.
            running: whether the run is; else no server computes.
        """
        state = self.state or (COMPUTING if self.trials else "")
        if not running and state in HOLDING:
            state = "done"
        return {
            "server": self.id,
            "state": state,
            "health": HEALTH.get(
                state, "warning" if self.faults or self.losses else "good"
            ),
            "leased": self.leased if running else 0,
            "slots": self.slots if running else 0,
            "trials": self.trials,
            "share": self.trials / total if total else 0.0,
            "rate": round(self.rate(now), 2) if running else 0.0,
            "trial_ms": round(1000 * self.seconds / self.trials, 4)
            if self.trials
            else None,
            "last_at": self.last_at or None,
            "faults": self.faults,
            "losses": self.losses,
            "why": self.why,
            "spark": self._spark(now),
        }

    def _spark(self, now: float) -> list[int]:
        """Return the trials of the last bins, which follow the clock: they move once per bin."""
        while self._recent and self._recent[0][0] < now - SPARK_BINS * SPARK_BIN_S:
            self._recent.popleft()
        spark, last = [0] * SPARK_BINS, int(now / SPARK_BIN_S)
        for at, count in self._recent:
            place = int(at / SPARK_BIN_S) - last + SPARK_BINS - 1
            spark[min(SPARK_BINS - 1, max(0, place))] += count
        return spark


class ServerTable(dict[str, ServerState]):
    """All servers of one run, by their ids."""

    def __missing__(self, id_: str) -> ServerState:
        """Add a server."""
        return self.setdefault(id_, ServerState(id_))

    def add_events(self, events: Iterable[EventRow]) -> None:
        """Follow events, in order."""
        for event in events:
            if event.event == RunEvent.BEGAN:
                # The previous program released them; after a resume they join again.
                for server in self.values():
                    server.leased = server.slots = 0
                    if server.state in HOLDING:
                        server.state = "left"
            if event.server:
                self[event.server].add_event(event)

    def add_batches(self, batches: Iterable[BatchRow]) -> None:
        """Count batches."""
        for batch in batches:
            if batch.server:
                self[batch.server].add_batch(batch)

    def rows(self, now: float, *, running: bool) -> list[dict[str, Any]]:
        """Return rows for the page, the busiest server first."""
        total = sum(server.trials for server in self.values())
        rows = [server.row(now, total, running=running) for server in self.values()]
        return sorted(rows, key=lambda row: (-row["trials"], row["server"]))
