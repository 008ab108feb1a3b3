"""What a run leaves on disk: a folder with the complete experiment, the record in SQLite, and the champion.

Finished means recorded: outcomes are committed at least every 0.1 s, a generation with the optimizer's state in one
transaction before it is told, each synced to the disk. What a full disk does not take waits in memory. The tables:
docs/record.md.
"""

import contextlib
import fcntl
import hashlib
import itertools
import json
import os
import platform
import secrets
import shutil
import sqlite3
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from importlib.metadata import version
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Self

import msgspec
import numpy as np

import zswarm
from zswarm import experiment
from zswarm.controller import CHAMPION, Controller
from zswarm.errors import ConfigError
from zswarm.experiment import Experiment
from zswarm.files import sync, write_whole
from zswarm.ot.database import Database, Statement, connect, in_words, on_network, passing, transact
from zswarm.ot.dispatch import Counted, Note
from zswarm.ot.history import History
from zswarm.ot.optimizers.optimizer import Told
from zswarm.ot.schema import CREATE, MIGRATIONS, SCHEMA_VERSION
from zswarm.ot.workload import Workload
from zswarm.protocol.codec import clean
from zswarm.strict import to_json

NOT_DECISIVE = ("generations", "cluster", "study")  # what of an experiment may change while it is run
DATABASE, EXPERIMENT = "run.sqlite", "experiment.toml"
RUNS = Path("runs")  # where runs are made unless --out says otherwise
LOCK_TRIES, LOCK_PAUSE_S = 20, 0.005  # who asks whether a run goes on holds its lock for an instant
SET_META = "INSERT OR REPLACE INTO meta VALUES (?, ?)"
ADD_OUTCOMES = "INSERT OR REPLACE INTO outcomes VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)"
ADD_EVENT = "INSERT OR REPLACE INTO events (rowid, at, generation, event, server, text, count) VALUES (?, ?, ?, ?, ?, ?, ?)"
ADD_CANDIDATES = "INSERT OR REPLACE INTO candidates VALUES "
A_CANDIDATE, CANDIDATES_AT_ONCE = "(?, ?, ?, ?, ?)", 199  # every SQLite takes 999 parameters in a statement
ADD_GENERATION = "INSERT OR REPLACE INTO generations VALUES (?, ?, ?, ?, ?, ?)"
SET_OPTIMIZER = "INSERT OR REPLACE INTO optimizer VALUES (0, ?, ?)"


class Resumed(NamedTuple):
    """Where a run goes on."""

    generation: int  # the first that is not finished
    state: Any  # of the optimizer, None before the first generation ended


class Record:
    """The folder of one run, open for writing; one program at a time."""

    def __init__(self, folder: Path, connection: sqlite3.Connection, lock: int) -> None:
        self.folder = folder
        self.say: Callable[[str], None] = _to_stderr  # a line for the user
        self.on_network = on_network(folder)
        self._database, self._lock = Database(folder / DATABASE, connection, self._tell), lock
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
        """A new folder ``parent/name``, or ``name-2`` and so on where that exists; by default named as the experiment.

        Args:
            metrics: names of the numbers that trials have beside fitness.
            meta: rows of that table, beside those that every run has.

        Raises:
            ConfigError: it cannot be written.
        """
        meta = {
            "schema_version": SCHEMA_VERSION,
            "zswarm": zswarm.__version__,
            "run_id": f"{complete.name[:54].strip('-')}-{secrets.token_hex(4)}",
            "version_hash": version_hash,
            "experiment": _decisive(complete),
            "epoch": 0,
            "created_at": time.time(),
            "machine": _machine(),
            **({} if metrics is None else {"metrics": json.dumps(list(metrics))}),
            **meta,
        }
        with contextlib.ExitStack() as undo:
            folder = new_folder(parent, name or complete.name)
            undo.callback(shutil.rmtree, folder, ignore_errors=True)
            lock = lock_folder(folder)
            undo.callback(os.close, lock)
            try:
                write_whole(folder / EXPERIMENT, experiment.to_toml(complete).encode())
                _create(folder / DATABASE, meta)
                record = cls(folder, connect(folder / DATABASE), lock)
            except (sqlite3.OperationalError, OSError) as error:
                why = in_words(error, parent)
                raise ConfigError(f"{folder}: cannot be written: {why}; choose another place with --out") from None
            undo.pop_all()
        return record

    @classmethod
    def open(cls, folder: Path) -> tuple[Self, Experiment]:
        """An existing run, to go on with; its epoch is raised, an older schema brought to this one.

        Raises:
            ConfigError: no run, damaged, of a newer schema, in use, or not to be written.
        """
        complete = load_experiment(folder)
        with contextlib.ExitStack() as undo:
            lock = lock_folder(folder)
            undo.callback(os.close, lock)
            try:
                connection = connect(folder / DATABASE)
                undo.callback(connection.close)
                _check(folder, connection, complete)
                _raise_epoch(connection, complete)
                record = cls(folder, connection, lock)
            except (sqlite3.DatabaseError, UnicodeDecodeError) as error:  # the latter: a damaged schema that SQLite would quote
                if passing(error, folder):
                    raise ConfigError(f"{folder}: cannot be written: {in_words(error, folder)}") from None
                what = clean(str(error))
                raise ConfigError(
                    f"{folder / DATABASE}: damaged: {what}; the experiment can be run anew from {folder / EXPERIMENT}"
                ) from None
            undo.pop_all()
        return record, complete

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Commit what is whole, if the disk takes it, and let others at the run; a second time nothing."""
        if self._lock < 0:
            return
        try:
            self._database.commit()
        except (sqlite3.OperationalError, OSError) as error:
            if not passing(error, self.folder):
                raise
            lost = sum(values[3] for sql, values in self._database.unwritten if sql == ADD_OUTCOMES)  # their column count
            self.say(f"{self.folder} cannot be written ({in_words(error, self.folder)}): resume evaluates {lost} trials again")
        finally:
            self._database.close()
            os.close(self._lock)
            self._lock = -1

    # ---- meta

    def meta(self, key: str) -> Any:
        """A value, None where there is none."""
        rows = self._database.rows("SELECT value FROM meta WHERE key = ?", key)
        return rows[0][0] if rows else None

    def set_meta(self, key: str, value: Any) -> None:
        """Set a value, synced."""
        self._database.settle((SET_META, (key, value)))

    def machine_changed(self) -> str:
        """What the run was made with, if that is not this machine's; "" if it is."""
        before = str(self.meta("machine"))
        return before if before != _machine() else ""

    # ---- writing

    def begin(self, generation: int, workload: Workload) -> None:
        """The outcomes that follow belong to this generation, and to this round of its games."""
        self._generation, self._round, self._asked = generation, workload.round, _digest(workload.genomes)

    def end(self) -> None:
        """All generations are finished; what follows belongs to none."""
        self._generation = None

    def add(self, counted: Counted, workload: Workload) -> None:
        """Outcomes as they come."""
        trials, participants = counted.trials, workload.participants[counted.trials]
        values = (
            next(self._outcomes),
            self._generation,
            self._asked,
            len(trials),
            (workload.first + trials).astype("<u4").tobytes(),
            workload.fitness[trials].astype("<f8").tobytes(),
            workload.metrics[trials].astype("<f8").tobytes(),
            int(workload.faulted[trials].sum()),
            counted.server,
            counted.seconds,
            time.time(),
            0,
            workload.round,
            participants.astype("<u4").tobytes() if participants.shape[1] > 1 else None,
        )
        self._database.write((ADD_OUTCOMES, values))

    def retract(self, server: str) -> None:
        """A server computes wrong: forget its outcomes of the begun round, mark those of earlier ones as doubtful."""
        begun = (self._generation, self._round)
        if self._generation is None:  # the last one that was begun before
            generation = self.resumed().generation
            rows = self._database.rows("SELECT coalesce(max(round), 0) FROM outcomes WHERE generation = ?", generation)
            begun = (generation, rows[0][0])
        self._database.write(
            ("DELETE FROM outcomes WHERE (generation, round) = (?, ?) AND server = ?", (*begun, server)),
            ("UPDATE outcomes SET doubtful = 1 WHERE (generation, round) < (?, ?) AND server = ?", (*begun, server)),
        )

    def note(self, note: Note) -> None:
        """Something that happened."""
        values = (next(self._events), time.time(), self._generation, note.event, note.server, note.text, note.count)
        self._database.write((ADD_EVENT, values))

    def finish(
        self,
        generation: int,
        genomes: Sequence[bytes],
        fitness: np.ndarray,
        statistics: dict[str, float],
        state: Any,
        measures: np.ndarray | None = None,
    ) -> None:
        """A generation and the optimizer's state after it, in one transaction; waits until the disk has it.

        Args:
            fitness, measures: as told to the optimizer; of measures, where it was told some.
            state: None: the optimizer was another program, and the run cannot be resumed.
        """
        best, mean = statistics["best"], statistics["mean"]
        told = itertools.repeat(None) if measures is None or not measures.size else map(bytes, measures.astype("<f8"))
        rows = [
            (generation, candidate, genome, value, measured)
            for candidate, (genome, value, measured) in enumerate(zip(genomes, fitness.tolist(), told, strict=False))
        ]
        whole: list[Statement] = []
        for begin in range(0, len(rows), CANDIDATES_AT_ONCE):
            part = rows[begin : begin + CANDIDATES_AT_ONCE]
            whole.append((ADD_CANDIDATES + ", ".join([A_CANDIDATE] * len(part)), tuple(itertools.chain.from_iterable(part))))
        whole.append((ADD_GENERATION, (generation, time.time(), best, mean, len(genomes), to_json(statistics))))
        if state is not None:
            whole.append((SET_OPTIMIZER, (generation, msgspec.msgpack.encode(state))))
        self._database.settle(*whole)

    def flush(self) -> None:
        """Commit if the last commit is 0.1 s ago; what the disk does not take now waits."""
        self._database.flush()

    def champion(self, controller: Controller) -> None:
        """Write the champion, whole or not at all."""
        self._database.insist(lambda: write_whole(self.folder / CHAMPION, msgspec.msgpack.encode(controller)))

    # ---- reading back

    def resumed(self) -> Resumed:
        """Where to go on."""
        rows = self._database.rows("SELECT generation, state FROM optimizer")
        try:
            return Resumed(rows[0][0] + 1, msgspec.msgpack.decode(rows[0][1])) if rows else Resumed(0, None)
        except (msgspec.DecodeError, UnicodeDecodeError, TypeError, RecursionError):
            raise ConfigError(f"{self.folder / DATABASE}: damaged: the optimizer's state cannot be read") from None

    def restore(self, workload: Workload) -> int:
        """Put the recorded outcomes of the begun round into its workload; how many trials.

        Raises:
            ConfigError: they are of other candidates or games: the code of the optimizer, representation or ranking was changed.
        """
        restored = 0
        for asked, trials, fitness, metrics, faulted, server, participants in self._database.rows(
            "SELECT asked, trials, fitness, metrics, faulted, server, participants FROM outcomes "
            "WHERE (generation, round) = (?, ?)",
            self._generation,
            self._round,
        ):
            indices = np.frombuffer(trials, "<u4").astype(np.int64) - workload.first
            games = None if participants is None else workload.participants[indices].astype("<u4").tobytes()
            if (asked, participants) != (self._asked, games):
                raise ConfigError(
                    f"{self.folder}: generation {self._generation} was begun with other candidates or games: this program "
                    "proposes differently than the one that began the run"
                )
            workload.fitness[indices] = np.frombuffer(fitness, "<f8").reshape(len(indices), -1)
            workload.metrics[indices] = np.frombuffer(metrics, "<f8").reshape(len(indices), workload.metrics.shape[1])
            workload.counted[indices], workload.source[indices] = True, server
            workload.faulted[indices] = bool(faulted)  # faulted trials are counted one by one
            restored += len(indices)
        return restored

    def forget_others(self) -> int:
        """Forget outcomes of the begun generation that are of other candidates than it has now; how many trials."""
        other = "FROM outcomes WHERE generation = ? AND asked <> ?"
        found = int(self._database.rows(f"SELECT coalesce(sum(count), 0) {other}", self._generation, self._asked)[0][0])
        self._database.write((f"DELETE {other}", (self._generation, self._asked)))
        return found

    def told(self) -> Iterator[Told]:
        """The finished generations, in order."""
        for (generation,) in self._database.rows("SELECT generation FROM generations ORDER BY generation"):
            rows = self._database.rows(
                "SELECT genome, fitness, measures FROM candidates WHERE generation = ? ORDER BY candidate", generation
            )
            fitness = np.array([np.nan if row[1] is None else row[1] for row in rows])
            measures = np.array([np.frombuffer(row[2] or b"", "<f8") for row in rows]).reshape(len(rows), -1 if rows else 0)
            yield Told([row[0] for row in rows], fitness, measures)

    def history(self) -> History:
        """The hash of all that was told so far."""
        history = History()
        for told in self.told():
            history.add(*told)
        return history

    def evaluations(self) -> int:
        """Candidates of the finished generations."""
        return int(self._database.rows("SELECT coalesce(sum(evaluations), 0) FROM generations")[0][0])

    def requeued(self) -> int:
        """Trials that were sent again, because a server did not answer for them."""
        return int(self._database.rows("SELECT coalesce(sum(count), 0) FROM events WHERE event = 'requeued'")[0][0])

    def faulted(self) -> int:
        """Trials that were counted as faults."""
        return int(self._database.rows("SELECT coalesce(sum(faulted), 0) FROM outcomes")[0][0])

    def doubtful(self) -> int:
        """Trials of earlier generations whose server was later proved to compute wrong."""
        return int(self._database.rows("SELECT coalesce(sum(count), 0) FROM outcomes WHERE doubtful")[0][0])

    def _tell(self, line: str, waited_s: float | None) -> None:
        """The disk takes nothing, or data again after so long."""
        self.say(line)
        if waited_s is not None:
            self.note(Note("disk_waited", count=round(waited_s)))


def load_experiment(folder: Path) -> Experiment:
    """The experiment of a run's folder.

    Raises:
        ConfigError: no run there.
    """
    if not folder.is_dir() or not (folder / EXPERIMENT).is_file() or not (folder / DATABASE).is_file():
        raise ConfigError(f"{folder}: no run{meant(folder)}; expected a folder with {EXPERIMENT} and {DATABASE}")
    return experiment.complete(experiment.load(folder / EXPERIMENT), str(folder / EXPERIMENT))


def meant(folder: Path) -> str:
    """A hint where the folder of that name below ``runs`` is there."""
    below = RUNS / folder
    there = folder != below and not folder.exists() and (below / EXPERIMENT).is_file()
    return f" (did you mean {clean(str(below))}?)" if there else ""


def new_folder(parent: Path, name: str) -> Path:
    """Make a folder of that name, or ``name-2`` and so on where it exists.

    Raises:
        ConfigError: it cannot be made.
    """
    for number in range(1, 100_000):
        folder = parent / (name if number == 1 else f"{name}-{number}")
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            continue
        except OSError as error:
            raise ConfigError(f"{folder}: cannot be made: {error.strerror}; choose another place with --out") from None
        return folder
    raise ConfigError(f"{parent}: too many runs of the name {name}")


def lock_folder(folder: Path, what: str = "run") -> int:
    """The descriptor that keeps other programs out until it is closed.

    Raises:
        ConfigError: another program is at it, or the folder cannot be written.
    """
    try:
        lock = os.open(folder / "lock", os.O_CREAT | os.O_RDWR, 0o644)
    except OSError as error:
        raise ConfigError(f"{folder}: cannot be written: {error.strerror}") from None
    for tries in reversed(range(LOCK_TRIES)):
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            if tries:
                time.sleep(LOCK_PAUSE_S)
                continue
            os.close(lock)
            raise ConfigError(f"{folder}: another zswarm-ot is at this {what}; stop it first") from None
        break
    return lock


def _create(path: Path, meta: dict[str, Any]) -> None:
    """A new record, there as a whole or not at all."""
    part = path.with_suffix(".part")
    connection = sqlite3.connect(part, isolation_level=None)
    try:
        connection.executescript(f"BEGIN; {CREATE} COMMIT")
        transact(connection, [(SET_META, item) for item in meta.items()])
    finally:
        connection.close()
    part.replace(path)
    sync(path.parent)


def _check(folder: Path, connection: sqlite3.Connection, complete: Experiment) -> None:
    meta = dict(connection.execute("SELECT key, value FROM meta").fetchall())
    found = meta.get("schema_version")
    if found != SCHEMA_VERSION and found not in MIGRATIONS:
        version, program = clean(str(found)), clean(str(meta.get("zswarm")))
        raise ConfigError(
            f"{folder / DATABASE}: has schema {version}, of zswarm {program}; this zswarm {zswarm.__version__} knows "
            f"schemas up to {SCHEMA_VERSION}: go on with the zswarm that made it, or a newer one"
        )
    if not isinstance(meta.get("experiment"), str) or not isinstance(meta.get("epoch"), int):
        raise ConfigError(f"{folder / DATABASE}: damaged: it does not say what was run")
    if "imported_from" in meta:
        raise ConfigError(
            f"{folder}: was imported, without a state of the optimizer to go on from; its experiment can be run anew from "
            f"{folder / EXPERIMENT}"
        )
    state = connection.execute("PRAGMA quick_check").fetchone()[0]
    if state != "ok":
        what = clean(str(state).removeprefix("*** in database main ***\n").partition("\n")[0])
        raise ConfigError(f"{folder / DATABASE}: damaged: {what}")
    if (began := meta["experiment"]) != (now := _decisive(complete)):
        try:
            before = dict(json.loads(began))
        except (ValueError, TypeError, RecursionError):
            raise ConfigError(f"{folder / DATABASE}: damaged: it does not say what was run") from None
        after = json.loads(now)
        keys = [key for key in sorted(before | after) if before.get(key) != after.get(key)]
        raise ConfigError(
            f"{folder / EXPERIMENT}: {', '.join(keys)} changed since the run began; only generations and [cluster] may"
        )


def _raise_epoch(connection: sqlite3.Connection, complete: Experiment) -> None:
    """For a program that goes on; with it come the schema of this one, and no hash of fewer generations."""
    meta = dict(connection.execute("SELECT key, value FROM meta").fetchall())
    finished = connection.execute("SELECT count(*) FROM generations").fetchone()[0]
    changes: list[Statement] = [
        (statement, ()) for version in range(meta["schema_version"], SCHEMA_VERSION) for statement in MIGRATIONS[version]
    ]
    changes += [(SET_META, ("schema_version", SCHEMA_VERSION)), (SET_META, ("epoch", int(meta["epoch"]) + 1))]
    if finished < complete.generations:
        changes.append(("DELETE FROM meta WHERE key = 'history_hash'", ()))
    transact(connection, changes)


def _first_free(connection: sqlite3.Connection, table: str) -> int:
    return int(connection.execute(f"SELECT coalesce(max(rowid), 0) + 1 FROM {table}").fetchone()[0])  # noqa: S608  our own name


def _to_stderr(text: str) -> None:
    sys.stderr.write(text + "\n")


def _digest(genomes: Sequence[bytes]) -> bytes:
    return hashlib.blake2b(b"".join(genomes), digest_size=8).digest()


def _decisive(complete: Experiment) -> str:
    """What of an experiment the history depends on."""
    values = msgspec.to_builtins(complete)
    if complete.ranking.kind == experiment.ABSOLUTE:  # as if there were no others, which older records do not know
        del values["ranking"]
    return json.dumps({key: value for key, value in values.items() if key not in NOT_DECISIVE}, sort_keys=True)


def _machine() -> str:
    """What can change the bits of linear algebra."""
    config: Any = np.show_config(mode="dicts")
    blas = config["Build Dependencies"]["blas"]
    return f"{_processor()}, numpy {version('numpy')}, {blas.get('name', 'no BLAS')} {blas.get('version', '')}".strip()


def _processor() -> str:
    with contextlib.suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()
