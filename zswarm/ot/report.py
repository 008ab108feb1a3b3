"""A run or a study as one HTML file that needs nothing else: no script, no request, readable in print and in the dark.

The page is ``report.html.jinja``. Every text of it is escaped; texts of a record are cleaned before.
"""

import re
import shlex
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from zswarm import evaluate, experiment, plugins, ranges, varied
from zswarm.controller import Controller
from zswarm.errors import ConfigError, EvaluationError, UnknownPlugin
from zswarm.extras import need
from zswarm.files import write_for_user
from zswarm.nets.fully_meshed import FullyMeshed
from zswarm.ot import comparison, curves, figures, film, grouping, hindsight, reading, trace, unseen
from zswarm.ot.explanation import in_time
from zswarm.ot.reading import Run
from zswarm.ot.record import EXPERIMENT
from zswarm.ot.terminal import plural
from zswarm.protocol.codec import clean

TEMPLATE = "report.html.jinja"
MAX_EVENTS = 1000  # that are listed
MAX_CELLS = 10_000  # of a picture of weights
SEED = 0  # of the unseen trials, as ``zswarm-ot evaluate`` has it
GRAVE = (  # events by importance; what is not here is daily life
    *("server_wrong", "server_faulty", "fault", "simulator_raised", "disk_waited", "malformed", "unverified"),
    *("server_differs", "server_mismatch", "server_refused", "server_silent", "diagnosis"),
    *("server_lost", "lease_lost", "requeued", "server_left"),
)
TROUBLE = GRAVE[:7]


class Setting(NamedTuple):
    """A key of the experiment."""

    key: str
    value: str
    default: str  # "" where there is none, or it is this
    changed: bool


class Weights(NamedTuple):
    """A fully-meshed network as a table."""

    rows: list[str]
    columns: list[str]
    cells: list[list[tuple[float, float]]]  # value, and its share of the greatest


def write(path: Path, output: Path, trials: int) -> None:
    """The report of a run's or study's folder.

    Args:
        trials: unseen ones that the champion plays; 0: none.

    Raises:
        ConfigError: there is no run, it cannot be read, a package is missing, or the file cannot be written.
    """
    need("jinja2", "plot", "report")
    figures.plain_style()
    runs = reading.runs_below([path])
    text = of_run(runs[0], trials) if len(runs) == 1 else of_study(path, runs)
    write_for_user(output, text.encode())


def of_run(run: Run, trials: int) -> str:
    """The page of a run."""
    read = curves.series(run)
    champion, servers, events = run.champion(), run.servers(), run.events()
    complete = run.experiment
    return _page(
        title=run.name,
        lead=_lead(run, read, len(servers)),
        state="" if run.finished else curves.unfinished([run], [read])[0],
        curve=_svg(figures.of_series({run.name: [read]}, size="screen")) if len(read.best) else "",
        champion=_champion(champion, run) if champion else [],
        played=_played(champion, trials) if champion and trials else None,
        **(_film(champion) if champion else {}),
        weights=_weights(champion) if champion else None,
        hindsight=_hindsight(champion, run) if champion else [],
        settings=_settings(complete),
        servers=_servers(servers),
        events=_events(events),
        listed=[_event(event) for event in events[:MAX_EVENTS]],
        left_out=max(0, len(events) - MAX_EVENTS),
        record=_record(run),
        folder=shlex.quote(run.name),
        again=shlex.quote(f"{run.name}/{EXPERIMENT}"),
        history=run.history_hash or "",
        caveats=_caveats(run),
    )


def of_study(path: Path, runs: Sequence[Run]) -> str:
    """The page of several runs."""
    groups = grouping.groups(runs)
    loaded, notes = curves.load(groups)
    scores = any(run.relative for run in runs)
    found = None if scores else comparison.of_series(loaded, "generations", notes)
    finished = sum(run.finished for run in runs)
    name = clean(path.resolve().name)
    example = Path(EXPERIMENT) if (path / EXPERIMENT).is_file() else runs[0].folder.relative_to(path) / EXPERIMENT
    return _page(
        title=name,
        lead=f"{plural(len(runs), 'run')} in {plural(len(groups), 'group')}; {finished} finished.",
        state=f"{comparison.SCORES[0].upper()}{comparison.SCORES[1:]}." if scores else "",
        curve=_svg(figures.of_series(loaded, size="screen")) if len(loaded) <= figures.MAX_GROUPS else "",
        compared=found,
        words=[comparison.in_words(pair) for pair in found.pairs] if found else [],
        p_value=comparison.p_value,
        reconciling=comparison.reconciling(found) if found else "",
        runs=[
            (group, run.name, run.experiment.seed, run.generations(), _number(run.best()), run.history_hash or "not finished")
            for group, members in groups.items()
            for run in members
        ],
        settings=_settings(runs[0].experiment),
        settings_of=runs[0].name if len(runs) > 1 else "",
        folder=shlex.quote(name),
        again=shlex.quote(f"{name}/{clean(str(example))}"),
        one_again=str(example) != EXPERIMENT,
    )


# ---- the parts of a page


def _page(**content: Any) -> str:
    jinja2 = need("jinja2", "plot", "report")
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["number"] = _number
    nothing = dict.fromkeys(
        ("state", "curve", "champion", "played", "film", "no_film", "weights", "hindsight", "servers", "events", "listed",
         "left_out", "record", "history", "caveats", "compared", "words", "runs", "settings_of", "one_again", "reconciling")
    )  # fmt: skip
    page: str = environment.get_template(TEMPLATE).render({**nothing, **content})
    return page


def _lead(run: Run, read: curves.Series, servers: int) -> str:
    complete = run.experiment
    if not len(read.best):
        return f"{complete.problem.simulator}, evolved by {complete.optimizer.kind}: no generation is finished yet."
    worth = "with the score" if run.relative else "of fitness"
    return (
        f"{complete.problem.simulator}: {complete.optimizer.kind} evolved a {complete.representation.kind} controller "
        f"{worth} {_number(read.best[-1])} in {plural(len(read.best), 'generation')}, with {read.evaluations[-1]:,.0f} "
        f"evaluations on {plural(servers, 'server')} in {_duration(float(read.seconds[-1]))}."
    )


def _champion(champion: Controller, run: Run) -> list[tuple[str, str]]:
    trials, ranking = run.experiment.problem.trials, run.experiment.ranking.kind
    fitness = ("fitness", _number(champion.fitness) + (f", the sum over {plural(trials, 'trial')}" if trials > 1 else ""))
    score = ("score", f"{_number(champion.fitness)}, by {clean(ranking)} among the candidates of its generation")
    return [
        score if run.relative else fitness,
        ("simulator", clean(champion.simulator)),
        ("representation", clean(champion.representation)),
        ("inputs", f"{champion.inputs}" + _names(champion.sensors)),
        ("outputs", f"{champion.outputs}" + _names(champion.actuators)),
        ("genome", f"{len(champion.genome)} bytes"),
    ]


def _played(champion: Controller, trials: int) -> dict[str, Any]:
    """On unseen seeds; or why not."""
    try:
        played = unseen.play(champion, trials, SEED)
    except (ConfigError, MemoryError) as error:
        return {"trials": trials, "why_not": clean(str(error)) or "there is not enough memory"}
    summary = {name: _number(value) for name, value in played.fitness_summary().items()}
    metrics = [(clean(name), _number(value)) for name, value in played.metric_means().items()]
    return {
        "trials": trials,
        "why_not": "",
        "alike": played.all_the_same(),
        "half": summary["q25"] == summary["q75"],
        "against": "against itself, " if played.results.shape[1] > 1 else "",
        **summary,
        "metrics": metrics,
    }


def _film(champion: Controller) -> dict[str, str]:
    """The first of the unseen trials, moving, or why there is none; neither where it cannot be played or draws nothing."""
    try:
        simulator, network = evaluate.build(
            champion.simulator, champion.simulator_settings, champion.representation, champion.representation_settings
        )
    except (ConfigError, MemoryError):
        return {}
    seed = unseen.trial_seed(SEED, 0)
    values = varied.values(champion.simulator_settings, seed)
    drawn = "".join(f", {clean(ranges.name(path))} {clean(ranges.shown(value))}" for path, value in values.items())
    try:
        seen = trace.record(simulator, network, [champion.genome] * simulator.participants, seed, film.MOST_TURNS)
    except (ValueError, EvaluationError, MemoryError) as error:  # the rest of the page is there without it
        return {"no_film": clean(f"{type(error).__name__}: {error}")}
    if not seen.frames or seen.error:
        why = seen.error or seen.no_picture
        return {"no_film": why} if why else {}
    panel = film.Panel(f"the first of the unseen trials{drawn}", seen.frames)
    return {"film": film.svg([panel]).replace(f' xmlns="{film.NAMESPACE}"', "")}


def _weights(champion: Controller) -> Weights | None:
    """Of a fully-meshed network that fits its genome."""
    try:
        _, network = evaluate.build(
            champion.simulator, champion.simulator_settings, champion.representation, champion.representation_settings
        )
    except (ConfigError, MemoryError):
        return None
    if not isinstance(network, FullyMeshed) or len(champion.genome) != network.genome_bytes:
        return None
    table = np.frombuffer(champion.genome, "<f4").reshape(network.shape).astype(np.float64)
    if table.size > MAX_CELLS or not np.isfinite(table).all():
        return None
    hidden = network.neurons - champion.outputs
    neurons = [f"hidden {i + 1}" for i in range(hidden)] + _numbered(champion.actuators, "output", champion.outputs)
    sources = [*_numbered(champion.sensors, "input", champion.inputs), *neurons, "bias"]
    greatest = float(np.abs(table).max()) or 1.0
    return Weights(neurons, sources, [[(value, abs(value) / greatest) for value in row] for row in table.tolist()])


def _settings(complete: experiment.Experiment) -> list[Setting]:
    """Every key, and what differs from its default."""
    problem, cluster = (msgspec.to_builtins(part) for part in (complete.problem, complete.cluster))
    settings = problem.pop("settings")
    rows = [Setting(key, str(getattr(complete, key)), "", changed=False) for key in ("name", "seed", "generations")]
    rows += _rows("problem", problem, _defaults(experiment.Problem))
    rows += _rows("problem.settings", settings, _part_defaults("simulator", complete.problem.simulator))
    for key, kind in (("representation", "representation"), ("optimizer", "optimizer")):
        part: experiment.Part = getattr(complete, key)
        rows.append(Setting(f"{key}.kind", part.kind, "", changed=False))
        rows += _rows(key, part.settings, _part_defaults(kind, part.kind))  # type: ignore[arg-type]  # one of its kinds
    return rows + _rows("cluster", cluster, _defaults(experiment.Cluster))


def _rows(table: str, values: Mapping[str, Any], defaults: Mapping[str, Any]) -> list[Setting]:
    rows = []
    for key, value in values.items():
        changed = key in defaults and defaults[key] != value
        rows.append(Setting(f"{table}.{key}", _value(value), _value(defaults[key]) if changed else "", changed))
    return rows


def _defaults(struct: type[msgspec.Struct]) -> dict[str, Any]:
    found = {}
    for field in msgspec.structs.fields(struct):
        if field.default is not msgspec.NODEFAULT:
            found[field.name] = msgspec.to_builtins(field.default)
        elif field.default_factory is not msgspec.NODEFAULT:
            found[field.name] = msgspec.to_builtins(field.default_factory())
    return found


def _part_defaults(kind: plugins.Kind, name: str) -> dict[str, Any]:
    """Of a part that is installed."""
    try:
        return _defaults(plugins.load(kind, name).settings_type)
    except UnknownPlugin:
        return {}


def _hindsight(champion: Controller, run: Run) -> list[tuple[str, str]]:
    """What the cost model says of the run, beside what it took; nothing where that cannot be said."""
    seen = hindsight.look_back(run, champion.genome)
    if seen is None:
        return []
    known = f"generations 2 to {seen.known + 1}" if seen.known > 1 else "generation 2"
    return [
        ("measured", _duration(seen.measured_s)),
        (
            "predicted",
            f"{_duration(seen.predicted_s)}, from {known}: a trial takes a slot {in_time(seen.trial_s)}, and in each generation "
            f"slots wait for {in_time(seen.gap_s)}",
        ),
        (
            "by broker",
            f"{in_time(seen.broker_s)}, as the paper's first design with its Table I: two messages for each agent and step",
        ),
        ("by files", f"{in_time(seen.files_s)}, as its second: exported and compiled for each candidate"),
    ]


def _servers(servers: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    total = sum(server["trials"] for server in servers) or 1
    return [
        (
            server["server"],
            f"{server['trials']:,}",
            f"{100 * server['trials'] / total:.1f} %",
            _duration(server["seconds"]),
            _when(server["first_at"]),
            _when(server["last_at"]),
        )
        for server in servers
    ]


def _events(events: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """How often each kind, the gravest first."""
    counts = Counter(event["event"] for event in events)
    last = {event["event"]: event for event in events}

    def gravity(kind: str) -> tuple[int, str]:
        return (GRAVE.index(kind) if kind in GRAVE else len(GRAVE), kind)

    return [
        {"kind": kind, "count": counts[kind], "last": _event(last[kind]), "trouble": kind in TROUBLE}
        for kind in sorted(counts, key=gravity)
    ]


def _event(event: Mapping[str, Any]) -> dict[str, str]:
    return {
        "at": _when(event["at"]),
        "generation": "" if event["generation"] is None else str(event["generation"] + 1),
        "event": event["event"],
        "server": event["server"] or "",
        "text": event["text"] or "",
        "count": str(event["count"] or ""),
    }


def _caveats(run: Run) -> list[str]:
    """Why the experiment, run again, may have another history."""
    (faulted, doubtful), source = run.marked(), run.meta.get("imported_from")
    found = [f"The run was imported, not evolved here: {source}."] if source else []
    if faulted:
        found.append(f"{plural(faulted, 'trial')} failed by what a machine did, and counted as failed.")
    if doubtful:
        found.append(f"{plural(doubtful, 'trial')} came from a server that was later proved to compute wrong.")
    if changed := run.changed:
        found.append(f"experiment.toml was changed after the run began ({', '.join(changed)}); this page shows what was run.")
    return found


def _record(run: Run) -> list[tuple[str, str]]:
    meta: dict[str, Any] = run.meta
    rows: list[tuple[str, Any]] = [
        ("zswarm", meta.get("zswarm")),
        ("machine of the optimizer", meta.get("machine")),
        ("code that computes", meta.get("version_hash")),
        ("run", meta.get("run_id")),
        ("began", _when(meta["created_at"]) if isinstance(meta.get("created_at"), (int, float)) else None),
        ("resumed", plural(meta["epoch"], "time") if meta.get("epoch") else None),
        ("schema of the record", meta.get("schema_version")),
    ]
    return [(name, str(value)) for name, value in rows if value is not None]


# ---- texts and pictures


def _svg(figure: Any) -> str:
    """A figure inside the page: it takes the page's colours and asks for nothing."""
    text = figures.render(figure, "svg").decode()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>\s*", "", text, flags=re.S)
    text = re.sub(r'<g id="[^"]*">', "<g>", text)
    text = re.sub(r"<!--.*?-->\s*", "", text, flags=re.S)
    root, rest = text.split(">", 1)
    box = re.search(r'viewBox="[^"]*"', root)
    for ink, name in (("#000000", "currentColor"), ("#dddddd", "var(--line)"), ("#555555", "var(--dim)"), ("#ffffff", "none")):
        rest = rest.replace(f": {ink}", f": {name}")
    return f'<svg class="figure" role="img" aria-label="Learning curve" {box[0] if box else ""}>{rest}'


def _number(value: float | None) -> str:
    return "none" if value is None or not np.isfinite(value) else f"{value:.6g}"


def _value(value: Any) -> str:
    return f"{ranges.words(value)}, by trial" if ranges.is_range(value) else ranges.shown(value)


def _names(names: Sequence[str]) -> str:
    return f" ({', '.join(map(clean, names))})" if names else ""


def _numbered(names: Sequence[str], noun: str, count: int) -> list[str]:
    return [clean(name) for name in names] if len(names) == count else [f"{noun} {i + 1}" for i in range(count)]


def _duration(seconds: float) -> str:
    if seconds < 120:
        return f"{seconds:.1f} s"
    return f"{seconds / 60:.1f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"


def _when(at: float) -> str:
    try:
        return time.strftime("%Y-%m-%d %H:%M:%S", time.gmtime(at))
    except (OverflowError, ValueError, OSError):  # no time that a calendar has
        return f"{at:.6g}"
