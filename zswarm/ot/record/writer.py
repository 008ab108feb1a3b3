"""Write a run's folder: its experiment, its record in SQLite, and its champion.

A thread commits (``commits``), so that a run does not wait for the disk: what is recorded is the
beginning of what happened, at most 0.05 s behind when a generation is reported. A generation is
committed together with the optimizer's state after it. docs/record.md has the tables.
"""

import contextlib
import hashlib
import itertools
import os
import shutil
import sqlite3
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Self

import msgspec
import numpy as np

from zswarm import experiment
from zswarm.champion.controller import CHAMPION, Controller
from zswarm.errors import ConfigError
from zswarm.experiment import Experiment
from zswarm.ot.cluster.events import Counted
from zswarm.ot.notes import Note, RunEvent
from zswarm.ot.record import contenders, opening, statements, verify
from zswarm.ot.record.commits import Commits
from zswarm.ot.record.database import Statement, connect, describe, on_network, outage
from zswarm.ot.record.digests import seal, total
from zswarm.ot.record.folder import (
    DATABASE,
    EXPERIMENT,
    load_experiment,
    lock_folder,
    new_folder,
    unusable,
)
from zswarm.ot.record.history_hash import History, digest
from zswarm.ot.record.packing import PackedState, pack
from zswarm.ot.record.resuming import Recorded
from zswarm.ot.record.schema import ASSESSMENT
from zswarm.ot.record.statements import ADD_OUTCOMES, SET_META
from zswarm.ot.workload import Workload
from zswarm.system.files import write_whole

LARGE = 16 << 20  # bytes of a generation's genomes
SHORT = 4096  # bytes of a genome that the state repeats rather than have it kept, then dropped


class Record(Recorded):
    """The folder of one run, open for writing by one program at a time.

    Attributes:
        say: called with a line for the user.
    """

    def __init__(
        self,
        folder: Path,
        connection: sqlite3.Connection,
        lock: int,
        meta: Mapping[str, Any],
        complete: Experiment,
    ) -> None:
        super().__init__()
        self.folder = folder
        self.say: Callable[[str], None] = _to_stderr
        self.on_network = on_network(folder)
        self._database = Commits(folder / DATABASE, connection, self._report)
        self._lock = lock
        self._outcomes = itertools.count(_first_free(connection, "outcomes"))
        self._events = itertools.count(_first_free(connection, "events"))
        self._meta, self._keep = dict(meta), complete.record.genomes
        self._history = self.history().value
        # Of fewer genomes than all, also those of the candidates are kept that may be assessed.
        assessed = complete.assessment
        self._raced = self._contenders(
            assessed.candidates if self._keep != "all" and assessed.budget else 0
        )
        self._generation: int | None = None
        self._round, self._asked = 0, b""
        self._digests: tuple[Sequence[bytes], list[bytes]] = ([], [])  # of these genomes
        # Sum of the digests of the generation's outcomes; None: it is to be read.
        self._trials: int | None = None

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
                rows = opening.new_meta(complete, version_hash, metrics, **meta)
                opening.create(path, rows)
                record = cls(folder, connect(path), lock, rows, complete)
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
                with verify.in_words(folder):
                    connection = connect(folder / DATABASE)
                    undo.callback(connection.close)
                    meta = opening.check(folder, connection, complete)
                    meta = opening.raise_epoch(connection, complete, meta)
                    record = cls(folder, connection, lock, meta, complete)
            except sqlite3.DatabaseError as error:
                why = f"cannot be written: {describe(error, folder)}"
                raise ConfigError(f"{folder}: {why}") from None
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
            waiting, error = self._database.close()
            if isinstance(error, sqlite3.OperationalError | OSError) and outage(
                error, self.folder
            ):
                lost = sum(values[3] for sql, values in waiting if sql == ADD_OUTCOMES)
                why = f"cannot be written ({describe(error, self.folder)})"
                self.say(f"{self.folder} {why}: resume evaluates {lost} trials again")
            elif error is not None:
                raise error
        finally:
            os.close(self._lock)
            self._lock = -1

    def sync(self) -> None:
        """Wait until everything is on the disk, from any thread; after ``close`` do nothing."""
        if self._lock >= 0:
            self._database.sync()

    # ---- meta

    def meta(self, key: str) -> Any:
        """Return a value, or None."""
        return self._meta.get(key)

    def taken_over(self) -> bool:
        """Return whether another program resumed the run: it raised the epoch on the disk."""
        now = self._value("SELECT value FROM meta WHERE key = 'epoch'")
        return bool(now > self.meta("epoch"))

    def set_meta(self, key: str, value: Any) -> None:
        """Set a value."""
        self._meta[key] = value
        self._database.write((SET_META, (key, value)), (SET_META, seal(self._meta)))

    def machine_changed(self) -> str:
        """Return the machine that the run began on if it differs from this one, else ""."""
        before = str(self.meta("machine"))
        return before if before != opening.machine() else ""

    # ---- writing

    def begin(self, generation: int, workload: Workload) -> None:
        """Count the outcomes that follow for this generation and this round of its games."""
        if generation != self._generation:
            # Nothing is recorded yet of a generation that follows another.
            self._trials = None if self._generation is None else 0
        self._generation, self._round = generation, workload.round
        whole = b"".join(self._digests_of(workload.genomes))
        self._asked = hashlib.blake2b(whole, digest_size=8).digest()

    def end(self) -> None:
        """Record what follows as after the last generation."""
        self._generation = None

    def add(self, counted: Counted, workload: Workload) -> None:
        """Add outcomes."""
        row, at = next(self._outcomes), time.time()
        of = (self._generation, self._asked)
        statement = statements.outcomes(counted, workload, row, *of, at)
        if self._trials is not None:
            self._trials += statement[1][-1]
        self._database.write(statement)

    def retract(self, server: str) -> None:
        """Delete a faulty server's outcomes of this round, and mark its earlier ones doubtful."""
        generation, round_ = self._generation, self._round
        if generation is None:  # the last round that was begun
            generation = self.resumed().generation
            round_ = self._value(
                "SELECT max(round) FROM outcomes WHERE generation = ?", generation
            )
            if self.meta("assessment"):
                generation, round_ = ASSESSMENT + 1, 0
        of, self._trials = (generation, round_ or 0, server), None
        self._database.write(
            (
                "DELETE FROM outcomes WHERE (generation, round) = (?, ?) AND server = ?",
                of,
            ),
            (
                "UPDATE outcomes SET doubtful = 1, digest = ~digest "
                "WHERE (generation, round) < (?, ?) AND server = ? AND doubtful = 0",
                of,
            ),
        )

    def begin_assessment(self, plan: str) -> None:
        """Drop what is recorded of an assessment with another plan, such as another budget."""
        if self.meta("assessing") != plan:
            sql = "DELETE FROM outcomes WHERE generation = ?"
            self._database.write((sql, (ASSESSMENT,)))
            self.set_meta("assessing", plan)

    def forget_others(self) -> int:
        """Delete this generation's outcomes of other candidates than its own; return how many."""
        of = (self._generation, self._asked)
        other = "FROM outcomes WHERE generation = ? AND asked <> ?"
        found = self._sum(f"sum(count) {other}", *of)
        self._database.write((f"DELETE {other}", of))
        self._trials = None
        return found

    def note(self, note: Note) -> None:
        """Add an event."""
        row, at = next(self._events), time.time()
        within = None if self._generation == ASSESSMENT else self._generation
        self._database.write(statements.event(note, row, within, at))

    def finish(
        self,
        generation: int,
        genomes: Sequence[bytes],
        fitness: np.ndarray,
        statistics: dict[str, float],
        state: Any,
        measures: np.ndarray | None = None,
    ) -> None:
        """Add a generation with the optimizer's state after it.

        Waits if the disk is more than 0.05 s behind, or the genomes are large.

        Args:
            fitness, measures: as the optimizer was told.
            state: plain values, or what ``pack`` returned; None: the optimizer was another
                program's, and the run cannot be resumed.
        """
        digests, history = self._digests_of(genomes), History(self._history)
        history.add_digests(digests, fitness, measures)
        packed = state
        if state is not None and not isinstance(state, PackedState):
            packed = self.pack(generation, genomes, state)
        large = sum(map(len, genomes)) > LARGE
        if large:
            self._database.write_once()
        self._database.write(
            *self._candidates(generation, genomes, digests, fitness, measures, packed),
            statements.generation_end(
                generation,
                len(genomes),
                statistics,
                history.value,
                self._trials_of(generation),
                time.time(),
            ),
            *([] if packed is None else statements.state(generation, packed)),
        )
        if large:  # they are not to be in memory until the next generation ends
            self._database.sync()
        else:
            self._database.pace()
        self._known = {} if packed is None else dict(packed.genomes)
        self._history = history.value

    def pack(self, generation: int, genomes: Sequence[bytes], state: Any) -> PackedState:
        """Pack the optimizer's state after a generation, for ``finish``."""
        dropped = self._drops(generation)
        places = {
            genome: (generation, at)
            for at, genome in enumerate(genomes)
            if not dropped or len(genome) > SHORT
        }
        return pack(state, self._known | places)

    def _candidates(
        self,
        generation: int,
        genomes: Sequence[bytes],
        digests: Sequence[bytes],
        fitness: np.ndarray,
        measures: np.ndarray | None,
        packed: PackedState | None,
    ) -> list[Statement]:
        """Return what adds a generation's candidates, and drops genomes that are not kept."""
        if self._keep == "all" or packed is None:
            return statements.candidates(generation, genomes, digests, fitness, measures)
        former = set(self._known.values()) | self._raced.places()
        self._raced.add(contenders.of_generation(generation, digests, fitness.tolist()))
        needed = set(packed.genomes.values()) | self._raced.places()
        kept: Sequence[bytes | None] = genomes
        if self._drops(generation):
            best = (generation, int(np.argsort(-fitness, kind="stable")[0]))  # NaN last
            needed.add(best)
            kept = [
                genome if (generation, at) in needed else None
                for at, genome in enumerate(genomes)
            ]
        return [
            *statements.candidates(generation, kept, digests, fitness, measures),
            *statements.dropped_genomes(
                place for place in sorted(former - needed) if self._drops(place[0])
            ),
        ]

    def _drops(self, generation: int) -> bool:
        """Return whether only some of a generation's genomes are kept."""
        return self._keep == "best" or (
            isinstance(self._keep, int) and generation % self._keep > 0
        )

    def _trials_of(self, generation: int) -> int:
        """Return the digest of a generation's outcomes."""
        if self._trials is not None and generation == self._generation:
            return total([self._trials])
        sql = "SELECT doubtful, digest FROM outcomes WHERE generation = ?"
        rows = self._database.rows(sql, generation)
        return total(~written if doubtful else written for doubtful, written in rows)

    def _digests_of(self, genomes: Sequence[bytes]) -> list[bytes]:
        if self._digests[0] is not genomes:
            self._digests = (genomes, [digest(genome) for genome in genomes])
        return self._digests[1]

    def check(self) -> None:
        """Report what happened to the disk; called when nothing else happens."""
        self._database.check()

    def champion(self, controller: Controller) -> None:
        """Replace the champion's file in one step, after what was recorded before."""
        content = msgspec.msgpack.encode(controller)
        self._database.write_file(self.folder / CHAMPION, content)

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
