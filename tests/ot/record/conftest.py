"""Create folders of runs."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.ot.record.recorded import complete, evolve
from zswarm.ot.record.writer import Record


@pytest.fixture
def record(tmp_path: Path) -> Iterator[Record]:
    """Create the record of an active run."""
    made = Record.create(
        tmp_path, complete("lab", "problem.trials=2"), "hash", ["escaped", "rounds"]
    )
    evolve(made)
    made.sync()
    yield made
    made.close()  # some tests did so themselves


@pytest.fixture
def folder(record: Record) -> Path:
    """Create the folder of a finished run."""
    record.set_meta("history_hash", record.history().hex())
    record.close()
    return record.folder
