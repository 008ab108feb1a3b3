"""Write records of runs without servers, and read everything of them."""

import sqlite3
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from tests.ot.record.sealing import reseal
from zswarm import experiment
from zswarm.champion.controller import Controller
from zswarm.errors import ConfigError
from zswarm.ot.cluster.events import Counted
from zswarm.ot.notes import Note
from zswarm.ot.record.reader import Run
from zswarm.ot.record.writer import Record
from zswarm.ot.workload import Workload

EVIL = "\x1b[31m[bold]<b onload=x>&amp;\u202e\r\n\x00=cmd()"
ENDLESS = (
    "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT i FROM n"
)
BATCH = "UPDATE outcomes SET {} WHERE id = 1"


def complete(name: str = "minisim", *overrides: str) -> experiment.Experiment:
    return experiment.complete(
        experiment.load(experiment.find("emergency-exit"), [f"name={name}", *overrides]),
        "test",
    )


def controller(**changes: Any) -> Controller:
    return msgspec.structs.replace(
        Controller(
            simulator="emergency-exit",
            simulator_settings={},
            representation="fully-meshed",
            representation_settings={},
            inputs=10,
            outputs=2,
            sensors=["n"],
            actuators=["vx"],
            genome=b"\0" * 240,
            fitness=1.0,
            run="x-0123abcd",
        ),
        **changes,
    )


def evolve(record: Record, generations: int = 2, trials: int = 2) -> None:
    """Record generations of two candidates, their trials in two batches by two servers."""
    for generation in range(generations):
        genomes = [bytes([generation, candidate]) * 4 for candidate in range(2)]
        work = Workload(
            genomes,
            np.repeat(np.arange(2), trials).reshape(-1, 1),
            np.zeros(2 * trials, np.uint64),
            2,
        )
        record.begin(generation, work)
        for server, half in (
            ("lab-01", slice(None, trials)),
            ("lab-02", slice(trials, None)),
        ):
            indices = np.arange(2 * trials)[half][::-1]
            work.fitness[indices, 0] = generation + indices / 8
            work.metrics[indices] = np.stack([indices, -indices], axis=1)
            record.add(Counted(indices, server, 0.5), work)
        record.note(Note("server_joined", server="lab-01", text="with one slot", count=1))
        fitness = work.fitness[:, 0].reshape(2, trials).sum(axis=1)
        statistics = {
            "best": float(fitness.max()),
            "mean": float(fitness.mean()),
            "diversity": float("nan"),
        }
        record.finish(generation, genomes, fitness, statistics, {"at": generation})
    record.champion(controller())


def edit(folder: Path, sql: str, *parameters: Any) -> None:
    """Edit a record with another program, which also writes the digests again."""
    database = sqlite3.connect(folder / "run.sqlite")
    database.executescript(sql) if not parameters else database.execute(sql, parameters)
    database.commit()
    database.close()
    reseal(folder)


def content(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def everything(folder: Path) -> list[Any]:
    """Read everything of a run."""
    run = Run(folder)
    champion = run.champion()
    return [
        run.name,
        repr(run),
        run.meta,
        msgspec.to_builtins(run.experiment),
        run.changed,
        run.history(),
        run.generations(),
        run.best(),
        run.events(),
        run.servers(),
        run.candidates(0),
        run.trials(0),
        run.going_on,
        run.finished,
        run.history_hash,
        *run.marked(),
        msgspec.to_builtins(champion, builtin_types=(bytes,)) if champion else None,
    ]


def texts(value: Any) -> Iterator[str]:
    """Return the texts in a value."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict):
        yield from texts([*value.keys(), *value.values()])
    elif isinstance(value, list):
        for item in value:
            yield from texts(item)


def refusal(folder: Path) -> str:
    """Return why a run cannot be read, in one line that is safe to show."""
    with pytest.raises(ConfigError) as caught:
        everything(folder)
    assert str(caught.value).isprintable()
    return str(caught.value)


def make(parent: Path, name: str, *overrides: str) -> Path:
    with Record.create(parent, complete(name, *overrides), "hash") as record:
        return record.folder
