"""The views, as other programs see them."""

import json
import shutil
import sqlite3
import subprocess
from pathlib import Path
from typing import Any

import pytest

from tests.ot.record.recorded import (
    EVIL,
    edit,
    refusal,
)
from zswarm.ot.record.reader import Run


@pytest.mark.parametrize("found", [1, 3, 4, 99, "x", 0, None, 1.5])
def test_a_record_of_another_schema_is_refused(folder: Path, found: object) -> None:
    edit(folder, "UPDATE meta SET value = ? WHERE key = 'schema_version'", found)
    edit(folder, "UPDATE meta SET value = ? WHERE key = 'zswarm'", EVIL)
    words = (
        f"has schema {found}, of zswarm"
        if isinstance(found, int) and found
        else "damaged: "
    )
    assert words in refusal(folder)


def sqlite3_program(folder: Path, sql: str) -> list[tuple[Any, ...]]:
    """Rows by the sqlite3 program, or by Python's module where that is not installed."""
    if not shutil.which("sqlite3"):
        database = sqlite3.connect(f"file:{folder / 'run.sqlite'}?mode=ro", uri=True)
        rows = database.execute(sql).fetchall()
        database.close()
        return rows
    command = ["sqlite3", "-readonly", "-json", str(folder / "run.sqlite"), sql]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return [tuple(row.values()) for row in json.loads(done.stdout or "[]")]


def test_the_views_agree_with_the_reader(folder: Path) -> None:
    run = Run(folder)
    curve = sqlite3_program(
        folder, "SELECT generation, seconds, best, mean, evaluations FROM history"
    )
    columns = ("generation", "seconds", "best", "mean", "evaluations")
    assert [row[1] for row in curve] == pytest.approx(
        [row["seconds"] for row in run.history()]
    )
    assert [(row[0], *row[2:]) for row in curve] == [
        tuple(row[column] for column in columns if column != "seconds")
        for row in run.history()
    ]
    assert sqlite3_program(
        folder, "SELECT generation, best, candidate FROM champions"
    ) == [
        (0, 0.625, 1),
        (1, 2.625, 1),
    ]
    assert sqlite3_program(folder, "SELECT server, trials FROM servers") == [
        ("lab-01", 4),
        ("lab-02", 4),
    ]
    assert sqlite3_program(folder, "SELECT generation, server, trials FROM batches")[
        1
    ] == (
        0,
        "lab-02",
        2,
    )
    assert sqlite3_program(
        folder, "SELECT name, value FROM statistics WHERE generation = 0"
    ) == [
        ("best", 0.625),
        ("mean", 0.375),
        ("diversity", None),
    ]
    assert ("optimizer.population", "50") in sqlite3_program(
        folder, "SELECT key, value FROM settings"
    )
    assert ("problem.settings.agents", "10") in sqlite3_program(
        folder, "SELECT key, value FROM settings"
    )
    assert sqlite3_program(folder, "SELECT event, server, text FROM timeline")[0] == (
        "server_joined",
        "lab-01",
        "with one slot",
    )


def test_times_of_the_views_are_utc(folder: Path) -> None:
    edit(folder, "UPDATE generations SET finished_at = 1772615523.125")
    edit(folder, "UPDATE meta SET value = 1772615523.0 WHERE key = 'created_at'")
    rows = sqlite3_program(folder, "SELECT utc, seconds FROM history")
    assert rows == [("2026-03-04 09:12:03.125", 0.125), ("2026-03-04 09:12:03.125", 0.0)]


def test_a_generation_without_a_better_one_has_no_champion(folder: Path) -> None:
    edit(folder, "UPDATE generations SET best = 0.625")
    assert sqlite3_program(folder, "SELECT generation FROM champions") == [(0,)]
    edit(folder, "UPDATE generations SET best = NULL WHERE generation = 0")
    assert sqlite3_program(folder, "SELECT generation FROM champions") == [(1,)]
