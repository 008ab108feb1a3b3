"""The answers about a run, by their names in an address: functions of its record and a query."""

import contextlib
from collections.abc import Callable, Mapping
from typing import Any

import msgspec
import numpy as np

from zswarm import experiment
from zswarm.champion.controller import Controller
from zswarm.config.decode import convert, to_json
from zswarm.errors import ConfigError, UnknownPlugin
from zswarm.experiment import Experiment
from zswarm.ot.analysis.caveats import caveats
from zswarm.ot.analysis.csv import to_csv
from zswarm.ot.analysis.grouping import flat
from zswarm.ot.analysis.importance import importance
from zswarm.ot.dashboard import downsample
from zswarm.ot.dashboard.rows import read_events
from zswarm.ot.dashboard.run_index import RunIndex
from zswarm.ot.record import annotations
from zswarm.ot.record.opening import NOT_DECISIVE
from zswarm.ot.record.reader import Run
from zswarm.plugins import registry as plugins
from zswarm.system.format import plural
from zswarm.system.text import clean

Query = Mapping[str, str]
Answer = Callable[[Run, Query], Any]
EVENTS = 300  # in an answer
RUNS = 1000  # in a request for curves
GENES = 2000  # numbers of a genome that are shown
EDGES = 2000  # of a network that are drawn: the strongest
LONGEST_NUMBER = 16  # digits of 2^53
TRIALS = 1000  # of a candidate that are listed


def number(query: Query, name: str, default: int | None = None, most: int = 2**53) -> int:
    """Return a number of the address; raise ConfigError if it is missing or not valid."""
    text = query.get(name, "" if default is None else str(default))
    digits = len(text) <= LONGEST_NUMBER and text.isascii() and text.isdecimal()
    if not digits or int(text) > most:
        shown = f"{clean(text)!r:.60}"
        raise ConfigError(
            f"{name}: expected a whole number from 0 to {most}, not {shown}"
        )
    return int(text)


def about(run: Run, _: Query) -> dict[str, Any]:
    """Return what was run."""
    complete, champion, meta = run.experiment, _champion(run), run.meta
    epoch = meta.get("epoch")
    facts = {
        "seed": complete.seed,
        "simulator": complete.problem.simulator,
        "network": complete.representation.kind,
        "optimizer": complete.optimizer.kind,
        "ranking": complete.ranking.kind,
        "history": run.history_hash,
        "version hash": meta.get("version_hash"),
        "zswarm": meta.get("zswarm"),
        "machine": meta.get("machine"),
        "resumed": plural(epoch, "time") if epoch and isinstance(epoch, int) else None,
        "folder": run.shown,
    }
    return {
        "name": run.name,
        "facts": {name: str(value) for name, value in facts.items() if value is not None},
        "experiment": "".join(
            f"{clean(line)}\n" for line in experiment.to_toml(complete).splitlines()
        ),
        "began": meta.get("created_at"),
        **annotations.shown(run.folder),
        "sensors": getattr(champion, "sensors", []),
        "actuators": getattr(champion, "actuators", []),
    }


def settings(complete: Experiment) -> dict[str, str]:
    """Return the settings that the history depends on, by their keys in an experiment file."""
    found: dict[str, str] = {}

    def flatten(value: Any, path: str) -> None:
        if not isinstance(value, dict):
            found[clean(path)] = clean(
                value if isinstance(value, str) else to_json(value)
            )
            return
        for key, item in value.items():
            flatten(
                item, path if key == "settings" else f"{path}.{key}" if path else str(key)
            )

    for key, value in msgspec.to_builtins(complete).items():
        if key not in NOT_DECISIVE or key == "generations":
            flatten(value, key)
    return found


def curves(index: RunIndex, query: Query) -> dict[str, Any]:
    """Return the curve, settings and label of each of several runs that can be read, by its id."""
    points = max(2, number(query, "points", downsample.MOST, downsample.MOST))
    found: dict[str, Any] = {}
    for id_ in query.get("runs", "").split()[:RUNS]:
        folder, complete = index.folder(id_), index.experiment(id_)
        if folder is not None and complete is not None:
            with contextlib.suppress(ConfigError):  # the list of runs says why
                curve = downsample.curve(Run(folder), points)
                found[id_] = {
                    "curve": curve,
                    "settings": settings(complete),
                    "label": clean(complete.label),
                }
    return found


def explained(index: RunIndex, query: Query) -> dict[str, Any]:
    """Return how much each setting explains of the differences between some runs' fitness."""
    rows = {row["id"]: row for row in index.rows()}
    settings, values = [], []
    for id_ in query.get("runs", "").split()[:RUNS]:
        complete, best = index.experiment(id_), rows.get(id_, {}).get("best")
        if complete is not None and best is not None:
            settings.append(flat(complete))
            values.append(best)
    return importance(settings, values).as_object()


def events(run: Run, query: Query) -> list[dict[str, Any]]:
    """Return some events before a row, the last first."""
    which = "WHERE rowid < ? ORDER BY rowid DESC LIMIT ?"
    found = read_events(run, which, number(query, "before", 2**53), EVENTS)
    return [event.as_mapping() for event in found]


def candidate(run: Run, query: Query) -> dict[str, Any]:
    """Return genome, network and trials of a candidate."""
    of, which = number(query, "generation"), number(query, "candidate")
    rows = run.rows(
        "SELECT genome, fitness FROM candidates WHERE generation = ? AND candidate = ?",
        tuple[bytes | None, float | None],
        of,
        which,
    )
    if not rows:
        raise LookupError(
            f"generation {of + 1} has no candidate {which}; the record has {run.generations()} "
            "generations"
        )
    genome, fitness = rows[0]
    trials = [
        trial
        for trial in run.trials(of)
        if which in trial.get("candidates", [trial.get("candidate")])
    ]
    return {
        "generation": of,
        "candidate": which,
        "fitness": fitness,  # as in the record: the sum of so many trials
        "fitness_trials": run.fitness_trials,
        "genome": "" if genome is None else genome.hex(),
        "trials": trials[:TRIALS],
        "left_out": max(0, len(trials) - TRIALS),
        **_network(run, genome),
    }


def history_csv(run: Run, _: Query) -> str:
    """Return the history as CSV, with the optimizer's statistics."""
    rows = run.table()
    return to_csv(list(rows[0]) if rows else [], [list(row.values()) for row in rows])


def _champion(run: Run) -> Controller | str:
    """Return the champion, or why there is none."""
    try:
        return run.champion() or "no generation is finished"
    except ConfigError as error:
        return str(error)


def _network(run: Run, genome: bytes | None) -> dict[str, Any]:
    """Return the numbers and the graph of a genome, or why it cannot be drawn here."""
    if genome is None:
        return {"graph": None, "why": "its genome was not kept ([record] genomes)"}
    champion = _champion(run)
    if isinstance(champion, str):
        return {"graph": None, "why": champion}
    try:
        kind = plugins.load("representation", champion.representation)
        settings = convert(
            champion.representation_settings, kind.settings_type, "representation"
        )
        network = kind(settings, champion.inputs, champion.outputs)
        graph = network.graph(genome)
    except (UnknownPlugin, ConfigError, ValueError) as error:
        return {"graph": None, "why": clean(str(error))}
    edges = sorted(graph.edges, key=lambda edge: -abs(edge.weight))
    numbers = (
        np.frombuffer(genome, "<f4")[:GENES].tolist() if network.genes is not None else []
    )
    return {
        "graph": {
            "nodes": [node._asdict() for node in graph.nodes],
            "edges": [edge._asdict() for edge in edges[:EDGES]],
        },
        "edges": len(edges),
        "genes": network.genes,
        "numbers": [round(value, 6) for value in numbers],
    }


def _points(find: Callable[[Run, int], Any], most: int) -> Answer:
    return lambda run, query: find(run, max(2, number(query, "points", most, most)))


BY_NAME: dict[str, Answer] = {
    "about": about,
    "caveats": lambda run, _: caveats(run),
    "curve": _points(downsample.curve, downsample.MOST),
    "spread": _points(downsample.spread, downsample.SOME),
    "statistics": _points(downsample.statistics, downsample.SOME),
    "timeline": lambda run, query: downsample.timeline(run, number(query, "seconds", 0)),
    "events": events,
    "generation": lambda run, query: downsample.generation(
        run, number(query, "generation")
    ),
    "track": lambda run, _: downsample.track(run),
    "champions": lambda run, _: downsample.champions(run),
    "candidate": candidate,
    "history.csv": history_csv,
    "history.json": lambda run, _: run.table(),
}
