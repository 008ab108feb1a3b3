"""What a run leaves on disk: a folder with the complete experiment, the record in SQLite, and the champion.

Finished means recorded: outcomes are committed at least every 0.1 s, a generation with the optimizer's state in one
transaction, each synced to the disk. The tables: docs/record.md.
"""

import contextlib
import fcntl
import hashlib
import json
import math
import os
import platform
import secrets
import sqlite3
import time
from collections.abc import Iterator, Sequence
from importlib.metadata import version
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, NamedTuple, Self

import msgspec
import numpy as np

import zswarm
from zswarm import experiment
from zswarm.errors import ConfigError
from zswarm.experiment import Experiment
from zswarm.ot.dispatch import Counted, Note, Workload

SCHEMA_VERSION = 1
COMMIT_S = 0.1
NETWORK_FILE_SYSTEMS = {
    "nfs",
    "nfs4",
    "cifs",
    "smb3",
    "smbfs",
    "9p",
    "afs",
    "ceph",
    "glusterfs",
    "lustre",
    "fuse.sshfs",
}
DATABASE, EXPERIMENT, CHAMPION = "run.sqlite", "experiment.toml", "champion.zsc"

SCHEMA = """
CREATE TABLE meta (key TEXT PRIMARY KEY, value) WITHOUT ROWID;
CREATE TABLE generations (
    generation INTEGER PRIMARY KEY, finished_at REAL NOT NULL, best REAL, mean REAL, evaluations INTEGER NOT NULL,
    statistics TEXT NOT NULL);
CREATE TABLE candidates (
    generation INTEGER NOT NULL, candidate INTEGER NOT NULL, genome BLOB NOT NULL, fitness REAL,
    PRIMARY KEY (generation, candidate)) WITHOUT ROWID;
CREATE TABLE outcomes (
    id INTEGER PRIMARY KEY, generation INTEGER NOT NULL, asked BLOB NOT NULL, count INTEGER NOT NULL, trials BLOB NOT NULL,
    fitness BLOB NOT NULL, metrics BLOB NOT NULL, faulted INTEGER NOT NULL, server TEXT NOT NULL, seconds REAL NOT NULL,
    at REAL NOT NULL);
CREATE TABLE events (at REAL NOT NULL, generation INTEGER, event TEXT NOT NULL, server TEXT, text TEXT, count INTEGER);
CREATE TABLE optimizer (id INTEGER PRIMARY KEY CHECK (id = 0), generation INTEGER NOT NULL, state BLOB NOT NULL);
CREATE VIEW servers AS
    SELECT server, sum(count) AS trials, sum(seconds) AS seconds, min(at) AS first_at, max(at) AS last_at
    FROM outcomes WHERE server <> '' GROUP BY server;
"""


class Controller(msgspec.Struct, frozen=True, kw_only=True, tag="zswarm-controller", tag_field="format"):
    """The file ``champion.zsc``: all that another program needs to run the controller."""

    version: Literal[1] = 1
    simulator: str
    simulator_settings: dict[str, Any]
    representation: str
    representation_settings: dict[str, Any]
    inputs: int
    outputs: int
    sensors: list[str]
    actuators: list[str]
    genome: bytes
    fitness: float
    run: str


class Resumed(NamedTuple):
    """Where a run goes on."""

    generation: int  # the first that is not finished
    state: Any  # of the optimizer, None before the first generation ended


class Record:
    """The folder of one run, open for writing; one program at a time."""

    def __init__(self, folder: Path, database: sqlite3.Connection, lock: int) -> None:
        self.folder = folder
        self._database, self._lock = database, lock
        self.on_network = on_network(folder)
        self._last_commit = time.monotonic()
        self._generation: int | None = None
        self._asked = b""

    @classmethod
    def create(cls, parent: Path, complete: Experiment, version_hash: str) -> Self:
        """A new folder ``parent/name``, or ``name-2`` and so on where that exists."""
        folder = _new_folder(parent, complete.name)
        lock = _lock(folder)
        (folder / EXPERIMENT).write_text(experiment.to_toml(complete), encoding="utf-8")
        database = _open(folder / DATABASE)
        database.executescript(SCHEMA)
        meta: dict[str, Any] = {
            "schema_version": SCHEMA_VERSION,
            "zswarm": zswarm.__version__,
            "run_id": f"{complete.name[:54].strip('-')}-{secrets.token_hex(4)}",
            "version_hash": version_hash,
            "experiment": _decisive(complete),
            "epoch": 0,
            "created_at": time.time(),
        }
        database.execute("BEGIN")
        database.executemany("INSERT INTO meta VALUES (?, ?)", meta.items())
        database.execute("COMMIT")
        record = cls(folder, database, lock)
        record.set_meta("machine", _machine())
        return record

    @classmethod
    def open(cls, folder: Path) -> tuple[Self, Experiment]:
        """An existing run, to go on with; its epoch is raised.

        Raises:
            ConfigError: no run, damaged, of another schema, or in use.
        """
        complete = load_experiment(folder)
        lock = _lock(folder)
        try:
            database = _open(folder / DATABASE)
            record = cls(folder, database, lock)
            record._check(complete)
            record.set_meta("epoch", int(record.meta("epoch")) + 1)
        except sqlite3.DatabaseError as error:
            os.close(lock)
            raise ConfigError(
                f"{folder / DATABASE}: damaged: {error}; the experiment can be run anew from {folder / EXPERIMENT}"
            ) from None
        except ConfigError:
            os.close(lock)
            raise
        return record, complete

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Commit what is whole and let others at the run; a second time nothing."""
        if self._lock < 0:
            return
        self._commit()
        self._database.close()
        os.close(self._lock)
        self._lock = -1

    # ---- meta

    def meta(self, key: str) -> Any:
        """A value, None where there is none."""
        row = self._database.execute("SELECT value FROM meta WHERE key = ?", (key,)).fetchone()
        return row[0] if row else None

    def set_meta(self, key: str, value: Any) -> None:
        """Set a value, synced."""
        self._begin()
        self._database.execute("INSERT OR REPLACE INTO meta VALUES (?, ?)", (key, value))
        self._commit()

    def machine_changed(self) -> str:
        """What the run was made with, if that is not this machine's; "" if it is."""
        before = str(self.meta("machine"))
        return before if before != _machine() else ""

    # ---- writing

    def begin(self, generation: int, workload: Workload) -> None:
        """The outcomes that follow belong to this generation."""
        self._generation, self._asked = generation, _digest(workload.genomes)

    def add(self, counted: Counted, workload: Workload) -> None:
        """Outcomes as they come."""
        trials = counted.trials
        self._begin()
        self._database.execute(
            "INSERT INTO outcomes (generation, asked, count, trials, fitness, metrics, faulted, server, seconds, at) "
            "VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
            (
                self._generation,
                self._asked,
                len(trials),
                trials.astype("<u4").tobytes(),
                workload.fitness[trials].astype("<f8").tobytes(),
                workload.metrics[trials].astype("<f8").tobytes(),
                int(workload.faulted[trials].sum()),
                counted.server,
                counted.seconds,
                time.time(),
            ),
        )
        self.flush()

    def note(self, note: Note) -> None:
        """Something that happened."""
        self._begin()
        self._database.execute(
            "INSERT INTO events VALUES (?, ?, ?, ?, ?, ?)",
            (time.time(), self._generation, note.event, note.server, note.text, note.count),
        )
        self.flush()

    def finish(
        self, generation: int, genomes: Sequence[bytes], fitness: np.ndarray, statistics: dict[str, float], state: Any
    ) -> None:
        """A generation and the optimizer's state after it, in one transaction."""
        rows = zip(genomes, fitness.tolist(), strict=True)
        self._begin()
        self._database.execute("SAVEPOINT finish")
        try:
            self._database.executemany(
                "INSERT INTO candidates VALUES (?, ?, ?, ?)",
                [(generation, candidate, genome, value) for candidate, (genome, value) in enumerate(rows)],
            )
            self._database.execute(
                "INSERT INTO generations VALUES (?, ?, ?, ?, ?, ?)",
                (generation, time.time(), statistics["best"], statistics["mean"], len(genomes), to_json(statistics)),
            )
            self._database.execute(
                "INSERT OR REPLACE INTO optimizer VALUES (0, ?, ?)", (generation, msgspec.msgpack.encode(state))
            )
        except BaseException:  # Ctrl-C too: half a generation must not be committed on the way out
            self._database.execute("ROLLBACK TO finish")
            raise
        self.flush()

    def flush(self) -> None:
        """Commit if the last commit is 0.1 s ago."""
        if time.monotonic() - self._last_commit >= COMMIT_S:
            self._commit()

    def champion(self, controller: Controller) -> None:
        """Write the champion, whole or not at all."""
        path = self.folder / CHAMPION
        part = path.with_suffix(".part")
        part.write_bytes(msgspec.msgpack.encode(controller))
        part.replace(path)

    # ---- reading back

    def resumed(self) -> Resumed:
        """Where to go on."""
        row = self._database.execute("SELECT generation, state FROM optimizer").fetchone()
        return Resumed(row[0] + 1, msgspec.msgpack.decode(row[1])) if row else Resumed(0, None)

    def restore(self, workload: Workload) -> int:
        """Put the recorded outcomes of the begun generation into a workload; how many trials.

        Raises:
            ConfigError: they are of other candidates: the code of the optimizer or representation was changed.
        """
        restored = 0
        for asked, trials, fitness, metrics, faulted in self._database.execute(
            "SELECT asked, trials, fitness, metrics, faulted FROM outcomes WHERE generation = ?", (self._generation,)
        ):
            if asked != self._asked:
                raise ConfigError(
                    f"{self.folder}: generation {self._generation} was begun with other candidates: this program proposes "
                    "differently than the one that began the run"
                )
            indices = np.frombuffer(trials, "<u4").astype(np.int64)
            workload.fitness[indices] = np.frombuffer(fitness, "<f8").reshape(len(indices), -1)
            workload.metrics[indices] = np.frombuffer(metrics, "<f8").reshape(len(indices), workload.metrics.shape[1])
            workload.counted[indices] = True
            workload.faulted[indices] = bool(faulted)  # faulted trials are counted one by one
            restored += len(indices)
        return restored

    def history(self) -> "History":
        """The hash of all that was told so far."""
        history = History()
        for generation in self._generations():
            rows = self._database.execute(
                "SELECT genome, fitness FROM candidates WHERE generation = ? ORDER BY candidate", (generation,)
            ).fetchall()
            history.add([row[0] for row in rows], np.array([np.nan if row[1] is None else row[1] for row in rows]))
        return history

    def evaluations(self) -> int:
        """Candidates of the finished generations."""
        return int(self._database.execute("SELECT coalesce(sum(evaluations), 0) FROM generations").fetchone()[0])

    def requeued(self) -> int:
        """Trials that were sent again, because a server did not answer for them."""
        return int(self._database.execute("SELECT coalesce(sum(count), 0) FROM events WHERE event = 'requeued'").fetchone()[0])

    def faulted(self) -> int:
        """Trials that were counted as faults."""
        return int(self._database.execute("SELECT coalesce(sum(faulted), 0) FROM outcomes").fetchone()[0])

    def _generations(self) -> Iterator[int]:
        for (generation,) in self._database.execute("SELECT generation FROM generations ORDER BY generation").fetchall():
            yield generation

    def _check(self, complete: Experiment) -> None:
        found = self.meta("schema_version")
        if found != SCHEMA_VERSION:
            raise ConfigError(f"{self.folder / DATABASE}: has schema {found}; this program reads schema {SCHEMA_VERSION}")
        state = self._database.execute("PRAGMA quick_check").fetchone()[0]
        if state != "ok":
            raise ConfigError(f"{self.folder / DATABASE}: damaged: {state}")
        if (began := self.meta("experiment")) != (now := _decisive(complete)):
            keys = [key for key, value in json.loads(now).items() if json.loads(began).get(key) != value]
            raise ConfigError(
                f"{self.folder / EXPERIMENT}: {', '.join(keys)} changed since the run began; only generations and [cluster] may"
            )

    def _begin(self) -> None:
        if not self._database.in_transaction:
            self._database.execute("BEGIN IMMEDIATE")

    def _commit(self) -> None:
        if self._database.in_transaction:
            self._database.execute("COMMIT")
        self._last_commit = time.monotonic()


def to_json(values: dict[str, Any]) -> str:
    """One line; numbers that JSON does not have become null."""
    return json.dumps(
        {key: None if isinstance(item, float) and not math.isfinite(item) else item for key, item in values.items()}
    )


class History:
    """The history hash: BLAKE2b over each generation's genomes and the numbers told (little-endian float64)."""

    def __init__(self) -> None:
        self._total = hashlib.blake2b(digest_size=16)

    def add(self, genomes: Sequence[bytes], fitness: np.ndarray) -> None:
        """The next generation."""
        for genome in genomes:
            self._total.update(genome)
        self._total.update(fitness.astype("<f8").tobytes())

    def hex(self) -> str:
        """32 hex digits."""
        return self._total.hexdigest()


def load_experiment(folder: Path) -> Experiment:
    """The experiment of a run's folder.

    Raises:
        ConfigError: no run there.
    """
    if not folder.is_dir() or not (folder / EXPERIMENT).is_file() or not (folder / DATABASE).is_file():
        raise ConfigError(f"{folder}: no run; expected a folder with {EXPERIMENT} and {DATABASE}, such as runs/emergency-exit")
    return experiment.complete(experiment.load(folder / EXPERIMENT), str(folder / EXPERIMENT))


def load_controller(path: Path) -> Controller:
    """A champion's file, or that of a run's folder.

    Raises:
        ConfigError: missing or damaged.
    """
    file = path / CHAMPION if path.is_dir() else path
    try:
        return msgspec.msgpack.decode(file.read_bytes(), type=Controller)
    except OSError as error:
        raise ConfigError(f"{file}: cannot be read: {error.strerror}; expected a run's folder or its {CHAMPION}") from None
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"{file}: damaged, or no controller: {error}") from None


def runs(parent: Path) -> list[dict[str, Any]]:
    """What is known of each run below a folder, read without disturbing it."""
    found: list[dict[str, Any]] = []
    for path in sorted(parent.glob(f"*/{DATABASE}")):
        try:
            database = sqlite3.connect(f"file:{path}?mode=ro", uri=True)
            row = database.execute("SELECT count(*), max(best), sum(evaluations), max(finished_at) FROM generations").fetchone()
            status = database.execute("SELECT value FROM meta WHERE key = 'history_hash'").fetchone()
            database.close()
        except sqlite3.DatabaseError as error:
            found.append({"run": str(path.parent), "error": f"damaged: {error}"})
            continue
        found.append(
            {
                "run": str(path.parent),
                "generations": row[0],
                "best": row[1],
                "candidates": row[2] or 0,
                "finished_at": row[3],
                "history_hash": status[0] if status else None,
            }
        )
    return found


def _new_folder(parent: Path, name: str) -> Path:
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


def _lock(folder: Path) -> int:
    try:
        lock = os.open(folder / "lock", os.O_CREAT | os.O_RDWR, 0o644)
    except OSError as error:
        raise ConfigError(f"{folder}: cannot be written: {error.strerror}") from None
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(lock)
        raise ConfigError(f"{folder}: another zswarm-ot is at this run; stop it first") from None
    return lock


def _open(path: Path) -> sqlite3.Connection:
    database = sqlite3.connect(path, isolation_level=None, timeout=10.0)
    if on_network(path):
        database.execute("PRAGMA journal_mode = DELETE")  # WAL needs memory shared between all that open the file
    else:
        database.execute("PRAGMA journal_mode = WAL")
    database.execute("PRAGMA synchronous = FULL")
    return database


def on_network(path: Path) -> bool:
    """Whether a path lies on a network file system (where Linux tells)."""
    try:
        mounts = [line.split() for line in Path("/proc/self/mounts").read_text().splitlines()]
    except OSError:
        return False
    inside = [mount for mount in mounts if path.resolve().is_relative_to(mount[1])]
    return bool(inside) and max(inside, key=lambda mount: len(mount[1]))[2] in NETWORK_FILE_SYSTEMS


def _digest(genomes: Sequence[bytes]) -> bytes:
    return hashlib.blake2b(b"".join(genomes), digest_size=8).digest()


def _decisive(complete: Experiment) -> str:
    """What of an experiment the history depends on."""
    values = msgspec.to_builtins(complete)
    return json.dumps({key: value for key, value in values.items() if key not in ("generations", "cluster")}, sort_keys=True)


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
