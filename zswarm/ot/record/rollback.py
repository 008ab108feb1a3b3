"""Go back to the end of an earlier generation: a new database with what came before."""

import contextlib
import os
import shutil
import sqlite3
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from zswarm.errors import ConfigError
from zswarm.ot.notes import RunEvent
from zswarm.ot.record import verify
from zswarm.ot.record.database import SIDE_FILES, read_only
from zswarm.ot.record.digests import (
    CANDIDATE,
    EVENT,
    GENERATION,
    OUTCOMES,
    Damage,
    check_candidates,
    check_generation,
    check_outcomes,
    of_row,
    seal,
    total,
)
from zswarm.ot.record.folder import DATABASE, check_run, lock_folder
from zswarm.ot.record.history_hash import START
from zswarm.ot.record.schema import CREATE, OF_THE_END
from zswarm.ot.record.statements import SET_META
from zswarm.system.files import sync

KEPT = (RunEvent.SERVER_WRONG, RunEvent.SERVER_BANNED, RunEvent.SERVER_TRUSTED)


class Former(NamedTuple):
    """The record from before a run went back."""

    path: Path
    damaged: int  # events that the new record does not have, because they were damaged


def go_back(folder: Path, generations: int) -> Former:
    """Drop everything after some generations, and return where the former record is kept.

    The optimizer's state is dropped, too: a resume makes it again from the candidates. Bans of
    machines are kept.

    Args:
        generations: how many remain.

    Raises:
        ConfigError: there are fewer, one of them is damaged, or the run is in use.
    """
    check_run(folder)
    path = folder / DATABASE
    lock = lock_folder(folder)
    part = path.with_suffix(".part")
    try:
        part.unlink(missing_ok=True)
        with verify.in_words(folder), read_only(path) as former:
            meta = verify.read_meta(former, path)
            for key in OF_THE_END:
                meta.pop(key, None)
            with contextlib.closing(sqlite3.connect(part, isolation_level=None)) as new:
                new.executescript(f"BEGIN; {CREATE}")
                new.executemany(SET_META, [*meta.items(), seal(meta)])
                damaged = _copy(former, new, generations, folder)
                new.execute("COMMIT")
        return Former(_replace(path, part), damaged)
    except OSError as error:
        raise ConfigError(
            f"{folder}: cannot be written: {error.strerror or error}"
        ) from None
    finally:
        part.unlink(missing_ok=True)
        os.close(lock)


def _copy(
    former: sqlite3.Connection, new: sqlite3.Connection, generations: int, folder: Path
) -> int:
    """Copy whole generations, their outcomes and events; return how many events are damaged."""
    expected, before = [], START
    for number, (*row, written) in zip(
        range(generations), verify.generations(former), strict=False
    ):
        check_generation(number, row, written)
        candidates = list(verify.candidates(former, number))
        check_candidates(number, before, row[6], candidates)
        before = row[6]
        expected.append(row[7])
        _add(new, "generations", f"{GENERATION}, digest", [(*row, written)])
        rows = [(number, *candidate) for candidate in candidates]
        _add(new, "candidates", f"generation, {CANDIDATE}", rows)
    if len(expected) < generations:
        raise ConfigError(
            f"{folder}: --from {generations + 1}: {len(expected)} generations are finished: "
            f"expected 1 to {len(expected) + 1}"
        )
    found = [0] * generations
    kept = _outcomes_before(former, generations, found)
    _add(new, "outcomes", f"{OUTCOMES}, doubtful, digest", kept)
    for number, written in enumerate(expected):
        if total([found[number]]) != written:
            raise Damage("outcomes of its trials are not what was written", number)
    return _copy_events(former, new, generations)


def _outcomes_before(
    former: sqlite3.Connection, generations: int, found: list[int]
) -> Iterator[Any]:
    """Yield the whole rows of outcomes before a generation, and sum up their digests."""
    with contextlib.suppress(Damage):  # what is missing is noticed by the sums
        for row in verify.outcomes(former):
            *values, doubtful, written = row
            value = check_outcomes(values, doubtful, written)
            if value is not None and 0 <= values[1] < generations:
                found[values[1]] += value
                yield row


def _copy_events(
    former: sqlite3.Connection, new: sqlite3.Connection, generations: int
) -> int:
    """Copy the whole events before a generation; return how many are damaged."""
    kept: list[tuple[Any, ...]] = []
    damaged, last = 0, 0
    sql = f"SELECT {EVENT}, digest FROM events ORDER BY rowid"  # noqa: S608  ours
    with contextlib.suppress(sqlite3.DatabaseError):
        for number, at, generation, *of, written in former.execute(sql):
            damaged += number - last - 1
            last = number
            if of_row(number, at, generation, *of) != written:
                damaged += 1
            elif generation is None or generation < generations or of[0] in KEPT:
                before = None if generation is None else min(generation, generations)
                row = (len(kept) + 1, at, before, *of)
                kept.append((*row, of_row(*row)))
    _add(new, "events", f"{EVENT}, digest", kept)
    return damaged


def _add(new: sqlite3.Connection, table: str, columns: str, rows: Iterable[Any]) -> None:
    marks = ", ".join("?" * len(columns.split(",")))
    new.executemany(f"INSERT OR IGNORE INTO {table} ({columns}) VALUES ({marks})", rows)  # noqa: S608  ours


def _replace(path: Path, part: Path) -> Path:
    """Put a new database in the place of one, and return where that is kept."""
    number = 1
    while (aside := path.with_name(f"{path.name}.before-{number}")).exists():
        number += 1
    _keep(path, aside)
    for side in SIDE_FILES:
        if (file := path.with_name(path.name + side)).exists():
            _keep(file, aside.with_name(aside.name + side))
            file.unlink()  # SQLite would apply it to the new one
    sync(part)
    part.replace(path)
    sync(path.parent)
    return aside


def _keep(path: Path, aside: Path) -> None:
    try:
        aside.hardlink_to(path)
    except OSError:  # a file system without links
        shutil.copyfile(path, aside)
