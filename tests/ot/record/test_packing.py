"""An optimizer's state, by references to genomes and in pieces."""

import sqlite3
from pathlib import Path

import msgspec
import numpy as np
import pytest

from tests.ot.record.recorded import complete
from zswarm.errors import ConfigError
from zswarm.ot.record import packing
from zswarm.ot.record.packing import pack, unpack
from zswarm.ot.record.writer import Record

STATISTICS = {"best": 1.0, "mean": 1.0}


def test_a_state_comes_back_as_it_was_with_long_values_in_pieces(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(packing, "PIECE", 100)
    state = {"a": [b"genome", b"other", 1.5, None], "long": bytes(range(250)), "b": "x"}
    packed = pack(state, {b"genome": (3, 4)})
    assert [(part, piece) for part, piece, _ in packed.pieces()] == [
        (0, 0),
        (1, 0),
        (1, 1),
        (1, 2),
    ]
    assert b"genome" not in packed.parts[0]
    rows = [(part, bytes(body)) for part, _, body in packed.pieces()]
    assert unpack(rows, {(3, 4): b"genome"}.__getitem__) == (state, {b"genome": (3, 4)})


def test_a_recorded_state_refers_to_genomes_of_several_generations(
    tmp_path: Path,
) -> None:
    with Record.create(tmp_path, complete(), "hash") as record:
        record.finish(0, [b"a" * 50, b"b" * 50], np.zeros(2), STATISTICS, [b"b" * 50])
        state = {"old": b"b" * 50, "new": [b"c" * 50], "no genome": b"d"}
        record.finish(1, [b"c" * 50], np.zeros(1), STATISTICS, state)
    with Record.open(record.folder)[0] as again:
        assert again.resumed() == (2, state)
        assert again._known == {b"b" * 50: (0, 1), b"c" * 50: (1, 0)}
        size = again._value("SELECT sum(length(state)) FROM optimizer")
        assert size < len(msgspec.msgpack.encode(state)) - 50


def test_a_value_that_sqlite_refuses_is_one_line(tmp_path: Path) -> None:
    record = Record.create(tmp_path, complete(), "hash")
    record._database._connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, 1000)
    record.finish(0, [b"x" * 2000], np.zeros(1), STATISTICS, {})
    with pytest.raises(ConfigError, match="cannot be recorded: string or blob too big"):
        record.sync()
    with pytest.raises(ConfigError, match="cannot be recorded"):
        record.close()
