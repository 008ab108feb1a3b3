"""Rows of a record that the dashboard reads, with texts that are safe to show."""

from typing import Any

from msgspec import Struct
from msgspec.structs import asdict, replace

from zswarm.ot.notes import severity
from zswarm.ot.record import epochs
from zswarm.ot.record.reader import Run
from zswarm.system.text import clean

EVENTS = (
    "SELECT rowid, at, generation, event, coalesce(server, ''), coalesce(text, ''), "
    "coalesce(count, 0) FROM events "
)
BATCHES = "SELECT id, generation, count, server, seconds, at FROM outcomes "


class EventRow(Struct, frozen=True, array_like=True):
    """A row of the table ``events``."""

    id: int
    at: float
    generation: int | None
    event: str
    server: str
    text: str
    count: int

    def as_mapping(self) -> dict[str, Any]:
        """Return the event for a page, with its severity: error, warning or info."""
        text = epochs.shown(self.event, self.text)
        return {**asdict(self), "text": text, "level": severity(self.event)}


class BatchRow(Struct, frozen=True, array_like=True):
    """A row of the table ``outcomes``, without its arrays."""

    id: int
    generation: int
    count: int
    server: str
    seconds: float
    at: float


def read_events(run: Run, which: str, *parameters: Any) -> list[EventRow]:
    """Return events; ``which`` is the rest of the query, after its table."""
    return [
        replace(
            row, event=clean(row.event), server=clean(row.server), text=clean(row.text)
        )
        for row in run.rows(EVENTS + which, EventRow, *parameters)
    ]


def read_batches(run: Run, which: str, *parameters: Any) -> list[BatchRow]:
    """Return batches; ``which`` is the rest of the query, after its table."""
    rows = run.rows(BATCHES + which, BatchRow, *parameters)
    return [replace(row, server=clean(row.server)) for row in rows]
