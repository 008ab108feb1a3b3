"""Check tables for people."""

import pytest

from zswarm.ot.display import tables
from zswarm.system.terminal import console


def test_a_table_that_fits_looks_as_if_rich_printed_its_rows(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is printed as one row of many lines, which takes less time."""
    monkeypatch.delenv("COLUMNS", raising=False)
    table = tables.table("run", ">generations", "history")
    for number in range(30):
        tables.row(table, f"runs/[{number}]", 3**number, "" if number % 3 else "54603a")
    tables.show(table)
    shown = capsys.readouterr().out
    made = console()
    made.width = tables.UNFOLDED
    made.print(table)
    assert shown == capsys.readouterr().out
    assert len(shown.splitlines()) == 30 + 4
