"""Read a run's record, also while the run evolves; nothing is written (docs/record.md).

A record may come from somewhere else: its types are checked, and its texts made safe to show.
"""

import contextlib
import json
import sqlite3
from collections.abc import Iterable, Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import msgspec

from zswarm import experiment
from zswarm.champion.controller import CHAMPION, Controller, load_controller
from zswarm.champion.held_out import HeldOut, Tracked
from zswarm.config.sections import ABSOLUTE
from zswarm.errors import ConfigError
from zswarm.experiment import Experiment
from zswarm.ot.record import frames, verify
from zswarm.ot.record.database import UNREADABLE, describe, read_only
from zswarm.ot.record.folder import DATABASE, EXPERIMENT, check_run, is_running
from zswarm.ot.record.opening import RACING
from zswarm.ot.record.trials import numbers, trials_of
from zswarm.system.format import per_trial, with_trials
from zswarm.system.text import clean, clean_all, html_table

if TYPE_CHECKING:
    import pandas
    import polars

NAMES = ("run", "simulator", "representation", "sensors", "actuators")  # of a controller

T = TypeVar("T")
Row = dict[str, Any]


class Run:
    """A run's folder, read-only: finished, stopped or active; the folder need not be writable.

    Attributes:
        folder: as given.
        name: of the folder, safe to show.
        shown: the folder, safe to show.
        meta: the table of that name, texts safe to show.
    """

    def __init__(self, folder: Path) -> None:
        """Check that the record can be read.

        Raises:
            ConfigError: no run, damaged, truncated, or of another schema.
        """
        self.folder, self.name = folder, clean(folder.name or folder.resolve().name)
        self.shown = clean(str(folder))
        check_run(folder)
        with self._reading() as database:
            self._meta = verify.read_meta(database, folder / DATABASE)
        self.meta = {
            clean(key): clean(value)
            if isinstance(value, str) and not (value.isascii() and value.isprintable())
            else value
            for key, value in self._meta.items()
        }

    def __repr__(self) -> str:
        return f"Run({self.shown!r})"

    # ---- the run

    @cached_property
    def experiment(self) -> Experiment:
        """The experiment with every default; no plug-in is imported, and texts are safe to show.

        It is as the run began, except for what may change, which is read from the file.

        Raises:
            ConfigError: the file or the record is damaged.
        """
        file, began = experiment.load(self.folder / EXPERIMENT), self._began
        racing = began.pop(RACING)
        parts = {
            name: {**began[name]["settings"], "kind": began[name]["kind"]}
            for name in experiment.PARTS
        }
        mapping = {
            **began,
            **parts,
            "generations": file.generations,
            "stop": experiment.to_mapping(file).get("stop", {}),
            "label": clean(file.label),
            "assessment": msgspec.to_builtins(file.assessment) | {"racing": racing},
            "cluster": clean_all(msgspec.to_builtins(file.cluster)),
        }
        return experiment.check(mapping, f"{self.shown}/{DATABASE}")

    @property
    def changed(self) -> list[str]:
        """Keys of ``experiment.toml`` that differ from the start; raises as ``experiment``."""
        file = experiment.load(self.folder / EXPERIMENT)
        try:
            now = clean_all(msgspec.to_builtins(file))
        except RecursionError as error:
            raise ConfigError(f"{self.shown}/{EXPERIMENT}: {error}") from None
        now[RACING] = file.assessment.racing
        return sorted(key for key, value in self._began.items() if now.get(key) != value)

    @property
    def history_hash(self) -> str | None:
        """Hash of all that the optimizer learned; None while the run is not finished."""
        value = self.meta.get("history_hash")
        return value if isinstance(value, str) else None

    @property
    def history_version(self) -> int:
        """Version of the history hash: hashes of other versions do not compare."""
        value = self.meta.get("history_version")
        return value if isinstance(value, int) else 0

    @property
    def finished(self) -> bool:
        """Return whether the run has all its generations."""
        return self.history_hash is not None

    @property
    def held_out(self) -> HeldOut | None:
        """The champion's fitness on held-out seeds and in search; None if it is not assessed."""
        found = self.meta.get("assessment")
        try:
            return None if found is None else msgspec.json.decode(found, type=HeldOut)
        except (msgspec.DecodeError, TypeError):
            raise self._damaged("its assessment is not valid JSON") from None

    @property
    def track(self) -> list[Tracked]:
        """The best of each k-th generation on held-out seeds, if they were tracked."""
        try:
            return msgspec.json.decode(self.meta.get("track", "[]"), type=list[Tracked])
        except (msgspec.DecodeError, TypeError):
            raise self._damaged("its track is not valid JSON") from None

    @property
    def relative(self) -> bool:
        """Return whether fitness is a score, which compares candidates of one generation only."""
        return bool(self.meta.get("relative"))

    @property
    def fitness_trials(self) -> int:
        """Trials whose sum a candidate's fitness is; 1 for a score, which covers all its games."""
        return 1 if self.relative else self.experiment.problem.trials

    @property
    def going_on(self) -> bool:
        """Return whether a program is running it now."""
        return is_running(self.folder)

    # ---- its record

    def history(self) -> list[Row]:
        """Return generation, finished_at, seconds, best, mean, evaluations and statistics of each.

        ``seconds`` counts from the end of the previous generation; ``best`` and ``evaluations``
        include earlier generations, except ``best`` of ``relative`` fitness. Fitness is a sum.
        """
        previous, evaluations, history = self.meta.get("created_at"), 0, []
        for generation, at, best, mean, count, statistics in self._generations():
            evaluations += count
            history.append(
                {
                    "generation": generation,
                    "finished_at": at,
                    "seconds": at - previous
                    if isinstance(previous, int | float)
                    else None,
                    "best": best,
                    "mean": mean,
                    "evaluations": evaluations,
                    "statistics": self._statistics(statistics),
                }
            )
            previous = at
        return history

    def generations(self) -> int:
        """Return the number of finished generations."""
        return self.rows("SELECT count(*) FROM generations", tuple[int])[0][0]

    def best(self) -> float | None:
        """Return the best fitness, as the last generation knows it: a sum, as in the record."""
        best = [row[2] for row in self._generations()]
        if self.relative or self._began["problem"].get("seeds") == "fresh":
            return best[-1] if best else None
        return max((value for value in best if value is not None), default=None)

    def events(self) -> list[Row]:
        """Return the rows of the table ``events``, in order.

        Raises:
            ConfigError: one is not what was written, or missing.
        """
        with self._reading() as database:
            found = [row[1:7] for row in verify.whole_events(database)]
        kind = tuple[float, int | None, str, str | None, str | None, int | None]
        rows = self._typed(found, kind, "events")
        return _named("at generation event server text count", rows)

    def servers(self) -> list[Row]:
        """Return the rows of the view ``servers``, the busiest first."""
        rows = self.rows(
            "SELECT server, sum(count), sum(seconds), min(at), max(at) FROM outcomes "
            "WHERE server <> '' GROUP BY server ORDER BY 2 DESC, 1",
            tuple[str, int, float, float, float],
        )
        return _named("server trials seconds first_at last_at", rows)

    def marked(self) -> tuple[int, int]:
        """Return the numbers of faulted trials and of doubtful ones, whose server was faulty."""
        sums = "coalesce(sum(faulted), 0), coalesce(sum(count * (doubtful <> 0)), 0)"
        return self.rows(f"SELECT {sums} FROM outcomes", tuple[int, int])[0]  # noqa: S608  ours

    def candidates(self, generation: int) -> list[Row]:
        """Return candidate, genome (bytes; None: not kept), fitness and measures of each, as asked.

        Fitness and measures are as the optimizer was told, NaN as None. Measures are a list.
        """
        with self._reading() as database:
            found = verify.whole_candidates(database, generation)
        kind = tuple[int, bytes | None, float | None, bytes | None, bytes]
        rows = self._typed(found, kind, "candidates")
        told = [
            (candidate, genome, fitness, numbers(measures or b"", -1))
            for candidate, genome, fitness, measures, _ in rows
        ]
        return _named("candidate genome fitness measures", told)

    def trials(self, generation: int) -> list[Row]:
        """Return candidate, trial, fitness (by participant), metrics (by name) and server of each.

        The generation may be unfinished; NaN is None. If candidates play each other a trial has
        instead of ``candidate`` its ``game`` and its ``candidates``, in the order of fitness.
        """
        with self._reading() as database:
            rows = verify.whole_outcomes(database, generation)
        kind = tuple[int, bytes, bytes, bytes, str, bytes | None]
        outcomes = [(*row[3:7], row[8], row[-1]) for row in rows]
        batches = self._typed(outcomes, kind, "outcomes")
        try:
            return trials_of(batches, self.experiment.problem.trials, self._metric_names)
        except ValueError:
            what = f"outcomes of generation {generation + 1} do not fit together"
            raise self._damaged(what) from None

    def champion(self) -> Controller | None:
        """Return the best controller, its texts safe to show; None before there is one.

        Raises:
            ConfigError: its file is damaged.
        """
        if not (self.folder / CHAMPION).is_file():
            return None
        settings = ("simulator_settings", "representation_settings")
        try:
            return cleaned(load_controller(self.folder), *NAMES, *settings)
        except RecursionError as error:
            raise ConfigError(f"{self.shown}/{CHAMPION}: damaged: {error}") from None

    # ---- for notebooks

    def to_pandas(self) -> "pandas.DataFrame":
        """Return the history, a row per generation; the optimizer's statistics are columns, too.

        Raises:
            ConfigError: pandas is missing.
        """
        return frames.to_pandas(self.table())

    def to_polars(self) -> "polars.DataFrame":
        """Return the same as ``to_pandas``; raise ConfigError if polars is missing."""
        return frames.to_polars(self.table())

    def table(self) -> list[Row]:
        """Return the history with a key for each of the optimizer's statistics."""
        return frames.flat(self.history())

    def _repr_html_(self) -> str:
        best, champion = self.best(), self.held_out
        held_out = None if champion is None else champion.mean
        trials = self.fitness_trials
        label = "best score of the last generation" if self.relative else "best fitness"
        state = "running" if self.going_on else "stopped: zswarm.resume continues it"
        state = "finished" if self.finished else state
        rows = {
            "folder": self.shown,
            "simulator": self.experiment.problem.simulator,
            "generations": f"{self.generations()} of {self.experiment.generations}, {state}",
            label: "" if best is None else with_trials(best, trials),
            "champion, held-out": "" if held_out is None else per_trial(held_out, trials),
            "history": self.history_hash or "",
        }
        return html_table({key: value for key, value in rows.items() if value})

    # ---- reading the database

    def rows(self, sql: str, kind: type[T], *parameters: Any) -> list[T]:
        """Return the rows of a query, converted to a type.

        Raises:
            ConfigError: the record is damaged, or cannot be read now.
        """
        with self._reading() as database:
            rows = database.execute(sql, parameters).fetchall()
        found: list[T] = self._typed(rows, kind, sql.partition("FROM ")[2].split()[0])
        return found

    def _typed(self, rows: Sequence[Any], kind: Any, table: str) -> list[Any]:
        try:
            return msgspec.convert(rows, list[kind])
        except msgspec.ValidationError as error:
            raise self._damaged(f"table {table}: {clean(str(error))}") from None

    def check(self) -> None:
        """Compare everything in the record with its digests.

        Raises:
            ConfigError: something differs.
        """
        with self._reading() as database:
            verify.check_record(database)
            verify.check_end(database)

    @contextlib.contextmanager
    def _reading(self) -> Iterator[sqlite3.Connection]:
        """Open the database; raise ConfigError for what is damaged or cannot be read."""
        try:
            with (
                verify.in_words(self.folder),
                read_only(self.folder / DATABASE) as database,
            ):
                yield database
        except UNREADABLE as error:
            why = f"cannot be read: {describe(error, self.folder)}"
            raise ConfigError(f"{self.shown}/{DATABASE}: {why}") from None

    def _generations(self) -> list[tuple[Any, ...]]:
        """Return number, time, best, mean, evaluations and statistics of each generation."""
        with self._reading() as database:
            rows = verify.whole_generations(database)
        kind = tuple[int, float, float | None, float | None, int, str]
        return self._typed(rows, kind, "generations")

    @property
    def _began(self) -> Row:
        """The parts of the experiment that the history depends on, as the run began."""
        try:
            began = {
                "ranking": {"kind": ABSOLUTE, "settings": {}},
                RACING: False,
                **clean_all(json.loads(self._meta["experiment"])),
            }
            for part in experiment.PARTS:
                _ = {**began[part]["settings"]}, began[part]["kind"]
        except (KeyError, TypeError, ValueError, RecursionError):
            raise self._damaged("its experiment is not valid") from None
        return began

    def _metric_names(self, count: int) -> list[str]:
        try:
            names = msgspec.json.decode(self._meta.get("metrics", "[]"), type=list[str])
        except (msgspec.DecodeError, TypeError):
            raise self._damaged("names of its metrics are not a list of texts") from None
        if len(names) == count:
            return list(map(clean, names))
        return [f"metric {number}" for number in range(1, count + 1)]

    def _statistics(self, text: str) -> Row:
        try:
            found: Row = clean_all(msgspec.json.decode(text, type=dict[str, Any]))
        except (msgspec.DecodeError, RecursionError):
            why = "the statistics of a generation are not a JSON object"
            raise self._damaged(why) from None
        return found

    def _damaged(self, why: str) -> ConfigError:
        return ConfigError(f"{self.shown}/{DATABASE}: damaged: {why}")


def cleaned(controller: Controller, *fields: str) -> Controller:
    """Return a controller with the texts of these fields safe to show."""
    texts = {field: clean_all(getattr(controller, field)) for field in fields}
    return msgspec.structs.replace(controller, **texts)


def _named(names: str, rows: Iterable[Sequence[Any]]) -> list[Row]:
    """Return rows by the names of their columns, with texts that are safe to show."""
    return [dict(zip(names.split(), map(clean_all, row), strict=True)) for row in rows]
