"""The servers of a run as its record tells of them: who computes, how fast, what went wrong, why one is not used; pure."""

from collections import deque
from collections.abc import Iterable
from typing import Any

import msgspec

RATE_S = 10.0  # over which trials per second are counted
SPARK_BINS, SPARK_BIN_S = 30, 2.0  # of a server's small curve: a minute
# What an event says of its server, and whether the server computes then.
STATES = {
    "lease_waiting": "waiting for a slot",
    "lease_preparing": "getting ready",
    "lease_ready": "ready",
    "server_joined": "computing",
    "server_slots": "computing",
    "server_back": "computing",
    "server_spare": "not needed",
    "server_left": "left",
    "server_lost": "lost",
    "lease_lost": "lease lost",
    "server_silent": "silent",
    "server_refused": "refused",
    "server_mismatch": "does not match",
    "server_differs": "differs",
    "server_faulty": "put aside",
    "server_wrong": "computes wrong",
}
LEASES = {"lease_waiting", "lease_preparing", "lease_ready"}
COMPUTING = "computing"
HOLDING = {COMPUTING, "ready", "getting ready"}  # states in which slots are held
BAD = {"computes wrong", "put aside", "differs"}
AWAY = {"left", "lost", "lease lost", "silent"}
FAULTS = {"fault", "simulator_raised", "malformed"}
LOSSES = {"server_lost", "lease_lost", "server_silent"}
ERRORS = {"server_wrong", "server_faulty", "fault", "simulator_raised", "malformed", "server_lost", "lease_lost"}
WARNINGS = {
    *("disk_waited", "unverified", "server_differs", "server_mismatch", "server_refused", "server_silent", "diagnosis"),
    *("requeued", "server_left"),
}


class Event(msgspec.Struct, frozen=True):
    """A row of the record's table of that name."""

    rowid: int
    at: float
    generation: int | None
    event: str
    server: str
    text: str
    count: int

    @property
    def level(self) -> str:
        """How grave it is: error, warning or info."""
        return "error" if self.event in ERRORS else "warning" if self.event in WARNINGS else "info"


class Batch(msgspec.Struct, frozen=True):
    """A row of the table of outcomes, without the arrays."""

    id: int
    generation: int
    count: int
    server: str
    seconds: float
    at: float
    faulted: int


class Server:
    """What is known of one."""

    def __init__(self, id_: str) -> None:
        self.id = id_
        self.state, self.why = "", ""
        self.leased = self.slots = self.trials = self.faults = self.losses = 0
        self.seconds = self.last_at = 0.0
        self._recent: deque[tuple[float, int]] = deque()  # when how many trials came

    def happened(self, event: Event) -> None:
        """Something of it."""
        if event.event in STATES:
            self.state = STATES[event.event]
            self.why = event.text
            if event.event in LEASES:
                self.leased = event.count
            elif event.event in ("server_joined", "server_slots"):
                self.slots = event.count
                self.leased = max(self.leased, event.count)
            elif self.state not in HOLDING:
                self.leased = self.slots = 0
        if event.event in FAULTS:
            self.faults, self.why = self.faults + 1, event.text
        self.losses += event.event in LOSSES

    def computed(self, batch: Batch) -> None:
        """Trials came from it."""
        self.trials += batch.count
        self.seconds += batch.seconds
        self.last_at = max(self.last_at, batch.at)
        self._recent.append((batch.at, batch.count))

    def computed_before(self, trials: int, seconds: float, last_at: float) -> None:
        """So much came from it before what is followed."""
        self.trials, self.seconds, self.last_at = self.trials + trials, self.seconds + seconds, max(self.last_at, last_at)

    def row(self, now: float, trials: int, *, going_on: bool) -> dict[str, Any]:
        """For the page.

        Args:
            now: seconds since 1970.
            trials: of all servers.
            going_on: the run is; else nobody computes.
        """
        while self._recent and self._recent[0][0] < now - SPARK_BINS * SPARK_BIN_S:
            self._recent.popleft()
        spark, last = [0] * SPARK_BINS, int(now / SPARK_BIN_S)  # bins of the clock: they move once in a while
        for at, count in self._recent:
            spark[min(SPARK_BINS - 1, max(0, int(at / SPARK_BIN_S) - last + SPARK_BINS - 1))] += count
        state = self.state or (COMPUTING if self.trials else "")
        if not going_on and state in HOLDING:
            state = "done"
        health = "bad" if state in BAD else "away" if state in AWAY else "warning" if self.faults or self.losses else "good"
        return {
            "server": self.id,
            "state": state,
            "health": health,
            "leased": self.leased if going_on else 0,
            "slots": self.slots if going_on else 0,
            "trials": self.trials,
            "share": self.trials / trials if trials else 0.0,
            "rate": round(sum(count for at, count in self._recent if at >= now - RATE_S) / RATE_S, 2) if going_on else 0.0,
            "trial_ms": round(1000 * self.seconds / self.trials, 4) if self.trials else None,
            "last_at": self.last_at or None,
            "faults": self.faults,
            "losses": self.losses,
            "why": self.why,
            "spark": spark,
        }


class Fleet:
    """All servers of one run."""

    def __init__(self) -> None:
        self.servers: dict[str, Server] = {}

    @property
    def trials(self) -> int:
        """That came from all of them."""
        return sum(server.trials for server in self.servers.values())

    @property
    def slots(self) -> int:
        """That compute now."""
        return sum(server.slots for server in self.servers.values())

    @property
    def serving(self) -> int:
        """Servers that compute now."""
        return sum(server.slots > 0 for server in self.servers.values())

    def server(self, id_: str) -> Server:
        """One of them, known or new."""
        if id_ not in self.servers:
            self.servers[id_] = Server(id_)
        return self.servers[id_]

    def happened(self, events: Iterable[Event]) -> None:
        """Events, in order."""
        for event in events:
            if event.event == "began":  # who computed before has to join anew
                for server in self.servers.values():
                    server.leased = server.slots = 0
                    if server.state in HOLDING:
                        server.state = "lost"
            if event.server:
                self.server(event.server).happened(event)

    def computed(self, batches: Iterable[Batch]) -> None:
        """Batches that were counted."""
        for batch in batches:
            if batch.server:
                self.server(batch.server).computed(batch)

    def rows(self, now: float, *, going_on: bool) -> list[dict[str, Any]]:
        """For the page, who did most first."""
        trials = self.trials
        rows = [server.row(now, trials, going_on=going_on) for server in self.servers.values()]
        return sorted(rows, key=lambda row: (-row["trials"], row["server"]))


def busy(batches: Iterable[Batch], slots: dict[str, int], begin: float, end: float, bins: int) -> dict[str, list[float]]:
    """How many slots of each server were computing, over time: gaps are where nothing was.

    A batch's seconds are those of all slots that computed it: they are laid before the time at which it was counted, side by
    side on the server's slots.

    Args:
        slots: of each server; of one that is missing, 1.
        begin, end: seconds since 1970.
        bins: so many equal parts.
    """
    width = (end - begin) / bins
    found: dict[str, list[float]] = {}
    for batch in batches:
        if not batch.server or width <= 0:
            continue
        row = found.setdefault(batch.server, [0.0] * bins)
        lasted = batch.seconds / max(1, slots.get(batch.server, 1))
        since = max(begin, batch.at - lasted)
        first, last = int((since - begin) / width), int((batch.at - begin) / width)
        share = batch.seconds / max(lasted, 1e-9)  # slots at work while it lasted
        for index in range(max(0, first), min(bins - 1, last) + 1):
            overlap = min(batch.at, begin + (index + 1) * width) - max(since, begin + index * width)
            row[index] += share * max(0.0, overlap) / width
    return {server: [round(value, 3) for value in row] for server, row in found.items()}
