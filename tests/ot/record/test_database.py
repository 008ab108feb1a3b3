"""A record's database: where it is, and what it may hold."""

import contextlib
import sqlite3
from pathlib import Path

import pytest

from zswarm.ot.record.database import connect, on_network


def test_a_network_file_system_is_known_by_its_mount(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    mounts = "/dev/vda / ext4 rw 0 0\nserver:/home {} nfs4 rw 0 0\n"
    read = Path.read_text
    monkeypatch.setattr(
        Path,
        "read_text",
        lambda self: (
            mounts.format(tmp_path) if str(self) == "/proc/self/mounts" else read(self)
        ),
    )
    assert on_network(tmp_path / "run.sqlite")
    assert not on_network(Path("/somewhere/else"))


def test_a_record_with_a_trigger_is_not_written(tmp_path: Path) -> None:
    """Its SQL would run in the user's program."""
    path = tmp_path / "run.sqlite"
    with contextlib.closing(connect(path)) as made:
        made.execute("CREATE TABLE events (x)")
        made.execute(
            "CREATE TRIGGER t AFTER INSERT ON events BEGIN DELETE FROM events; END"
        )
    with pytest.raises(sqlite3.DatabaseError, match="has a trigger; zswarm makes none"):
        connect(path)
