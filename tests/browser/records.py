"""Write records as long or as strange as a test needs; nothing is evaluated."""

import math
import random
import sqlite3
import time
from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np

from tests.ot.record.sealing import reseal
from zswarm import experiment
from zswarm.champion.controller import Controller
from zswarm.champion.held_out import HeldOut, Tracked
from zswarm.ot.record.schema import SCHEMA_VERSION
from zswarm.ot.record.writer import Record

CANDIDATES = 10
BEGUN = 1_790_000_000.0
EVENT = (
    "INSERT INTO events (at, generation, event, server, text, count, digest) "
    "VALUES (?, ?, ?, ?, ?, ?, 0)"
)


def write(
    out: Path,
    name: str = "long",
    *,
    generations: int = 100,
    servers: Sequence[str] = ("lab-1-0123abcd", "lab-2-4567cdef"),
    events: Sequence[tuple[float, int | None, str, str, str, int]] = (),
    seed: int = 1,
    finished: bool = True,
    settings: Sequence[str] = (),
) -> Path:
    """Write a run whose fitness rises, a second per generation; servers take turns."""
    loaded = experiment.load(
        experiment.find("stadium"),
        [
            f"generations={generations if finished else generations + 5}",
            f"seed={seed}",
            *settings,
        ],
    )
    complete = experiment.complete(loaded, "test")
    draws = random.Random(seed)
    genomes = [
        np.array([draws.uniform(-2, 2) for _ in range(60)], "<f4").tobytes()
        for _ in range(CANDIDATES)
    ]
    with Record.create(out, complete, "0" * 32, ["left", "time"], name=name) as record:
        folder = record.folder
        record.champion(
            Controller(
                simulator="emergency-exit",
                simulator_settings=complete.problem.settings,
                representation="fully-meshed",
                representation_settings=complete.representation.settings,
                inputs=10,
                outputs=2,
                sensors=[f"sensor {number}" for number in range(10)],
                actuators=["vx", "vy"],
                genome=genomes[0],
                fitness=1.0,
                run="run",
            )
        )
    trials = np.arange(CANDIDATES * complete.problem.trials, dtype="<u4")
    kinds, told, outcomes, history = [], [], [], []
    for generation in range(generations):
        at = BEGUN + generation + 1
        best = 1 - math.exp(-(generation + 1) / max(10, generations / 5))
        fitness = [
            best * (1 - candidate / (2 * CANDIDATES)) for candidate in range(CANDIDATES)
        ]
        mean = sum(fitness) / CANDIDATES
        history.append(
            (
                generation,
                at,
                best,
                mean,
                CANDIDATES,
                f'{{"best": {best}, "mean": {mean}, "diversity_mean": {1 - best}, '
                f'"effectivity_mutation": {draws.random()}, '
                f'"effectivity_crossover": {draws.random()}}}',
            )
        )
        told += [
            (generation, candidate, genomes[candidate], fitness[candidate])
            for candidate in range(CANDIDATES)
        ]
        halves = np.array_split(trials, 2)
        for place, part in enumerate(halves):
            server = servers[(2 * generation + place) % len(servers)]
            values = np.repeat(np.array(fitness), complete.problem.trials)[part]
            outcomes.append(
                (
                    generation,
                    b"",
                    len(part),
                    part.tobytes(),
                    values.astype("<f8").tobytes(),
                    np.ones((len(part), 2)).tobytes(),
                    0,
                    server,
                    0.9,
                    at - 0.1 * place,
                )
            )
    kinds = [
        (BEGUN, None, "began", "", "", 0),
        *((BEGUN, 0, "server_joined", server, "", 2) for server in servers),
        *events,
    ]
    with sqlite3.connect(folder / "run.sqlite") as database:
        database.executemany(
            "INSERT INTO generations VALUES (?, ?, ?, ?, ?, ?, x'', 0, 0)", history
        )
        database.executemany(
            "INSERT INTO candidates (generation, candidate, genome, fitness, digest) "
            "VALUES (?, ?, ?, ?, x'')",
            told,
        )
        database.executemany(
            "INSERT INTO outcomes (generation, asked, count, trials, fitness, metrics, faulted, "
            "server, seconds, at, digest) "
            "VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, 0)",
            outcomes,
        )
        database.executemany(EVENT, kinds)
        database.execute("UPDATE meta SET value = ? WHERE key = 'created_at'", (BEGUN,))
        if finished:
            database.execute(
                "INSERT INTO meta VALUES ('history_hash', ?)", ("0123456789abcdef" * 2,)
            )
    database.close()
    reseal(folder)
    return folder


def grow(folder: Path, generation: int, best: float) -> None:
    """Add a generation, as an active run would."""
    with sqlite3.connect(folder / "run.sqlite", timeout=30) as database:
        database.execute(
            "INSERT INTO generations VALUES (?, ?, ?, ?, ?, ?, x'', 0, 0)",
            (generation, time.time(), best, best / 2, CANDIDATES, "{}"),
        )
        database.execute(EVENT, (time.time(), generation, "requeued", "", "", 3))
    database.close()
    reseal(folder)


def from_the_future(folder: Path) -> None:
    """Write a record of a newer zswarm."""
    with sqlite3.connect(folder / "run.sqlite") as database:
        database.execute(
            "UPDATE meta SET value = ? WHERE key = 'schema_version'",
            (SCHEMA_VERSION + 1,),
        )
    database.close()
    reseal(folder)


def assess(folder: Path, champion: HeldOut, tracked: Sequence[Tracked]) -> None:
    """Give a run the numbers of an assessment and a track, which were not played."""
    with sqlite3.connect(folder / "run.sqlite") as database:
        for key, value in (("assessment", champion), ("track", tracked)):
            text = msgspec.json.encode(value).decode()
            database.execute("INSERT OR REPLACE INTO meta VALUES (?, ?)", (key, text))
    database.close()
    reseal(folder)
