"""What a resumed run reads back from its record."""

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import msgspec
import numpy as np

from zswarm.errors import ConfigError
from zswarm.ot.cluster.machines import Known
from zswarm.ot.notes import RunEvent
from zswarm.ot.optimizers.optimizer import Told
from zswarm.ot.record import statements
from zswarm.ot.record.commits import Commits
from zswarm.ot.record.contenders import Contender, Contenders
from zswarm.ot.record.history_hash import START, History
from zswarm.ot.record.packing import Place, unpack
from zswarm.ot.record.stopping import Spent
from zswarm.ot.workload import Workload

CONTENDERS_AT_ONCE = 10_000  # rows
BANS = (RunEvent.SERVER_WRONG, RunEvent.SERVER_BANNED)


class Resumed(NamedTuple):
    """Where a run resumes."""

    generation: int  # the first unfinished one
    state: Any  # of the optimizer; None before the first generation ended, or if it was dropped


class Recorded:
    """Everything in a record that was finished, for the program that writes it."""

    _database: Commits
    _generation: int | None
    _round: int
    _asked: bytes

    def __init__(self) -> None:
        self._known: dict[bytes, Place] = {}  # genomes that the last state refers to

    def resumed(self) -> Resumed:
        """Return where the run resumes."""
        generation = self._value("SELECT count(*) FROM generations")
        pieces = self._database.rows(
            "SELECT part, state FROM optimizer ORDER BY part, piece"
        )
        if not pieces:
            return Resumed(generation, None)
        try:
            state, self._known = unpack(pieces, self._genome)
        except (
            msgspec.DecodeError,
            LookupError,
            TypeError,
            ValueError,
            RecursionError,
        ):
            what = "damaged: the optimizer's state cannot be read"
            raise ConfigError(f"{self._database.path}: {what}") from None
        return Resumed(generation, state)

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
            numbers = np.frombuffer(trials, "<u4").astype(np.int64)
            indices = np.searchsorted(workload.numbers, numbers)
            if (
                asked != self._asked
                or not np.isin(numbers, workload.numbers).all()
                or participants != statements.games(workload, indices)
            ):
                number = 1 + (self._generation or 0)
                raise ConfigError(
                    f"{self._database.path.parent}: generation {number} was begun with other "
                    "candidates or games: this program proposes differently than the one that "
                    "began the run"
                )
            count = len(indices)
            workload.fitness[indices] = np.frombuffer(fitness, "<f8").reshape(count, -1)
            workload.metrics[indices] = np.frombuffer(metrics, "<f8").reshape(count, -1)
            workload.counted[indices], workload.source[indices] = True, server
            # Faulted trials are counted one by one.
            workload.faulted[indices] = bool(faulted)
            restored += count
        return restored

    def told(self) -> Iterator[Told]:
        """Yield what the optimizer was told, a generation at a time; dropped genomes are empty."""
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
            genomes = [row[0] or b"" for row in rows]
            yield Told(genomes, fitness, measures.reshape(shape))

    def digests(self, generation: int) -> list[bytes]:
        """Return the digests of a generation's genomes."""
        sql = "SELECT digest FROM candidates WHERE generation = ? ORDER BY candidate"
        return [row[0] for row in self._database.rows(sql, generation)]

    def last_told(self) -> list[tuple[bytes, float, np.ndarray]]:
        """Return digest, fitness and measures of each candidate of the last generation."""
        rows = self._database.rows(
            "SELECT digest, fitness, measures FROM candidates WHERE generation = "
            "(SELECT max(generation) FROM generations) ORDER BY candidate"
        )
        return [
            (
                one,
                math.nan if fitness is None else fitness,
                np.frombuffer(raw or b"", "<f8"),
            )
            for one, fitness, raw in rows
        ]

    def history(self) -> History:
        """Return the hash of the finished generations."""
        last = self._database.rows(
            "SELECT history FROM generations ORDER BY generation DESC LIMIT 1"
        )
        return History(last[0][0] if last else START)

    def spent(self) -> list[Spent]:
        """Return what each finished generation found and took, pauses between programs left out."""
        played = dict(
            self._database.rows(
                "SELECT generation, sum(count) FROM outcomes GROUP BY generation"
            )
        )
        began = [
            row[0]
            for row in self._database.rows("SELECT at FROM events WHERE event = 'began'")
        ]
        found, before = (
            [],
            float(self._value("SELECT value FROM meta WHERE key = 'created_at'")),
        )
        for generation, at, best, evaluations in self._database.rows(
            "SELECT generation, finished_at, best, evaluations FROM generations "
            "ORDER BY generation"
        ):
            since = max([before, *(begin for begin in began if begin <= at)])
            taken = max(0.0, at - since)
            found.append(Spent(best, evaluations, int(played.get(generation, 0)), taken))
            before = at
        return found

    def evaluations(self) -> int:
        """Return the number of candidates of the finished generations."""
        return self._sum("sum(evaluations) FROM generations")

    def best_of(self, generation: int) -> tuple[int, bytes, float] | None:
        """Return generation, genome and fitness of its best; None if all failed."""
        rows = self._database.rows(
            "SELECT candidate, fitness FROM candidates WHERE generation = ? AND fitness NOTNULL "
            "ORDER BY fitness DESC, candidate LIMIT 1",
            generation,
        )
        for candidate, fitness in rows:
            return generation, self._genome((generation, candidate)), fitness
        return None

    def trials(self) -> int:
        """Return the number of trials of the finished generations."""
        finished = "(SELECT count(*) FROM generations)"
        return self._sum(f"sum(count) FROM outcomes WHERE generation < {finished}")

    def counts(self) -> dict[str, Any]:
        """Return the numbers of trials ``requeued``, ``faulted`` and ``doubtful``, for a result."""
        sums = {
            "requeued": "sum(count) FROM events WHERE event = 'requeued'",
            "faulted": "sum(faulted) FROM outcomes",
            "doubtful": "sum(count) FROM outcomes WHERE doubtful",
        }
        return {name: self._sum(sql) for name, sql in sums.items()}

    def contenders(self, most: int) -> list[tuple[bytes, float]]:
        """Return genome and fitness of the best distinct candidates, the best first.

        Those whose genomes were dropped are left out.
        """
        return [
            (self._genome(one.place), one.fitness)
            for one in self._contenders(most, "genome IS NOT NULL").ranked()
        ]

    def _contenders(self, most: int, which: str = "TRUE") -> Contenders:
        """Read the best distinct candidates."""
        found, at = Contenders(most), 0
        sql = (
            f"SELECT digest, fitness, generation, candidate FROM candidates WHERE {which} "  # noqa: S608  ours
            "AND fitness IS NOT NULL ORDER BY fitness DESC, generation, candidate LIMIT ? OFFSET ?"
        )
        while len(found.places()) < most and (
            rows := self._database.rows(sql, CONTENDERS_AT_ONCE, at)
        ):
            found.add(Contender(row[0], row[1], (row[2], row[3])) for row in rows)
            at += CONTENDERS_AT_ONCE
        return found

    def trials_differ(self, each: int) -> bool:
        """Return whether outcomes of a candidate differ from trial to trial in generation 0.

        Args:
            each: trials of a candidate.
        """
        first: dict[int, bytes] = {}
        for trials, fitness, metrics in self._database.rows(
            "SELECT trials, fitness, metrics FROM outcomes WHERE generation = 0 ORDER BY id"
        ):
            indices = np.frombuffer(trials, "<u4").tolist()
            both = [
                np.frombuffer(numbers, "<f8").reshape(len(indices), -1)
                for numbers in (fitness, metrics)
            ]
            for index, outcome in zip(indices, np.hstack(both), strict=True):
                if (
                    first.setdefault(index // each, outcome.tobytes())
                    != outcome.tobytes()
                ):
                    return True
        return False

    def known(self) -> Known:
        """Return what was found out about machines; a user may trust one again."""
        of = (RunEvent.SERVER_JOINED, *BANS, RunEvent.SERVER_TRUSTED)
        sql = (
            "SELECT event, server, machine FROM events "
            "WHERE event IN (?, ?, ?, ?) AND machine <> '' ORDER BY rowid"
        )
        machines: dict[str, str] = {}
        banned: dict[str, str] = {}
        for event, server, machine in self._database.rows(sql, *map(str, of)):
            if event == RunEvent.SERVER_TRUSTED:
                banned.pop(machine, None)
            elif event in BANS:
                banned.setdefault(machine, server)
            else:
                machines[server] = machine
        return Known(machines, banned)

    def _genome(self, place: Place) -> bytes:
        sql = "SELECT genome FROM candidates WHERE (generation, candidate) = (?, ?)"
        found: bytes | None = self._database.rows(sql, *place)[0][0]
        if found is None:
            raise LookupError(place)
        return found

    def _sum(self, what: str, *parameters: Any) -> int:
        return int(self._value(f"SELECT {what}", *parameters) or 0)

    def _value(self, sql: str, *parameters: Any) -> Any:
        """Return the value of an aggregate query."""
        return self._database.rows(sql, *parameters)[0][0]
