"""Recorded runs, read by whoever wants to know: nothing is written, also while a run goes on (docs/record.md).

What a record says comes from somewhere else: its types are checked, and its texts are safe to show.
"""

import contextlib
import fcntl
import html
import json
import os
import re
import shutil
import sqlite3
import tempfile
from collections.abc import Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import msgspec
import numpy as np

import zswarm
from zswarm import experiment, plugins
from zswarm.controller import CHAMPION, Controller, load_controller
from zswarm.errors import ConfigError, UnknownPlugin
from zswarm.experiment import Experiment
from zswarm.extras import need
from zswarm.ot.database import in_words, passing
from zswarm.ot.logger import Result
from zswarm.ot.record import DATABASE, EXPERIMENT, meant
from zswarm.ot.schema import SCHEMA_VERSION, TABLES
from zswarm.protocol.codec import clean

if TYPE_CHECKING:
    import pandas
    import polars
    from matplotlib.figure import Figure

    from zswarm.ot.curves import Axis
    from zswarm.ot.figures import Size

DEPTH = 2  # of folders in which runs are looked for: runs/STUDY/RUN
NESTED = 32  # levels of a text's tables and lists
WAL = b"\x02\x02"  # bytes 18 and 19 of a database with a write-ahead log

UNREADABLE = (sqlite3.Error, OSError, UnicodeDecodeError)  # the last: a damaged schema that SQLite would quote

T = TypeVar("T")


class Run:
    """A run's folder, read-only: finished, stopped or going on, in a folder that cannot be written, of every schema so far.

    Attributes:
        folder: as given.
        name: of the folder, safe to show.
        meta: the table, texts safe to show.
    """

    def __init__(self, folder: Path) -> None:
        """Look whether it can be read.

        Raises:
            ConfigError: no run, damaged, truncated, or of a newer schema.
        """
        self.folder, self.name = folder, clean(folder.name or folder.resolve().name)
        self._shown = clean(str(folder))
        if not _is_file(folder / EXPERIMENT) or not _is_file(folder / DATABASE):
            raise ConfigError(f"{self._shown}: no run{meant(folder)}; expected a folder with {EXPERIMENT} and {DATABASE}")
        self._meta = dict(self.rows("SELECT key, value FROM meta", tuple[str, Any]))
        self.meta = {
            clean(key): clean(value) if isinstance(value, str) and not _plain(value) else value
            for key, value in self._meta.items()
        }
        version = self.meta.get("schema_version")
        if not isinstance(version, int) or version < 1:
            raise ConfigError(f"{self._shown}/{DATABASE}: damaged: it names no schema")
        if version > SCHEMA_VERSION:
            raise ConfigError(
                f"{self._shown}/{DATABASE}: has schema {version}, of zswarm {self.meta.get('zswarm')}; this zswarm "
                f"{zswarm.__version__} reads schemas up to {SCHEMA_VERSION}: read it with the zswarm that made it, or a newer one"
            )

    def __repr__(self) -> str:
        return f"Run({self._shown!r})"

    # ---- the whole

    @cached_property
    def experiment(self) -> Experiment:
        """What was run, every default written out; no part of it is imported. Its texts are safe to show.

        What the history depends on is as it was when the run began, ``generations`` and ``[cluster]`` are the file's of today.

        Raises:
            ConfigError: the file or the record is damaged.
        """
        file = experiment.load(self.folder / EXPERIMENT)
        began = self._began
        mapping = {
            **began,
            **{part: {**began[part]["settings"], "kind": began[part]["kind"]} for part in experiment.PARTS},
            "generations": file.generations,
            "cluster": _cleaned(msgspec.to_builtins(file.cluster)),
        }
        return experiment.check(mapping, f"{self._shown}/{DATABASE}")

    @property
    def changed(self) -> list[str]:
        """Keys of ``experiment.toml`` that were changed since the run began: the record is of the experiment before.

        Raises:
            ConfigError: as ``experiment``.
        """
        file = experiment.load(self.folder / EXPERIMENT)
        try:
            now = _cleaned(msgspec.to_builtins(file))
        except RecursionError as error:
            raise ConfigError(f"{self._shown}/{EXPERIMENT}: {error}") from None
        return sorted(key for key, value in self._began.items() if now.get(key) != value)

    @property
    def history_hash(self) -> str | None:
        """Of all that was told, once the run is finished."""
        value = self.meta.get("history_hash")
        return value if isinstance(value, str) else None

    @property
    def finished(self) -> bool:
        """Whether the last generation is over, and nothing was added since."""
        return self.history_hash is not None

    @property
    def relative(self) -> bool:
        """Whether fitness is a score, which compares candidates of one generation only."""
        return bool(self.meta.get("relative"))

    @property
    def going_on(self) -> bool:
        """Whether a program is at it now."""
        return goes_on(self.folder)

    # ---- what it recorded

    def history(self) -> list[dict[str, Any]]:
        """Per finished generation: generation, finished_at, seconds, best, mean, evaluations and statistics.

        ``seconds`` are those since the generation before, or since the run began; ``best`` and ``evaluations`` are of all
        generations so far; where fitness is ``relative``, ``best`` is of the generation.
        """
        before, evaluations, history = self.meta.get("created_at"), 0, []
        for generation, at, best, mean, count, statistics in self.rows(
            "SELECT generation, finished_at, best, mean, evaluations, statistics FROM generations ORDER BY generation",
            tuple[int, float, float | None, float | None, int, str],
        ):
            evaluations += count
            history.append(
                {
                    "generation": generation,
                    "finished_at": at,
                    "seconds": at - before if isinstance(before, (int, float)) else None,
                    "best": best,
                    "mean": mean,
                    "evaluations": evaluations,
                    "statistics": self._statistics(statistics),
                }
            )
            before = at
        return history

    def generations(self) -> int:
        """Finished ones."""
        return self.rows("SELECT count(*) FROM generations", tuple[int])[0][0]

    def best(self) -> float | None:
        """The best fitness so far; where it is ``relative``, the best score of the last generation."""
        last = " WHERE generation = (SELECT max(generation) FROM generations)" if self.relative else ""
        return self.rows(f"SELECT max(best) FROM generations{last}", tuple[float | None])[0][0]  # noqa: S608  our own words

    def events(self) -> list[dict[str, Any]]:
        """What happened besides, in that order: the columns of the table."""
        columns = ("at", "generation", "event", "server", "text", "count")
        rows = self.rows(
            f"SELECT {', '.join(columns)} FROM events ORDER BY rowid",  # noqa: S608  our own names
            tuple[float, int | None, str, str | None, str | None, int | None],
        )
        return [dict(zip(columns, map(_clean, row), strict=True)) for row in rows]

    def servers(self) -> list[dict[str, Any]]:
        """What each server did, who did most first: the columns of the view."""
        columns = ("server", "trials", "seconds", "first_at", "last_at")
        rows = self.rows(
            "SELECT server, sum(count), sum(seconds), min(at), max(at) FROM outcomes WHERE server <> '' "
            "GROUP BY server ORDER BY 2 DESC, 1",
            tuple[str, int, float, float, float],
        )
        return [dict(zip(columns, map(_clean, row), strict=True)) for row in rows]

    def marked(self) -> tuple[int, int]:
        """Trials that were counted as faults, and those whose server was later proved to compute wrong."""
        doubtful = "0" if self.meta["schema_version"] == 1 else "doubtful"  # schema 1 does not know them
        sums = f"coalesce(sum(faulted), 0), coalesce(sum(count * ({doubtful} <> 0)), 0)"
        return self.rows(f"SELECT {sums} FROM outcomes", tuple[int, int])[0]  # noqa: S608  our own words

    def candidates(self, generation: int) -> list[dict[str, Any]]:
        """Those of a finished generation, in the order asked: candidate, genome (bytes), fitness and measures (a list).

        Fitness and measures are as told to the optimizer; NaN is None. Where it wants no measures the list is empty.
        """
        measures = "NULL" if self.meta["schema_version"] in (1, 2, 3) else "measures"  # these do not know them
        rows = self.rows(
            f"SELECT candidate, genome, fitness, {measures} FROM candidates WHERE generation = ? ORDER BY candidate",  # noqa: S608  our own words
            tuple[int, bytes, float | None, bytes | None],
            generation,
        )
        try:
            told = [[_number(value) for value in np.frombuffer(row[3] or b"", "<f8").tolist()] for row in rows]
        except ValueError:
            raise self._damaged(f"measures of generation {generation} are no numbers") from None
        names = ("candidate", "genome", "fitness", "measures")
        return [dict(zip(names, (*row[:3], measured), strict=True)) for row, measured in zip(rows, told, strict=True)]

    def trials(self, generation: int) -> list[dict[str, Any]]:
        """Those counted of a generation, in order: candidate, trial, fitness (a list, by participant), metrics (by name), server.

        Of the generation that runs, too. NaN is None. Where candidates play each other there is instead of candidate: game, and
        candidates, those that played it, in the order of fitness.
        """
        each, found = self.experiment.problem.trials, []
        players = "NULL" if self.meta["schema_version"] in (1, 2, 3) else "participants"  # these do not know them
        for count, trials, fitness, metrics, server, participants in self.rows(
            f"SELECT count, trials, fitness, metrics, server, {players} FROM outcomes WHERE generation = ? ORDER BY id",  # noqa: S608  our own words
            tuple[int, bytes, bytes, bytes, str, bytes | None],
            generation,
        ):
            try:
                indices = np.frombuffer(trials, "<u4").reshape(count)
                told = np.frombuffer(fitness, "<f8").reshape(count, -1)
                measured = np.frombuffer(metrics, "<f8").reshape(count, -1)
                played = None if participants is None else np.frombuffer(participants, "<u4").reshape(told.shape).tolist()
            except ValueError:
                raise self._damaged(f"outcomes of generation {generation} do not fit together") from None
            names = self._metrics(measured.shape[1])
            for row, (index, one, values) in enumerate(zip(indices.tolist(), told.tolist(), measured.tolist(), strict=True)):
                alone = {"candidate": index // each}
                found.append(
                    {
                        **(alone if played is None else {"game": index // each, "candidates": played[row]}),
                        "trial": index % each,
                        "fitness": [_number(value) for value in one],
                        "metrics": {name: _number(value) for name, value in zip(names, values, strict=True)},
                        "server": clean(server),
                    }
                )
        return sorted(found, key=lambda trial: (trial["game" if "game" in trial else "candidate"], trial["trial"]))

    def champion(self) -> Controller | None:
        """The best controller so far, its texts safe to show; None before there is one.

        Raises:
            ConfigError: its file is damaged.
        """
        if not _is_file(self.folder / CHAMPION):
            return None
        champion = load_controller(self.folder)
        names = ("simulator", "simulator_settings", "representation", "representation_settings", "sensors", "actuators", "run")
        try:
            return msgspec.structs.replace(champion, **{name: _cleaned(getattr(champion, name)) for name in names})
        except RecursionError as error:
            raise ConfigError(f"{self._shown}/{CHAMPION}: damaged: {error}") from None

    # ---- for notebooks

    def to_pandas(self) -> "pandas.DataFrame":
        """The history, a row per finished generation; the optimizer's statistics are columns, too.

        Raises:
            ConfigError: pandas is missing.
        """
        frame: pandas.DataFrame = need("pandas", "data", "to_pandas").DataFrame(self._table())
        return frame

    def to_polars(self) -> "polars.DataFrame":
        """As ``to_pandas``.

        Raises:
            ConfigError: polars is missing.
        """
        frame: polars.DataFrame = need("polars", "data", "to_polars").DataFrame(self._table(), infer_schema_length=None)
        return frame

    def plot(self, x: "Axis" = "generation", size: "Size" = "column", title: str = "", lowest: float | None = None) -> "Figure":
        """The learning curve, as a figure of matplotlib that a notebook shows.

        Args:
            x: along the horizontal axis: "generation", "evaluations" or "time".
            size: "column" or "page" of a paper, or "slides".
            title: above it.
            lowest: fitness on the vertical axis; None: all that there is.

        Raises:
            ConfigError: no generation is finished, none reaches ``lowest``, or matplotlib is missing.
            ValueError: another x or size.

        Example::

            zswarm.read("runs/stadium").plot().savefig("stadium.pdf")
        """
        from zswarm.ot import figures

        return figures.for_notebooks(figures.of_runs({self.name: [self]}, x, size, title, lowest))

    def _table(self) -> list[dict[str, Any]]:
        history = self.history()
        statistics = dict.fromkeys(name for row in history for name in row["statistics"])
        return [
            {key: value for key, value in row.items() if key != "statistics"}
            | {name: row["statistics"].get(name) for name in statistics if name not in row}
            for row in history
        ]

    def _repr_html_(self) -> str:
        """What a notebook shows."""
        best = self.best()
        state = "finished" if self.finished else "going on" if self.going_on else "stopped: zswarm.resume goes on"
        rows = {
            "folder": self._shown,
            "simulator": self.experiment.problem.simulator,
            "generations": f"{self.generations()} of {self.experiment.generations}, {state}",
            "best score of the last generation" if self.relative else "best fitness": "" if best is None else f"{best:.6g}",
            "history": self.history_hash or "",
        }
        cells = "".join(
            f"<tr><th style='text-align:left'>{html.escape(key)}</th><td style='text-align:left'>{html.escape(value)}</td></tr>"
            for key, value in rows.items()
            if value
        )
        return f"<table>{cells}</table>"

    # ---- helpers

    @property
    def _began(self) -> dict[str, Any]:
        """What the history depends on, as the run began with it; its texts are safe to show."""
        try:
            absolute = {"kind": experiment.ABSOLUTE, "settings": {}}
            began: dict[str, Any] = {"ranking": absolute, **_cleaned(json.loads(self._meta["experiment"]))}
            for part in experiment.PARTS:
                _ = {**began[part]["settings"]}, began[part]["kind"]
        except (KeyError, TypeError, ValueError, RecursionError):
            raise self._damaged("it names no experiment") from None
        return began

    def _metrics(self, count: int) -> list[str]:
        """Their names: the record's, else the simulator's, if it is installed; else numbers."""
        names = self._metric_names
        return names if len(names) == count else [f"metric {number}" for number in range(1, count + 1)]

    @cached_property
    def _metric_names(self) -> list[str]:
        if "metrics" in self._meta:
            try:
                return [clean(name) for name in msgspec.json.decode(self._meta["metrics"], type=list[str])]
            except (msgspec.DecodeError, TypeError):
                raise self._damaged("its metrics are no names") from None
        try:
            return list(plugins.load("simulator", self.experiment.problem.simulator).metrics)
        except UnknownPlugin:
            return []

    def _statistics(self, text: str) -> dict[str, Any]:
        try:
            statistics: dict[str, Any] = _cleaned(msgspec.json.decode(text, type=dict[str, Any]))
        except (msgspec.DecodeError, RecursionError):
            raise self._damaged("the statistics of a generation are no JSON object") from None
        return statistics

    def rows(self, sql: str, kind: type[T], *parameters: Any) -> list[T]:
        """What a query of the record's tables finds, each row of these types.

        Raises:
            ConfigError: the record is damaged, or cannot be read now.
        """
        try:
            with opened(self.folder / DATABASE) as database:
                rows = database.execute(sql, parameters).fetchall()
            return msgspec.convert(rows, list[kind])  # type: ignore[valid-type]
        except msgspec.ValidationError:
            raise self._damaged(f"{_table(sql)} holds what does not belong there") from None
        except UNREADABLE as error:
            if passing(error, self.folder) or isinstance(error, OSError):
                raise ConfigError(f"{self._shown}/{DATABASE}: cannot be read: {in_words(error, self.folder)}") from None
            raise self._damaged(clean(str(error))) from None

    def _damaged(self, why: str) -> ConfigError:
        return ConfigError(f"{self._shown}/{DATABASE}: damaged: {why}")


def goes_on(folder: Path) -> bool:
    """Whether a program is at the run of a folder now."""
    try:
        lock = os.open(folder / "lock", os.O_RDONLY | os.O_NONBLOCK)
    except OSError:
        return False
    try:
        fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:  # a file system without locks
        return False
    finally:
        os.close(lock)
    return False


def told_again(folder: Path, complete: Experiment) -> Result | None:
    """What a finished run came to, by its folder's experiment; None where there is something to do, or to refuse."""
    recorded = Run(folder)
    if recorded.generations() != complete.generations or recorded.changed:
        return None
    return outcome(folder, complete.generations)


def outcome(folder: Path, generations: int) -> Result | None:
    """What a run came to, if it is finished; None also where it cannot be read: whoever goes on with it says why.

    Of one that went on for longer it is what it came to after so many generations: all of a study are of one length.
    """
    if not (folder / DATABASE).exists():
        return None
    try:
        recorded = Run(folder)
        if not recorded.finished or recorded.generations() < generations:
            return None
        history = recorded.history()
        last = history[generations - 1]
        requeued = sum(event["count"] or 0 for event in recorded.events() if event["event"] == "requeued")
        with opened(folder / DATABASE) as database:
            (faulted,) = database.execute("SELECT coalesce(sum(faulted), 0) FROM outcomes").fetchone()
            (doubtful,) = database.execute("SELECT coalesce(sum(count), 0) FROM outcomes WHERE doubtful").fetchone()
    except (ConfigError, sqlite3.Error, OSError):
        return None
    return Result(
        str(folder),
        generations,
        float("nan") if last["best"] is None else last["best"],
        last["evaluations"],
        requeued,
        recorded.history_hash or "" if last is history[-1] else "",
        0.0,
        faulted,
        doubtful,
        recorded.relative,
    )


def runs_below(paths: Sequence[Path], left_out: list[str] | None = None) -> list[Run]:
    """The runs of folders: each is a run's, or one that holds runs, such as a study's or the one of all runs.

    Args:
        left_out: takes a line about each run below a folder that cannot be read; None: such a run is an error.

    Returns:
        In the order of the paths, and below each by name, numbers in names by their value; each run once.

    Raises:
        ConfigError: a path holds none, or one of them cannot be read.
    """
    runs: dict[Path, Run] = {}
    for path in paths:
        folders = folders_below(path)
        if not folders:
            raise ConfigError(
                f"{clean(str(path))}: no run{meant(path)}; expected a folder with {EXPERIMENT} and {DATABASE}, or one that holds "
                "such folders"
            )
        for folder in folders:
            try:
                runs.setdefault(folder.resolve(), Run(folder))
            except ConfigError as error:
                if left_out is None or folder == path:
                    raise
                left_out.append(f"left out: {error}")
        if left_out and not runs:
            raise ConfigError(f"{clean(str(path))}: no run that can be read; {left_out[0].removeprefix('left out: ')}")
    return list(runs.values())


def folders_below(path: Path) -> list[Path]:
    """The folders with a record: the path itself, or those at most two levels below it; they may be damaged."""
    if _is_file(path / DATABASE):
        return [path]
    try:
        found = {file.parent for depth in range(1, DEPTH + 1) for file in path.glob("*/" * depth + DATABASE) if _is_file(file)}
    except OSError:  # as in ``_is_file``
        return []
    return sorted(found, key=lambda folder: [_natural(part) for part in folder.relative_to(path).parts])


def listed(parent: Path) -> list[dict[str, Any]]:
    """What is known of each run below a folder; of one that cannot be read, why. No run's generations are read."""
    return [in_short(folder) for folder in folders_below(parent)]


@contextlib.contextmanager
def opened(path: Path) -> Iterator[sqlite3.Connection]:
    """A record's database, to read; nothing is left beside it, and it may be where nothing can be written.

    Raises:
        sqlite3.Error, OSError, UnicodeDecodeError: it cannot be read.
    """
    path = path.resolve()
    log = path.with_name(f"{path.name}-wal")
    with path.open("rb") as file:
        header = file.read(20)
        size = file.seek(0, os.SEEK_END)
    with contextlib.ExitStack() as stack:

        def opened_at(at: Path, how: str) -> sqlite3.Connection:
            database = sqlite3.connect(f"{at.as_uri()}?{how}", uri=True)
            stack.callback(database.close)
            database.text_factory = _text
            database.execute("PRAGMA trusted_schema = OFF")
            kinds = dict(database.execute("SELECT name, type FROM sqlite_master").fetchall())
            if missing := [name for name in TABLES if kinds.get(name) != "table"]:
                raise sqlite3.DatabaseError(f"no table {missing[0]}")
            return database

        if header[18:] == WAL and not (log.is_file() and log.stat().st_size):
            if size % (int.from_bytes(header[16:18]) or 1):  # SQLite would fill up the last page with zeros
                raise sqlite3.DatabaseError("its end is missing")
            yield opened_at(path, "immutable=1")  # all is in the file; another way SQLite would make a log beside it
            return
        try:
            database = opened_at(path, "mode=ro")
        except sqlite3.OperationalError as error:
            if error.sqlite_errorcode & 0xFF not in (sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_READONLY) or not log.is_file():
                raise
            copy = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="zswarm-")))
            for source in (path, log):
                shutil.copyfile(source, copy / source.name)
            database = opened_at(copy / path.name, "mode=rw")
        yield database


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError:  # nobody may look, or the name is too long
        return False


def in_short(folder: Path) -> dict[str, Any]:
    """What is known of a run without reading its generations; of one that cannot be read, why."""
    shown = clean(str(folder))
    if not _is_file(folder / EXPERIMENT):
        return {"run": shown, "error": f"no {EXPERIMENT} in it"}
    try:
        with opened(folder / DATABASE) as database:
            row = database.execute(
                "SELECT count(*), CASE WHEN EXISTS (SELECT 1 FROM meta WHERE key = 'relative') THEN (SELECT best FROM "
                "generations ORDER BY generation DESC LIMIT 1) ELSE max(best) END, sum(evaluations), max(finished_at) "
                "FROM generations"
            ).fetchone()
            status = database.execute("SELECT value FROM meta WHERE key = 'history_hash'").fetchone()
        generations, best, candidates, at = msgspec.convert(row, tuple[int, float | None, int | None, float | None])
        history = msgspec.convert(status, tuple[str] | None)
    except msgspec.ValidationError:
        return {"run": shown, "error": "damaged: its numbers are none"}
    except UNREADABLE as error:
        what = "cannot be read" if passing(error, folder) else "damaged"
        return {"run": shown, "error": f"{what}: {clean(in_words(error, folder))}"}
    return {
        "run": shown,
        "generations": generations,
        "best": best,
        "candidates": candidates or 0,
        "finished_at": at,
        "history_hash": clean(history[0]) if history else None,
    }


def _natural(name: str) -> list[tuple[bool, int, str]]:
    """A key to sort by: ``seed-2`` is before ``seed-10``."""
    return [(part.isdecimal(), int(part) if part.isdecimal() else 0, part) for part in re.split(r"(\d+)", name) if part]


def _text(raw: bytes) -> str:
    return raw.decode(errors="replace")


def _plain(text: str) -> bool:
    return text.isascii() and text.isprintable()


def _clean(value: Any) -> Any:
    return clean(value) if isinstance(value, str) else value


def _cleaned(value: Any, levels: int = NESTED) -> Any:
    """Texts of a table or list, and of those in it, made safe to show.

    Raises:
        RecursionError: it is nested deeper than anything of ours.
    """
    if isinstance(value, dict | list) and not levels:
        raise RecursionError(f"nested deeper than {NESTED}")
    if isinstance(value, dict):
        return {clean(str(key)): _cleaned(item, levels - 1) for key, item in value.items()}
    return [_cleaned(item, levels - 1) for item in value] if isinstance(value, list) else _clean(value)


def _number(value: float) -> float | None:
    return None if value != value else value


def _table(sql: str) -> str:
    return sql.partition("FROM ")[2].split()[0]
