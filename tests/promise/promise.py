"""Check a run's folder independently, from docs/record.md and docs/experiment.md alone.

Every candidate's result is counted once, a finished generation is whole, the history is what its
hash says, and each outcome follows from the genome and the trial's seed. It shares no code with
what records a run; only a sample of trials is evaluated again, by ``zswarm.evaluate`` (with
ZSWARM_PLAIN=1 without the compiler).

    python tests/promise/promise.py runs/emergency-exit ...
"""

import argparse
import hashlib
import json
import math
import random
import re
import sqlite3
import struct
import sys
import tomllib
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from zswarm import evaluate

ASSESSMENT = 1_000_000_000  # in place of a generation
NAN = struct.pack("<d", math.nan)
SERVER = re.compile(r"[a-z0-9][a-z0-9-]{0,62}")


class Facts(NamedTuple):
    """The facts that a folder's record states."""

    finished: bool
    told: list[str]  # the history's hash after each finished generation
    # (generation, trial): fitness and metrics, bit by bit.
    outcomes: dict[tuple[int, int], bytes]
    rows: list[tuple[Any, ...]]  # outcomes as recorded
    servers: set[str]
    requeued: int
    again: int  # trials evaluated again

    @property
    def history_hash(self) -> str:
        return self.told[-1] if self.told else ""


def check_run(folder: Path, sample: int = 20, seed: int = 0) -> Facts:
    """Check everything; trials to evaluate again are drawn from ``seed``.

    Raises:
        AssertionError: the promise is broken; the text says where.
    """
    experiment = tomllib.loads((folder / "experiment.toml").read_text(encoding="utf-8"))
    database = sqlite3.connect(
        f"{(folder / 'run.sqlite').resolve().as_uri()}?mode=ro", uri=True
    )
    try:
        state = database.execute("PRAGMA quick_check").fetchall()
        assert state == [("ok",)], f"{folder}: the database is damaged: {state}"
        return _Check(folder, experiment, database).facts(sample, seed)
    finally:
        database.close()


def check_prefix(part: Facts, whole: Facts) -> None:
    """Check that a record holds all that an earlier copy of it holds.

    Raises:
        AssertionError: they are not of one history.
    """
    assert part.told == whole.told[: len(part.told)], (
        "its generations are not those of the whole run"
    )
    for key, outcome in part.outcomes.items():
        assert whole.outcomes.get(key) == outcome, (
            f"generation {key[0]}, trial {key[1]}: not the outcome of the whole run"
        )


class _Check:
    def __init__(
        self, folder: Path, experiment: dict[str, Any], database: sqlite3.Connection
    ) -> None:
        self.folder, self.experiment = folder, experiment
        self.trials = int(experiment["problem"].get("trials", 1))
        self.meta = dict(database.execute("SELECT key, value FROM meta"))
        self.claim(
            self.meta.get("schema_version") == 6,
            f"schema {self.meta.get('schema_version')}",
        )
        self.generations = database.execute(
            "SELECT generation, best, evaluations, finished_at FROM generations ORDER BY generation"
        ).fetchall()
        self.candidates: dict[int, list[tuple[bytes, float | None]]] = {}
        self.measures: dict[int, list[bytes]] = {}
        for generation, candidate, genome, fitness, measures in database.execute(
            "SELECT generation, candidate, genome, fitness, measures FROM candidates "
            "ORDER BY generation, candidate"
        ):
            of = self.candidates.setdefault(generation, [])
            self.claim(
                candidate == len(of),
                f"generation {generation}: candidate {candidate} comes after {len(of) - 1}",
            )
            of.append((genome, fitness))
            self.measures.setdefault(generation, []).append(measures or b"")
        rows = database.execute("SELECT * FROM outcomes ORDER BY id").fetchall()
        self.rows = [row[:12] for row in rows]
        # Candidates that played a trial, where they play each other.
        self.players: dict[tuple[int, int], list[int]] = {}
        self.each = 1  # participants of a trial
        for _, generation, _, count, trials, *_, participants, _ in (
            row for row in rows if row[13] is not None
        ):
            games = np.frombuffer(participants, "<u4").reshape(count, -1)
            self.each = games.shape[1]
            for trial, game in zip(
                np.frombuffer(trials, "<u4").tolist(), games.tolist(), strict=True
            ):
                self.players[generation, trial] = game
        self.relative = "relative" in self.meta
        fresh = self.experiment["problem"].get("seeds") == "fresh"
        self.merges = fresh and not self.relative
        # Generations, mean fitness and mean measures of the genomes of the last generation.
        self.seen: dict[bytes, tuple[int, float, list[float]]] = {}
        self.events = database.execute(
            "SELECT generation, event, server, count, at FROM events ORDER BY rowid"
        ).fetchall()
        self.machines = dict(
            database.execute(
                "SELECT server, machine FROM events WHERE event = 'server_joined'"
            )
        )
        self.optimizer = database.execute(
            "SELECT DISTINCT generation FROM optimizer"
        ).fetchall()
        self.outcomes: dict[tuple[int, int], bytes] = {}
        # Faulted or doubtful: no outcome of the genome.
        self.unsure: set[tuple[int, int]] = set()
        self.asked: dict[int, bytes] = {}

    def claim(self, true: bool, text: str) -> None:
        assert true, f"{self.folder}: {text}"

    def facts(self, sample: int, seed: int) -> Facts:
        self.check_outcomes()
        self.check_generations()
        self.check_events()
        told = self.check_history()
        again = self.evaluate_again(sample, seed)
        servers = {row[8] for row in self.rows} - {""}
        requeued = sum(
            count for _, event, _, count, _ in self.events if event == "requeued"
        )
        return Facts(
            "history_hash" in self.meta,
            told,
            self.outcomes,
            self.rows,
            servers,
            requeued,
            again,
        )

    def check_outcomes(self) -> None:
        """Check that each trial counts at most once, by a server that joined."""
        ended = len(self.generations)
        joined = {
            server for _, event, server, _, _ in self.events if event == "server_joined"
        }
        # All servers of the machine of a server that computed wrong did so.
        wrong = {
            (of_machine, generation)
            for generation, event, server, _, _ in self.events
            if event == "server_wrong"
            for of_machine in (
                server,
                *(
                    other
                    for other, machine in self.machines.items()
                    if machine and machine == self.machines.get(server)
                ),
            )
        }
        last = 0
        for (
            id_,
            generation,
            asked,
            count,
            trials,
            fitness,
            metrics,
            faulted,
            server,
            seconds,
            at,
            doubtful,
        ) in self.rows:
            where = f"outcomes {id_}"
            self.claim(
                0 <= generation <= ended or generation == ASSESSMENT,
                f"{where}: of generation {generation}, while {ended} are finished",
            )
            self.claim(
                generation >= last,
                f"{where}: of generation {generation} after one of {last}",
            )
            last = generation
            self.claim(
                self.asked.setdefault(generation, asked) == asked,
                f"{where}: two sets of genomes in one generation",
            )
            self.claim(
                count >= 1 and len(trials) == 4 * count,
                f"{where}: {len(trials)} bytes of trials for {count}",
            )
            each = 8 * self.each
            self.claim(
                len(fitness) == each * count,
                f"{where}: {len(fitness)} bytes of fitness for {count}",
            )
            self.claim(
                len(metrics) % (8 * count) == 0,
                f"{where}: {len(metrics)} bytes of metrics for {count}",
            )
            self.claim(seconds >= 0 and at > 0, f"{where}: {seconds} s at {at}")
            if server == "":
                self.claim(
                    count == faulted == 1 and fitness == NAN * self.each,
                    f"{where}: of no server, and no fault",
                )
            else:
                self.claim(
                    SERVER.fullmatch(server) is not None and faulted == 0,
                    f"{where}: of {server!r}, {faulted} faulted",
                )
                self.claim(
                    server in joined,
                    f"{where}: of the unknown server {server}, which never joined",
                )
                for blamed, since in wrong:
                    self.claim(
                        blamed != server
                        or generation > since
                        # Relative: of an earlier round.
                        or ((generation < since or self.relative) and doubtful == 1),
                        f"{where}: {server} computed wrong in generation {since}, and this is "
                        "counted as if it had not",
                    )
            width = len(metrics) // count
            for i, trial in enumerate(np.frombuffer(trials, "<u4").tolist()):
                key = (generation, trial)
                self.claim(
                    key not in self.outcomes,
                    f"{where}: trial {trial} of generation {generation} is counted twice",
                )
                self.outcomes[key] = (
                    fitness[each * i : each * i + each]
                    + metrics[width * i : width * i + width]
                )
                for number in struct.unpack(
                    f"<{self.each + width // 8}d", self.outcomes[key]
                ):
                    self.claim(
                        math.isfinite(number) or struct.pack("<d", number) == NAN,
                        f"{where}: trial {trial} has a number that is not finite, nor the one NaN",
                    )
                if server == "" or doubtful:
                    self.unsure.add(key)

    def check_generations(self) -> None:
        """Check that generations are complete and sums are right."""
        numbers = [row[0] for row in self.generations]
        self.claim(
            numbers == list(range(len(numbers))),
            f"generations are not contiguous from 0: {numbers}",
        )
        self.claim(
            sorted(self.candidates) == numbers,
            "candidates of other generations than those that are finished",
        )
        self.claim(
            self.optimizer == [(n,) for n in numbers[-1:]],
            f"the optimizer's state is of {self.optimizer}",
        )
        self.claim(
            len(numbers) <= self.experiment["generations"],
            f"{len(numbers)} generations, more than asked for",
        )
        counted: dict[int, list[int]] = {}
        for generation, trial in self.outcomes:
            counted.setdefault(generation, []).append(trial)
        self.check_assessment(sorted(counted.pop(ASSESSMENT, [])))
        best_yet, champion = -math.inf, b""
        for generation, best, evaluations, at in self.generations:
            where, candidates = f"generation {generation}", self.candidates[generation]
            self.claim(
                evaluations == len(candidates) > 0 and at > 0,
                f"{where}: {evaluations} of {len(candidates)} candidates",
            )
            trials = (
                len(counted.get(generation, []))
                if self.relative
                else len(candidates) * self.trials
            )
            expected = list(range(trials))
            missing = sorted(set(expected) - set(counted.get(generation, [])))
            self.claim(not missing, f"{where}: trials {missing[:5]} were not counted")
            self.claim(
                sorted(counted[generation]) == expected,
                f"{where}: more trials than its candidates have",
            )
            whole = b"".join(
                hashlib.blake2b(genome, digest_size=16).digest()
                for genome, _ in candidates
            )
            digest = hashlib.blake2b(whole, digest_size=8).digest()
            self.claim(
                self.asked[generation] == digest,
                f"{where}: its genomes are not those that were evaluated",
            )
            again = self.merges and champion in [genome for genome, _ in candidates]
            best_yet = -math.inf if self.relative or again else best_yet
            seen: dict[bytes, tuple[int, float, list[float]]] = {}
            played: dict[int, list[int]] = {
                candidate: [] for candidate in range(len(candidates))
            }
            for trial in expected:
                players = self.players.get((generation, trial), [trial // self.trials])
                self.claim(
                    len(set(players)) == len(players) == self.each,
                    f"{where}: {players} played trial {trial}",
                )
                for candidate in players:
                    played[candidate].append(trial)
            self.check_games(where, generation, trials)
            for candidate, (genome, fitness) in enumerate(candidates):
                count, before, measures = self.seen.get(genome, (0, 0.0, []))
                measures = self.check_measures(
                    where, generation, candidate, played[candidate], count, measures
                )
                if self.relative:
                    best_yet = max(best_yet, -math.inf if fitness is None else fitness)
                    continue
                total = 0.0
                for trial in played[candidate]:
                    total += struct.unpack("<d", self.outcomes[generation, trial][:8])[0]
                if count:
                    total = (before * count + total) / (count + 1)
                if self.merges:
                    seen[genome] = count + 1, total, measures
                told = math.nan if fitness is None else fitness
                self.claim(
                    bits(told) == bits(total),
                    f"{where}: candidate {candidate} was told as {told!r}, but the sum of its "
                    f"trials is {total!r}",
                )
                if told > best_yet:
                    best_yet, champion = told, genome
            self.seen = seen
            if best_yet > -math.inf:
                self.claim(
                    best == best_yet,
                    f"{where}: best {best!r}, but the best fitness so far is {best_yet!r}",
                )

    def check_games(self, where: str, generation: int, trials: int) -> None:
        """Check that each game has all its trials in order, with the same players."""
        self.claim(
            trials % self.trials == 0,
            f"{where}: {trials} trials, and a game has {self.trials}",
        )
        for trial in range(trials if self.relative else 0):
            first = self.players[generation, trial - trial % self.trials]
            self.claim(
                self.players[generation, trial] == first,
                f"{where}: trial {trial} is of other players than its game",
            )

    def check_assessment(self, trials: list[int]) -> None:
        """Check that no trial of the assessment is missing before another one."""
        self.claim(
            trials == list(range(len(trials))), "trials of the assessment are missing"
        )
        assessed = "assessment" in self.meta
        self.claim(not assessed or len(trials) >= 30, "an assessment without its trials")
        self.claim(
            not assessed or json.loads(self.meta["assessment"])["seeds"] > 0,
            "an assessment without held-out seeds",
        )

    def check_measures(
        self,
        where: str,
        generation: int,
        candidate: int,
        trials: list[int],
        count: int,
        before: list[float],
    ) -> list[float]:
        """Check that measures are means of the metrics that the optimizer names; return them.

        With fresh seeds they are those over ``count`` generations before, too.
        """
        named = self.experiment["optimizer"].get("measures", [])
        told = self.measures[generation][candidate]
        self.claim(
            len(told) == 8 * len(named),
            f"{where}: candidate {candidate} has {len(told)} bytes of measures",
        )
        names, found = json.loads(self.meta.get("metrics", "[]")), []
        for column, name in enumerate(named):
            total = 0.0
            for trial in trials:
                total += struct.unpack_from(
                    "<d",
                    self.outcomes[generation, trial],
                    8 * (self.each + names.index(name)),
                )[0]
            mean = total / len(trials) if trials else math.nan
            if count:
                mean = (before[column] * count + mean) / (count + 1)
            found.append(mean)
            self.claim(
                told[8 * column : 8 * column + 8] == bits(mean),
                f"{where}: candidate {candidate}'s {name} is not the mean of its trials",
            )
        return found

    def check_events(self) -> None:
        """Check that events and the epoch are consistent."""
        epoch = self.meta.get("epoch")
        self.claim(isinstance(epoch, int) and epoch >= 0, f"epoch {epoch!r}")
        last = -1
        for generation, event, server, count, at in self.events:
            self.claim(
                re.fullmatch("[a-z_]+", event) is not None and count >= 0 and at > 0,
                f"event {event}: {count} at {at}",
            )
            self.claim(
                event not in ("requeued", "server_joined") or count > 0,
                f"event {event}: of {count}",
            )
            self.claim(
                not event.startswith("server_") or bool(server),
                f"event {event}: of no server",
            )
            if generation is not None:
                self.claim(
                    0 <= generation <= len(self.generations),
                    f"event {event}: in generation {generation}",
                )
                self.claim(
                    generation >= last or generation is None,
                    f"event {event}: in generation {generation} after {last}",
                )
                last = generation

    def check_history(self) -> list[str]:
        """Check the hash after each generation; the last is the recorded one."""
        told, value = [], b"zswarm history 2"
        for generation in sorted(self.candidates):
            candidates = self.candidates[generation]
            measures = b"".join(self.measures[generation])
            named = len(measures) // (8 * len(candidates))
            total = hashlib.blake2b(value, digest_size=16)
            total.update(struct.pack("<2Q", len(candidates), named))
            for genome, _ in candidates:
                total.update(hashlib.blake2b(genome, digest_size=16).digest())
            for _, fitness in candidates:
                total.update(NAN if fitness is None else struct.pack("<d", fitness))
            total.update(measures)
            value = total.digest()
            told.append(value.hex())
        if (recorded := self.meta.get("history_hash")) is not None:
            wanted = self.experiment["generations"]
            self.claim(
                len(told) == wanted,
                f"has a history hash after {len(told)} of {wanted} generations",
            )
            self.claim(
                recorded == told[-1],
                f"the history hash is {told[-1]}, not {recorded} as recorded",
            )
        return told

    def evaluate_again(self, sample: int, seed: int) -> int:
        """Evaluate some outcomes of finished generations again."""
        keys = [
            key
            for key in self.outcomes
            if key[0] in self.candidates and key not in self.unsure
        ]
        chosen = sorted(random.Random(seed).sample(sorted(keys), min(sample, len(keys))))
        if not chosen:
            return 0
        problem, representation = (
            self.experiment["problem"],
            dict(self.experiment["representation"]),
        )
        simulator, network = evaluate.build(
            problem["simulator"],
            problem.get("settings", {}),
            representation.pop("kind"),
            representation,
        )
        games = [self.players.get(key, [key[1] // self.trials]) for key in chosen]
        genomes = [
            self.candidates[key[0]][player][0]
            for key, game in zip(chosen, games, strict=True)
            for player in game
        ]
        seeds = [
            self.trial_seed(simulator, generation, trial % self.trials)
            for generation, trial in chosen
        ]
        participants = np.arange(len(genomes)).reshape(-1, self.each)
        outcomes = evaluate.evaluate(
            simulator, network, genomes, participants, np.array(seeds, np.uint64)
        )
        for row, (generation, trial) in enumerate(chosen):
            again = (
                outcomes.fitness[row].astype("<f8").tobytes()
                + outcomes.metrics[row].astype("<f8").tobytes()
            )
            self.claim(
                again == self.outcomes[generation, trial],
                f"generation {generation}, trial {trial}: evaluated again, the outcome has other "
                "bits",
            )
        return len(chosen)

    def trial_seed(self, simulator: Any, generation: int, trial: int) -> int:
        run = self.experiment["seed"]
        if self.experiment["problem"].get("seeds") == "fresh":
            return derived(run, "trial", trial, generation)
        fixed = simulator.fixed_seeds(self.trials)
        return derived(run, "trial", trial) if fixed is None else int(list(fixed)[trial])


def derived(seed: int, purpose: str, *indices: int) -> int:
    """Derive a seed from the run's seed, little-endian, then indices, then the purpose."""
    numbers = b"".join(number.to_bytes(8, "little") for number in (seed, *indices))
    return int.from_bytes(
        hashlib.blake2b(numbers + purpose.encode(), digest_size=8).digest(), "little"
    )


def bits(number: float) -> bytes:
    """Return a number's bits as recorded: one NaN, no -0.0."""
    return NAN if math.isnan(number) else struct.pack("<d", number + 0.0)


def main() -> None:
    """Print a line per folder; exit with 1 when one breaks the promise."""
    parser = argparse.ArgumentParser(
        description="Check that the record of a run keeps its promise."
    )
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUN")
    parser.add_argument(
        "--sample", type=int, default=20, help="trials to evaluate again (20)"
    )
    given = parser.parse_args()
    broken = False
    for folder in given.runs:
        try:
            facts = check_run(folder, given.sample)
        except AssertionError as error:
            broken = True
            sys.stdout.write(f"BROKEN {error}\n")
        else:
            sys.stdout.write(
                f"kept   {folder}: {len(facts.told)} generations, {len(facts.outcomes)} trials "
                "counted once, "
                f"{facts.again} evaluated again, history {facts.history_hash or 'not begun'}"
                f"{'' if facts.finished else ' so far'}\n"
            )
    sys.exit(broken)


if __name__ == "__main__":
    main()
