"""Write a run's folder: its experiment, its record in SQLite, and its champion.

Outcomes are committed at least every 0.1 s. A generation is committed together with the optimizer's
state before it is reported, so what is reported is on the disk. docs/record.md has the tables.
"""

import contextlib
import hashlib
import itertools
import os
import shutil
import sqlite3
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Self

import msgspec
import numpy as np

from zswarm import experiment
from zswarm.controller import CHAMPION, Controller
from zswarm.errors import ConfigError
from zswarm.experiment import Experiment
from zswarm.ot.cluster.events import Counted
from zswarm.ot.notes import Note, RunEvent
from zswarm.ot.optimizers.optimizer import Told
from zswarm.ot.record import opening, statements
from zswarm.ot.record.database import (
    Database,
    connect,
    describe,
    on_network,
    outage,
)
from zswarm.ot.record.folder import (
    DATABASE,
    EXPERIMENT,
    load_experiment,
    lock_folder,
    new_folder,
    unusable,
)
from zswarm.ot.record.history_hash import History
from zswarm.ot.record.statements import ADD_OUTCOMES, SET_META
from zswarm.ot.workload import Workload
from zswarm.system.files import write_whole
from zswarm.system.text import clean


class Resumed(NamedTuple):
    """Where a run resumes."""

    generation: int  # the first unfinished one
    state: Any  # of the optimizer; None before the first generation ended


class Record:
    """The folder of one run, open for writing by one program at a time.

    Attributes:
        say: called with a line for the user.
    """

    def __init__(self, folder: Path, connection: sqlite3.Connection, lock: int) -> None:
        self.folder = folder
        self.say: Callable[[str], None] = _to_stderr
        self.on_network = on_network(folder)
        self._database = Database(folder / DATABASE, connection, self._report)
        self._lock = lock
        self._outcomes = itertools.count(_first_free(connection, "outcomes"))
        self._events = itertools.count(_first_free(connection, "events"))
        self._generation: int | None = None
        self._round, self._asked = 0, b""

    @classmethod
    def create(
        cls,
        parent: Path,
        complete: Experiment,
        version_hash: str,
        metrics: Sequence[str] | None = None,
        *,
        name: str = "",
        **meta: Any,
    ) -> Self:
        """Create a folder ``parent/name``; if that exists ``name-2``, and so on.

        Args:
            metrics: names of the simulator's metrics.
            name: by default that of the experiment.
            meta: further rows of the table ``meta``.

        Raises:
            ConfigError: it cannot be written.
        """
        with contextlib.ExitStack() as undo:
            folder = new_folder(parent, name or complete.name)
            undo.callback(shutil.rmtree, folder, ignore_errors=True)
            lock = lock_folder(folder)
            undo.callback(os.close, lock)
            path = folder / DATABASE
            try:
                write_whole(folder / EXPERIMENT, experiment.to_toml(complete).encode())
                opening.create(
                    path, opening.new_meta(complete, version_hash, metrics, **meta)
                )
                record = cls(folder, connect(path), lock)
            except (sqlite3.OperationalError, OSError) as error:
                why = f"cannot be written: {describe(error, parent)}"
                raise unusable(folder, why) from None
            undo.pop_all()
        return record

    @classmethod
    def open(cls, folder: Path) -> tuple[Self, Experiment]:
        """Open an existing run to resume it; this raises its epoch.

        Raises:
            ConfigError: no run, damaged, of another schema, in use, or not writable.
        """
        complete = load_experiment(folder)
        with contextlib.ExitStack() as undo:
            lock = lock_folder(folder)
            undo.callback(os.close, lock)
            try:
                connection = connect(folder / DATABASE)
                undo.callback(connection.close)
                opening.check(folder, connection, complete)
                opening.raise_epoch(connection, complete)
                record = cls(folder, connection, lock)
            except (sqlite3.DatabaseError, UnicodeDecodeError) as error:
                if outage(error, folder):
                    why = f"cannot be written: {describe(error, folder)}"
                    raise ConfigError(f"{folder}: {why}") from None
                raise ConfigError(
                    f"{folder / DATABASE}: damaged: {clean(str(error))}; the experiment can be "
                    f"run again from {folder / EXPERIMENT}"
                ) from None
            undo.pop_all()
        return record, complete

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Commit if the disk lets us, and unlock the folder; a second call does nothing."""
        if self._lock < 0:
            return
        try:
            self._database.commit()
        except (sqlite3.OperationalError, OSError) as error:
            if not outage(error, self.folder):
                raise
            waiting = [
                values for sql, values in self._database.unwritten if sql == ADD_OUTCOMES
            ]
            lost = sum(values[3] for values in waiting)  # the column count
            why = f"cannot be written ({describe(error, self.folder)})"
            self.say(f"{self.folder} {why}: resume evaluates {lost} trials again")
        finally:
            self._database.close()
            os.close(self._lock)
            self._lock = -1

    # ---- meta

    def meta(self, key: str) -> Any:
        """Return a value, or None."""
        return self._value("SELECT max(value) FROM meta WHERE key = ?", key)

    def set_meta(self, key: str, value: Any) -> None:
        """Set a value and wait until it is on the disk."""
        self._database.write_now((SET_META, (key, value)))

    def machine_changed(self) -> str:
        """Return the machine that the run began on if it differs from this one, else ""."""
        before = str(self.meta("machine"))
        return before if before != opening.machine() else ""

    # ---- writing

    def begin(self, generation: int, workload: Workload) -> None:
        """Count the outcomes that follow for this generation and this round of its games."""
        self._generation, self._round = generation, workload.round
        self._asked = hashlib.blake2b(b"".join(workload.genomes), digest_size=8).digest()

    def end(self) -> None:
        """Record what follows as after the last generation."""
        self._generation = None

    def add(self, counted: Counted, workload: Workload) -> None:
        """Add outcomes."""
        row, at = next(self._outcomes), time.time()
        of = (self._generation, self._asked)
        self._database.write(statements.outcomes(counted, workload, row, *of, at))

    def retract(self, server: str) -> None:
        """Delete a faulty server's outcomes of this round, and mark its earlier ones doubtful."""
        generation, round_ = self._generation, self._round
        if generation is None:  # the last round that was begun
            generation = self.resumed().generation
            round_ = self._value(
                "SELECT max(round) FROM outcomes WHERE generation = ?", generation
            )
        of = (generation, round_ or 0, server)
        self._database.write(
            (
                "DELETE FROM outcomes WHERE (generation, round) = (?, ?) AND server = ?",
                of,
            ),
            (
                "UPDATE outcomes SET doubtful = 1 WHERE (generation, round) < (?, ?) "
                "AND server = ?",
                of,
            ),
        )

    def note(self, note: Note) -> None:
        """Add an event."""
        row, at = next(self._events), time.time()
        self._database.write(statements.event(note, row, self._generation, at))

    def finish(
        self,
        generation: int,
        genomes: Sequence[bytes],
        fitness: np.ndarray,
        statistics: dict[str, float],
        state: Any,
        measures: np.ndarray | None = None,
    ) -> None:
        """Commit a generation with the optimizer's state after it, and wait for the disk.

        Args:
            fitness, measures: as the optimizer was told.
            state: None: the optimizer was another program's, and the run cannot be resumed.
        """
        self._database.write_now(
            *statements.candidates(generation, genomes, fitness, measures),
            *statements.generation_end(
                generation, len(genomes), statistics, state, time.time()
            ),
        )

    def flush(self) -> None:
        """Commit if the last commit was 0.1 s ago; during a disk outage data wait."""
        self._database.flush()

    def champion(self, controller: Controller) -> None:
        """Replace the champion's file in one step."""
        content = msgspec.msgpack.encode(controller)
        self._database.retry(lambda: write_whole(self.folder / CHAMPION, content))

    # ---- reading back

    def resumed(self) -> Resumed:
        """Return where the run resumes."""
        rows = self._database.rows("SELECT generation, state FROM optimizer")
        if not rows:
            return Resumed(0, None)
        try:
            return Resumed(rows[0][0] + 1, msgspec.msgpack.decode(rows[0][1]))
        except (msgspec.DecodeError, UnicodeDecodeError, TypeError, RecursionError):
            what = "damaged: the optimizer's state cannot be read"
            raise ConfigError(f"{self.folder / DATABASE}: {what}") from None

    def restore(self, workload: Workload) -> int:
        """Copy the recorded outcomes of the current round into its workload; return how many.

        Raises:
            ConfigError: they belong to other candidates or games: the code of the optimizer,
                representation or ranking was changed.
        """
        restored = 0
        for (
            asked,
            trials,
            fitness,
            metrics,
            faulted,
            server,
            participants,
        ) in self._database.rows(
            "SELECT asked, trials, fitness, metrics, faulted, server, participants FROM outcomes "
            "WHERE (generation, round) = (?, ?)",
            self._generation,
            self._round,
        ):
            indices = np.frombuffer(trials, "<u4").astype(np.int64) - workload.first
            played = statements.games(workload, indices)
            if asked != self._asked or participants != played:
                raise ConfigError(
                    f"{self.folder}: generation {self._generation} was begun with other candidates "
                    "or games: this program proposes differently than the one that began the run"
                )
            count = len(indices)
            workload.fitness[indices] = np.frombuffer(fitness, "<f8").reshape(count, -1)
            workload.metrics[indices] = np.frombuffer(metrics, "<f8").reshape(count, -1)
            workload.counted[indices], workload.source[indices] = True, server
            # Faulted trials are counted one by one.
            workload.faulted[indices] = bool(faulted)
            restored += count
        return restored

    def forget_others(self) -> int:
        """Delete this generation's outcomes of other candidates than its own; return how many."""
        of = (self._generation, self._asked)
        other = "FROM outcomes WHERE generation = ? AND asked <> ?"
        found = self._sum(f"sum(count) {other}", *of)
        self._database.write((f"DELETE {other}", of))
        return found

    def told(self) -> Iterator[Told]:
        """Yield what the optimizer was told, a generation at a time."""
        for (generation,) in self._database.rows(
            "SELECT generation FROM generations ORDER BY generation"
        ):
            rows = self._database.rows(
                "SELECT genome, fitness, measures FROM candidates WHERE generation = ? "
                "ORDER BY candidate",
                generation,
            )
            fitness = np.array([row[1] for row in rows], np.float64)  # None becomes NaN
            measures = np.array([np.frombuffer(row[2] or b"", "<f8") for row in rows])
            shape = (len(rows), -1 if rows else 0)
            yield Told([row[0] for row in rows], fitness, measures.reshape(shape))

    def history(self) -> History:
        """Return the hash of the finished generations."""
        history = History()
        for told in self.told():
            history.add(*told)
        return history

    def evaluations(self) -> int:
        """Return the number of candidates of the finished generations."""
        return self._sum("sum(evaluations) FROM generations")

    def counts(self) -> dict[str, Any]:
        """Return the numbers of trials ``requeued``, ``faulted`` and ``doubtful``, for a result."""
        sums = {
            "requeued": "sum(count) FROM events WHERE event = 'requeued'",
            "faulted": "sum(faulted) FROM outcomes",
            "doubtful": "sum(count) FROM outcomes WHERE doubtful",
        }
        return {name: self._sum(sql) for name, sql in sums.items()}

    def _sum(self, what: str, *parameters: Any) -> int:
        return int(self._value(f"SELECT {what}", *parameters) or 0)

    def _value(self, sql: str, *parameters: Any) -> Any:
        """Return the value of an aggregate query."""
        return self._database.rows(sql, *parameters)[0][0]

    def _report(self, line: str, waited_s: float | None) -> None:
        """Report the begin of a disk outage, or its end and how long it took."""
        self.say(line)
        if waited_s is not None:
            self.note(Note(RunEvent.DISK_WAITED, count=round(waited_s)))


def _first_free(connection: sqlite3.Connection, table: str) -> int:
    sql = f"SELECT coalesce(max(rowid), 0) + 1 FROM {table}"  # noqa: S608  our own name
    return int(connection.execute(sql).fetchone()[0])


def _to_stderr(text: str) -> None:
    sys.stderr.write(text + "\n")
