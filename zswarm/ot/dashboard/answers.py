"""What a page may ask about a run: functions of its record, by the name in the address."""

from collections.abc import Callable, Mapping
from typing import Any

import msgspec
import numpy as np

from zswarm import experiment, plugins
from zswarm.controller import Controller
from zswarm.errors import ConfigError, UnknownPlugin
from zswarm.ot.dashboard import points
from zswarm.ot.dashboard.fleet import Event
from zswarm.ot.dashboard.follower import shown
from zswarm.ot.reading import Run
from zswarm.ot.record import NOT_DECISIVE
from zswarm.ot.spreadsheet import to_csv
from zswarm.protocol.codec import clean
from zswarm.strict import convert, to_json

Query = Mapping[str, str]
Answer = Callable[[Run, Query], Any]
EVENTS = 300  # in an answer
GENES = 2000  # numbers of a genome that are shown
EDGES = 2000  # of a network that are drawn: the strongest
TRIALS = 1000  # of a candidate that are listed


def number(query: Query, name: str, default: int | None = None, most: int = 2**53) -> int:
    """A number of the address.

    Raises:
        ConfigError: it is none, or not there.
    """
    text = query.get(name, "" if default is None else str(default))
    if not (text.isascii() and text.isdecimal()) or int(text[:20]) > most:
        raise ConfigError(f"{name}: expected a whole number from 0 to {most}, not {clean(text)!r:.60}")
    return int(text)


def about(run: Run, _: Query) -> dict[str, Any]:
    """What was run, and what its pages have to know."""
    complete, champion = run.experiment, _champion(run)
    return {
        "name": run.name,
        "folder": clean(str(run.folder)),
        "meta": {key: value for key, value in run.meta.items() if isinstance(value, (str, int, float)) and key != "experiment"},
        "experiment": clean_lines(experiment.to_toml(complete)),
        "changed": run.changed,
        "seed": complete.seed,
        "generations": complete.generations,
        "trials": complete.problem.trials,
        "simulator": complete.problem.simulator,
        "representation": complete.representation.kind,
        "optimizer": complete.optimizer.kind,
        "ranking": complete.ranking.kind,
        "relative": run.relative,
        "sensors": champion.sensors if isinstance(champion, Controller) else [],
        "actuators": champion.actuators if isinstance(champion, Controller) else [],
    }


def marks(run: Run, _: Query) -> dict[str, int]:
    """Trials that were counted as faults, and doubtful ones."""
    faulted, doubtful = run.marked()
    return {"faulted": faulted, "doubtful": doubtful}


def _champion(run: Run) -> Controller | str:
    """Or why there is none."""
    try:
        return run.champion() or "no generation is finished"
    except ConfigError as error:
        return str(error)


def clean_lines(text: str) -> str:
    """A text of several lines, each safe to show."""
    return "\n".join(map(clean, text.splitlines())) + "\n"


def settings(run: Run, _: Query) -> dict[str, str]:
    """What was run, by the keys of an experiment file; without what takes no part in it."""
    found: dict[str, str] = {}

    def flatten(value: Any, path: str) -> None:
        if isinstance(value, dict):
            for key, item in value.items():
                flatten(item, path if key == "settings" else f"{path}.{key}" if path else str(key))
        else:
            found[clean(path)] = clean(value if isinstance(value, str) else to_json(value))

    values = msgspec.to_builtins(run.experiment)
    flatten({key: value for key, value in values.items() if key not in NOT_DECISIVE or key == "generations"}, "")
    return found


def curve(run: Run, query: Query) -> Any:
    """See ``points.curve``."""
    return points.curve(run, max(2, number(query, "points", points.MOST, points.MOST)))


def spread(run: Run, query: Query) -> Any:
    """See ``points.spread``."""
    return points.spread(run, max(2, number(query, "points", points.SOME, points.SOME)))


def statistics(run: Run, query: Query) -> Any:
    """See ``points.statistics``."""
    return points.statistics(run, max(2, number(query, "points", points.SOME, points.SOME)))


def timeline(run: Run, query: Query) -> Any:
    """See ``points.timeline``."""
    joined = run.rows(
        "SELECT server, max(count) FROM events WHERE event IN ('server_joined', 'server_slots') AND server <> '' GROUP BY server",
        tuple[str, int],
    )
    last_s = number(query, "seconds", 0)
    slots = {clean(server): count for server, count in joined}
    return {**points.timeline(run, slots, last_s=last_s or None), "slots": slots}


def events(run: Run, query: Query) -> list[dict[str, Any]]:
    """Some before a row, the last first."""
    found = run.rows(
        "SELECT rowid, at, generation, event, coalesce(server, ''), coalesce(text, ''), coalesce(count, 0) FROM events "
        "WHERE rowid < ? ORDER BY rowid DESC LIMIT ?",
        tuple[int, float, int | None, str, str, str, int],
        number(query, "before", 2**53),
        EVENTS,
    )
    return [shown(Event(*row[:3], clean(row[3]), clean(row[4]), clean(row[5]), row[6])) for row in found]


def generation(run: Run, query: Query) -> Any:
    """See ``points.generation``."""
    return points.generation(run, number(query, "generation"))


def champions(run: Run, _: Query) -> Any:
    """See ``points.champions``."""
    return points.champions(run)


def candidate(run: Run, query: Query) -> dict[str, Any]:
    """Genome, network and trials of one."""
    of, which = number(query, "generation"), number(query, "candidate")
    rows = run.rows(
        "SELECT genome, fitness FROM candidates WHERE generation = ? AND candidate = ?", tuple[bytes, float | None], of, which
    )
    if not rows:
        raise LookupError(
            f"generation {of} has no candidate {which}; the record has {run.generations()} generations, counted from 0"
        )
    genome, fitness = rows[0]
    trials = [trial for trial in run.trials(of) if which in trial.get("candidates", [trial.get("candidate")])]
    return {
        "generation": of,
        "candidate": which,
        "fitness": fitness,
        "genome": genome.hex(),
        "trials": trials[:TRIALS],
        "left_out": max(0, len(trials) - TRIALS),
        **_network(run, genome),
    }


def _network(run: Run, genome: bytes) -> dict[str, Any]:
    """The genome's numbers and its drawing, as far as they are known here."""
    champion = _champion(run)
    if isinstance(champion, str):
        return {"graph": None, "why": champion}
    try:
        kind = plugins.load("representation", champion.representation)
        settings = convert(champion.representation_settings, kind.settings_type, "representation")
        network = kind(settings, champion.inputs, champion.outputs)
        graph = network.graph(genome)
    except (UnknownPlugin, ConfigError, ValueError) as error:
        return {"graph": None, "why": clean(str(error))}
    edges = sorted(graph.edges, key=lambda edge: -abs(edge.weight))
    numbers = np.frombuffer(genome, "<f4")[:GENES].tolist() if network.genes is not None else []
    return {
        "graph": {"nodes": [node._asdict() for node in graph.nodes], "edges": [edge._asdict() for edge in edges[:EDGES]]},
        "edges": len(edges),
        "genes": network.genes,
        "numbers": [round(value, 6) for value in numbers],
    }


def history_csv(run: Run, _: Query) -> str:
    """The history as a table, the optimizer's numbers too."""
    rows = _history(run)
    header = list(dict.fromkeys(name for row in rows for name in row))
    return to_csv(header, [[row.get(name) for name in header] for row in rows])


def history_json(run: Run, _: Query) -> Any:
    """The same, as a list."""
    return _history(run)


def _history(run: Run) -> list[dict[str, Any]]:
    rows = []
    for row in run.history():
        statistics = row.pop("statistics")
        rows.append({**row, **{key: value for key, value in statistics.items() if key not in row}})
    return rows


BY_NAME: dict[str, Answer] = {
    "about": about,
    "marks": marks,
    "settings": settings,
    "curve": curve,
    "spread": spread,
    "statistics": statistics,
    "timeline": timeline,
    "events": events,
    "generation": generation,
    "champions": champions,
    "candidate": candidate,
    "history.csv": history_csv,
    "history.json": history_json,
}
