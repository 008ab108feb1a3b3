"""Servers as their events and batches show them."""

from zswarm.ot.dashboard.rows import EventRow
from zswarm.ot.dashboard.servers import ServerTable


def test_servers_must_join_again_after_a_resume() -> None:
    table = ServerTable()
    table.add_events(
        [
            EventRow(1, 0.0, 0, "server_joined", "a", "", 4),
            EventRow(2, 1.0, 0, "server_slots", "a", "", 6),
        ]
    )
    assert [row["slots"] for row in table.rows(1.0, running=True)] == [6]
    table.add_events([EventRow(3, 2.0, 0, "began", "", "", 1)])
    (row,) = table.rows(2.0, running=True)
    assert (row["slots"], row["state"]) == (0, "left")
    table.add_events([EventRow(4, 3.0, 0, "server_mismatch", "b", "has no simulator", 0)])
    assert {row["server"]: row["why"] for row in table.rows(3.0, running=True)}[
        "b"
    ] == "has no simulator"
