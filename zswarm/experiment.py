"""The experiment file: TOML, strict, every default once (docs/experiment.md).

``load`` checks what the file says by itself; ``complete`` imports the parts it names, checks their settings and writes every
default out. ``[cluster]`` takes no part in the history. ``[study]`` makes several runs of one file: ``variants`` has its
settings.
"""

import contextlib
import copy
import itertools
import json
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import msgspec
import tomli_w
from msgspec import Meta

from zswarm import endpoint, labels, plugins, ranges, settings_sheet, toml_line
from zswarm.errors import ConfigError, UnknownPlugin
from zswarm.nearest import nearest
from zswarm.protocol import keys
from zswarm.protocol.codec import clean
from zswarm.protocol.messages import MIN_MEMORY_MB, Megabytes
from zswarm.settings_sheet import Key
from zswarm.strict import convert, parse, read

Positive = Annotated[int, Meta(ge=1, le=1_000_000_000)]
LAST_SEED = 2**63 - 2
MAX_RUNS = 10_000  # of a study
MAX_DEPTH = 10  # tables in tables, in a study's settings
MAX_SHOWN = 60  # characters of a value
PARTS = ("representation", "optimizer", "ranking")
WORDS_OF_LABELS: dict[str, Any] = {"require": labels.requirements, "rank": labels.preferences}  # of [cluster], and who reads them
SETTINGS = "problem.settings."
ABSOLUTE = "absolute"  # the ranking of files that name none


class Problem(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """``[problem]``: what a candidate is judged by. Its fitness is the sum over its trials, in trial order."""

    simulator: Annotated[str, Meta(description="name of a simulator (`zswarm-ot list`)")]
    trials: Annotated[int, Meta(ge=1, le=100_000, description="trials that judge each candidate")] = 1
    seeds: Annotated[
        Literal["fixed", "fresh"],
        Meta(description="seeds of the trials: the same for the whole run, or new in each generation"),
    ] = "fixed"
    settings: Annotated[dict[str, Any], Meta(description="of the simulator: `[problem.settings]`, below")] = {}


class _Kind(msgspec.Struct, frozen=True, kw_only=True):
    """What every ``[representation]`` and ``[optimizer]`` says."""

    kind: Annotated[str, Meta(description="name of one (`zswarm-ot list`); its settings stand beside it")]


class _Ranking(msgspec.Struct, frozen=True, kw_only=True):
    """What ``[ranking]`` says, whatever the kind."""

    kind: Annotated[str, Meta(description="name of one (`zswarm-ot list`); its settings stand beside it")] = ABSOLUTE


class Part(msgspec.Struct, frozen=True, kw_only=True):
    """``[representation]``, ``[optimizer]`` or ``[ranking]``: a kind and its settings."""

    kind: Annotated[str, Meta(description="name of one (`zswarm-ot list`)")]
    settings: dict[str, Any]


class Cluster(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """``[cluster]``: who computes. Nothing here changes the result."""

    realm: Annotated[str, Meta(description="servers of the same realm are used", extra={"type": "id"})] = "default"
    servers: Annotated[
        Literal["auto", "local"] | Positive,
        Meta(
            description='"auto": this machine\'s slots and every server found; "local": this machine\'s slots only; a number: '
            "no slots of this machine, and that many servers are waited for, 10 s at most"
        ),
    ] = "auto"
    connect: Annotated[
        list[str],
        Meta(
            description="endpoints to dial: servers that multicast does not reach, or a router; such as "
            '"tcp/192.168.1.5:7467". Protocols: `tcp`, `tls`, `quic`, `ws`, `udp`, `unixsock-stream`'
        ),
    ] = []
    multicast: Annotated[bool, Meta(description="find servers by multicast")] = True
    through_router: Annotated[
        bool,
        Meta(
            description="reach the servers through a router alone: one of `connect`, or one that multicast finds "
            "([network.md](network.md)); this machine's slots are not concerned"
        ),
    ] = False
    local_slots: Annotated[
        int, Meta(ge=0, le=65_535, description='slots of this machine under "auto" and "local"; 0: one per core')
    ] = 0
    require: Annotated[
        list[str],
        Meta(
            description='what labels of servers must be, this machine\'s slots included, such as `["gpu=yes", "room=b12|b13", '
            '"name!=lab-3", "cores>=8"]`; others are not used ([mixed.md](mixed.md))'
        ),
    ] = []
    rank: Annotated[
        list[str],
        Meta(
            description='which servers are preferred, what counts most first: what labels should be (`"gpu=yes"`), or a label '
            'whose higher number comes first (`"cores"`; `"-cores"`: the lower) ([mixed.md](mixed.md))'
        ),
    ] = []
    max_slots: Annotated[
        int,
        Meta(
            ge=0,
            le=1_000_000_000,
            description="slots that a run holds at the same time, this machine's included; the best by `rank`. 0: all there are",
        ),
    ] = 0
    trial_timeout_s: Annotated[
        float, Meta(gt=0, le=1e9, description="seconds by the wall clock after which a trial is a fault")
    ] = 300.0
    trial_memory_mb: Annotated[
        Megabytes,
        Meta(
            description="memory that the process of a slot may take, itself (about 100) included, in MB; a trial that needs "
            "more is a fault, and servers that have less per slot are not used. 0: what each server gives",
            extra={"type": f"int, 0 or {MIN_MEMORY_MB} to 2^40"},
        ),
    ] = 0
    on_fault: Annotated[
        Literal["pause", "quarantine"],
        Meta(
            description='what to do when a trial failed three times by a crash, a timeout or a lack of memory: "pause" stops '
            'the run (exit code 1; `resume` tries again); "quarantine" counts the trial as NaN, goes on, and marks the result '
            "as faulted"
        ),
    ] = "pause"
    verify: Annotated[
        float,
        Meta(
            ge=0,
            le=1,
            description='share of the trials that a second server evaluates, too; see [protocol.md](protocol.md), "Verification"',
        ),
    ] = 0.0

    controller: Annotated[
        Literal["server", "optimizer"],
        Meta(
            description='where candidates decide: "server": they are sent, as genomes, and whole trials are played there; '
            '"optimizer": this program decides, and servers ask it in every turn of a trial, which takes some hundred times as '
            "long ([protocol.md](protocol.md#the-controller-at-the-optimizer))"
        ),
    ] = "server"
    messages: Annotated[
        Literal["turn", "agent"],
        Meta(
            description='what servers ask with `controller = "optimizer"`: "turn": one question for all agents that act; '
            '"agent": one for each'
        ),
    ] = "turn"

    def __post_init__(self) -> None:
        if self.messages != "turn" and self.controller != "optimizer":
            raise ValueError(f'messages: expected "turn", not "{self.messages}", where controller is not "optimizer"')
        if 0 < self.trial_memory_mb < MIN_MEMORY_MB:
            raise ValueError(f"trial_memory_mb: expected 0 or at least {MIN_MEMORY_MB}, not {self.trial_memory_mb}")


class Study(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """``[study]``: several runs of one file. It takes no part in the history of any."""

    repeat: Annotated[
        int, Meta(ge=1, le=MAX_RUNS, description="runs of each setting, with the seeds `seed`, `seed` + 1, ...")
    ] = 1
    at_once: Annotated[
        int, Meta(ge=0, le=100, description="runs that go on at the same time; 0: as many as keep the slots busy")
    ] = 0
    grid: Annotated[
        dict[str, list[Any]],
        Meta(description='paths and their values, such as `"optimizer.population" = [50, 100]`: every combination is a setting'),
    ] = {}
    listed: Annotated[
        list[dict[str, Any]],
        Meta(description="or just these settings: `[[study.list]]`, each with the paths and values that it changes"),
    ] = msgspec.field(default_factory=list, name="list")

    def settings(self) -> list[dict[str, Any]]:
        """What is changed of the experiment, setting by setting; the values of the grid's last key change first."""
        if self.listed:
            return [dict(setting) for setting in self.listed]
        return [dict(zip(self.grid, values, strict=True)) for values in itertools.product(*self.grid.values())]

    def runs(self) -> int:
        """How many."""
        return self.repeat * (len(self.listed) or math.prod(map(len, self.grid.values())))


class Experiment(msgspec.Struct, frozen=True, kw_only=True):
    """A whole experiment."""

    name: str
    seed: int
    generations: int
    problem: Problem
    representation: Part
    optimizer: Part
    ranking: Part = Part(kind=ABSOLUTE, settings={})
    cluster: Cluster
    study: Study = Study()


class Variant(NamedTuple):
    """A setting of a study."""

    settings: dict[str, Any]  # what it changes, by path
    experiment: Experiment  # complete, with these changes and no study


class _File(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The file as it is written: a part's settings stand beside its kind."""

    name: Annotated[str, Meta(description="name of the run; its folder is called so", extra={"type": "id"})]
    seed: Annotated[int, Meta(ge=0, le=LAST_SEED, description="everything random follows from it")]
    generations: Annotated[Positive, Meta(description="generations to evolve")]
    problem: Problem
    representation: dict[str, Any]
    optimizer: dict[str, Any]
    ranking: dict[str, Any] = {}
    cluster: Cluster = Cluster()
    study: Study = Study()


def find(name: str) -> Path:
    """The file that an argument of ``run`` names: a path, or an example by name.

    Raises:
        ConfigError: neither.
    """
    if Path(name).is_file():
        return Path(name)
    examples = {path.stem: path for path in examples_folder().glob("*.toml")}
    if name in examples:
        return examples[name]
    if (Path(name) / "experiment.toml").is_file():
        raise ConfigError(
            f"{clean(name)}: the folder of a run or study: zswarm-ot resume goes on with it; its experiment is in "
            f"{clean(str(Path(name) / 'experiment.toml'))}"
        )
    if Path(name).is_dir():
        raise ConfigError(f"{clean(name)}: a folder; expected a file, or an example: {', '.join(sorted(examples))}")
    raise ConfigError(
        f"{name}: no such file, and no example of that name{nearest(name, examples)}; examples are {', '.join(sorted(examples))}"
    )


def examples_folder() -> Path:
    """Where the examples are: in the installed package, or beside it in a checkout."""
    package = Path(__file__).parent
    installed = package / "examples"
    return installed if installed.is_dir() else package.parent / "examples"


def load(path: Path, overrides: Sequence[str] = ()) -> Experiment:
    """Read a file and check it, but for the settings of the parts it names.

    Args:
        overrides: ``a.b=value`` texts; the value is TOML, or a text where it is not. One that names another kind or simulator
            drops the settings that the file has for its own.

    Raises:
        ConfigError: the file cannot be read, is no TOML, or something in it is unknown or impossible.
    """
    mapping = read(path)
    changes = [_change(override) for override in overrides]
    _drop_settings(mapping, dict(changes))
    for override, (to, value) in zip(overrides, changes, strict=True):
        _set(mapping, to, value, f"--set {override}")
    return check(mapping, str(path))


def check(mapping: Mapping[str, Any], where: str) -> Experiment:
    """What a file would say, checked as ``load`` does.

    Raises:
        ConfigError: something in it is unknown or impossible.
    """
    with _on_its_line(where, mapping):
        file = convert(_flattened(mapping, where), _File, where)
        _check_ids({"name": file.name, "cluster.realm": file.cluster.realm}, f"{where}: ")
    with _on_its_line(where, mapping, "cluster", "connect"):
        endpoint.check(file.cluster.connect, f"{where}: cluster.connect")
    for key, read_texts in WORDS_OF_LABELS.items():
        with _on_its_line(where, mapping, "cluster", key):
            read_texts(getattr(file.cluster, key), f"{where}: cluster.{key}")
    with _on_its_line(where, mapping, "representation"):
        representation = _part(file.representation, f"{where}: representation")
    with _on_its_line(where, mapping, "optimizer"):
        optimizer = _part(file.optimizer, f"{where}: optimizer")
    with _on_its_line(where, mapping, "ranking"):
        ranking = _part({"kind": _Ranking().kind, **file.ranking}, f"{where}: ranking")
    with _on_its_line(where, mapping, "study"):
        study = _checked(file.study, file.seed, f"{where}: study")
    return Experiment(
        name=file.name,
        seed=file.seed,
        generations=file.generations,
        problem=file.problem,
        representation=representation,
        optimizer=optimizer,
        cluster=file.cluster,
        study=study,
        ranking=ranking,
    )


def changed(mapping: Mapping[str, Any], settings: Mapping[str, Any], where: str) -> dict[str, Any]:
    """What a file would say, with other values.

    Args:
        settings: the values by keys such as ``optimizer.population``.
        where: put before a key in an error.

    Raises:
        ConfigError: a key leads into something that is no table.
    """
    other: dict[str, Any] = _plain(mapping)
    for path, value in settings.items():
        _set(other, str(path), value, f"{where}: {path}")
    return other


def settings_with(settings: Mapping[str, Any], overrides: Sequence[str]) -> dict[str, Any]:
    """A simulator's settings, changed by ``problem.settings.a=value`` texts as ``load`` does.

    Raises:
        ConfigError: a text is another, or leads into something that is no table.
    """
    changed: dict[str, Any] = _plain(settings)
    for override in overrides:
        path, value = _change(override)
        if not path.startswith(SETTINGS):
            raise ConfigError(f"--set {override}: expected a setting of the simulator, such as {SETTINGS}agents=20")
        _set(changed, path.removeprefix(SETTINGS), value, f"--set {override}")
    return changed


def complete(experiment: Experiment, where: str) -> Experiment:
    """The experiment with every default written out.

    Raises:
        ConfigError: a named part is unknown, or its settings are impossible; also in a setting of its study.
    """
    whole = _complete_alone(experiment, where)
    if experiment.study != Study():
        variants(whole, where)
    return whole


def check_settings(experiment: Experiment, where: str) -> None:
    """Check the settings of those parts that are installed.

    Raises:
        ConfigError: one has impossible settings; also in a setting of the study.
    """
    with contextlib.suppress(UnknownPlugin):
        complete(experiment, where)


def variants(complete: Experiment, where: str) -> list[Variant]:
    """The settings of a complete experiment's study; without one, the experiment alone.

    Raises:
        ConfigError: a setting is impossible, or two are the same.
    """
    made: list[Variant] = []
    alone = msgspec.structs.replace(complete, study=Study())
    seen: dict[bytes, str] = {}
    for settings in complete.study.settings():
        words = _in_words(settings)
        at = f"{where}: study: with {words}" if settings else where
        mapping = to_mapping(alone)
        _drop_settings(mapping, settings)
        for path, value in settings.items():
            _set(mapping, path, copy.deepcopy(value), at)
        variant = _complete_alone(check(mapping, at), at)
        whole = msgspec.json.encode(variant, order="sorted")
        if whole in seen:
            raise ConfigError(f"{where}: study: the same setting twice: {seen[whole]}, and {words}")
        seen[whole] = words
        made.append(Variant(settings, variant))
    return made


def _complete_alone(experiment: Experiment, where: str) -> Experiment:
    with _on_its_line(where, experiment, "problem", "simulator"):
        simulator = _load("simulator", experiment.problem.simulator, f"{where}: problem.simulator")
    with _on_its_line(where, experiment, "representation", "kind"):
        representation = _load("representation", experiment.representation.kind, f"{where}: representation.kind")
    with _on_its_line(where, experiment, "optimizer", "kind"):
        optimizer = _load("optimizer", experiment.optimizer.kind, f"{where}: optimizer.kind")
    with _on_its_line(where, experiment, "ranking", "kind"):
        ranking = _load("ranking", experiment.ranking.kind, f"{where}: ranking.kind")
    with _on_its_line(where, experiment, "problem", "settings"):
        settings = ranges.complete(experiment.problem.settings, simulator.settings_type, f"{where}: problem.settings")
        settings = _without_none(settings)
    with _on_its_line(where, experiment, "representation"):
        network = _complete_part(experiment.representation, representation, f"{where}: representation")
    with _on_its_line(where, experiment, "optimizer"):
        proposing = _complete_part(experiment.optimizer, optimizer, f"{where}: optimizer")
    with _on_its_line(where, experiment, "ranking"):
        judging = _complete_part(experiment.ranking, ranking, f"{where}: ranking")
    return msgspec.structs.replace(
        experiment,
        problem=msgspec.structs.replace(experiment.problem, settings=settings),
        representation=network,
        optimizer=proposing,
        ranking=judging,
    )


def with_cluster(experiment: Experiment, changes: Mapping[str, Any]) -> Experiment:
    """The experiment with other ``[cluster]`` values.

    Raises:
        ConfigError: an impossible value, or values that do not go together.
    """
    return msgspec.structs.replace(experiment, cluster=cluster({**msgspec.to_builtins(experiment.cluster), **changes}))


def cluster(values: Mapping[str, Any]) -> Cluster:
    """What ``[cluster]`` would say.

    Raises:
        ConfigError: an impossible value, or values that do not go together.
    """
    options = convert(values, Cluster, "cluster")
    _check_ids({"cluster.realm": options.realm}, "")
    endpoint.check(options.connect, "cluster.connect")
    for key, read_texts in WORDS_OF_LABELS.items():
        read_texts(getattr(options, key), f"cluster.{key}")
    if options.through_router and not options.connect and not options.multicast:
        raise ConfigError("cluster.through_router: name the router in cluster.connect (--connect tcp/ROUTER:7466)")
    return options


def top_level() -> list[Key]:
    """The keys of a file outside of its tables."""
    return [key for key in settings_sheet.keys(_File) if key.type_text != "table"]


def tables() -> dict[str, type[msgspec.Struct]]:
    """The tables of a file and what their keys are; the settings of parts come on top."""
    named: dict[str, type[msgspec.Struct]] = {"representation": _Kind, "optimizer": _Kind, "ranking": _Ranking}
    return {
        field.name: found for field in msgspec.structs.fields(_File) if (found := named.get(field.name) or _struct(field.type))
    }


def to_toml(experiment: Experiment) -> str:
    """The text of a file that ``load`` reads to the same experiment."""
    return tomli_w.dumps(to_mapping(experiment))


def to_mapping(experiment: Experiment) -> dict[str, Any]:
    """What ``check`` makes the same experiment of; without a study where there is none."""
    mapping: dict[str, Any] = msgspec.to_builtins(experiment)
    for part in PARTS:
        mapping[part] = {"kind": mapping[part]["kind"], **mapping[part]["settings"]}
    study = mapping.pop("study")
    if experiment.study != Study():
        mapping["study"] = {key: value for key, value in study.items() if value not in ({}, [])}
    return mapping


def slots_of_this_machine(options: Cluster) -> int:
    """Slots of this machine to use."""
    return options.local_slots or os.cpu_count() or 1


def _struct(kind: Any) -> type[msgspec.Struct] | None:
    return kind if isinstance(kind, type) and issubclass(kind, msgspec.Struct) else None


@contextlib.contextmanager
def _on_its_line(where: str, said: Mapping[str, Any] | Experiment, *path: str) -> Iterator[None]:
    """What is wrong at or below a key is told with the line of the file, unless an override set it."""
    try:
        yield
    except ConfigError as error:
        full = (*path, *error.path)
        try:
            text = Path(where).read_text(encoding="utf-8")
            written = toml_line.value(parse(text), full)
            now = toml_line.value(to_mapping(said) if isinstance(said, Experiment) else said, full)
            same = written is not None and repr(written) == repr(now)  # 1 == 1.0 == True
            line = toml_line.find(text, full) if same else None
        except (OSError, ValueError, RecursionError):  # the last: nested too deep
            raise error from None
        if line is None:
            raise type(error)(str(error), full) from error
        raise type(error)(f"{where}:{line}{str(error).removeprefix(where)}", full) from error


def _flattened(mapping: Mapping[str, Any], where: str) -> Mapping[str, Any]:
    """The file with its study's settings by path: a table in them is as good as a path with dots."""
    study = mapping.get("study")
    if not isinstance(study, Mapping):
        return mapping
    flat = dict(study)
    if isinstance(grid := flat.get("grid"), Mapping):
        flat["grid"] = _by_path(grid, f"{where}: study.grid")
    if isinstance(rows := flat.get("list"), list):
        flat["list"] = [_by_path(row, f"{where}: study.list") if isinstance(row, Mapping) else row for row in rows]
    return {**mapping, "study": flat}


def _by_path(tables: Mapping[str, Any], where: str) -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for path, value in _leaves(tables, "", where):
        if path in flat:
            raise ConfigError(f"{where}: {path} is there twice")
        flat[path] = value
    return flat


def _leaves(tables: Mapping[str, Any], above: str, where: str) -> Iterator[tuple[str, Any]]:
    if above.count(".") > MAX_DEPTH:
        raise ConfigError(f"{where}: nested too deep")
    for key, value in tables.items():
        if isinstance(value, Mapping) and not ranges.is_range(value):
            yield from _leaves(value, f"{above}{key}.", where)
        else:
            yield f"{above}{key}", value


def _checked(study: Study, seed: int, where: str) -> Study:
    if study.grid and study.listed:
        raise ConfigError(f"{where}: expected a grid or a list of settings, not both")
    for path, values in study.grid.items():
        _check_path(path, f"{where}.grid")
        if not values:
            raise ConfigError(f"{where}.grid: {path}: expected a list of at least one value")
    for setting in study.listed:
        for path in setting:
            _check_path(path, f"{where}.list")
    if (runs := study.runs()) > MAX_RUNS:
        raise ConfigError(f"{where}: {runs:,} runs; expected {MAX_RUNS:,} at most")
    if seed + study.repeat - 1 > LAST_SEED:
        raise ConfigError(f"{where}: repeat: the last seed, seed + repeat - 1, is {LAST_SEED} at most")
    return study


def _check_path(path: str, where: str) -> None:
    table, *keys_below = path.split(".")
    if table == "seed":
        raise ConfigError(
            f"{where}: seed: the runs of a setting have the seeds seed, seed + 1, ...; say how many with study.repeat"
        )
    varied = ("generations", "problem", *PARTS)
    if table not in varied or not all(keys_below):
        meant = nearest(table, varied) if table not in varied else ""
        raise ConfigError(
            f"{where}: '{clean(path)}'{meant}: expected generations, or a path below problem, representation, "
            "optimizer or ranking, such as optimizer.population"
        )


def _in_words(settings: Mapping[str, Any]) -> str:
    """``optimizer.population = 50, generations = 100``; for errors."""
    return ", ".join(f"{clean(path)} = {_shown(value)}" for path, value in settings.items()) or "nothing changed"


def _shown(value: Any) -> str:
    text = clean(json.dumps(value, default=str))
    return text if len(text) <= MAX_SHOWN else f"{text[: MAX_SHOWN - 3]}..."


def _check_ids(texts: Mapping[str, str], where: str) -> None:
    for key, text in texts.items():
        if not keys.is_id(text):
            raise ConfigError(f"{where}{key}: expected {keys.ID_RULE}, not {text!r}", tuple(key.split(".")))


def _part(mapping: Mapping[str, Any], where: str) -> Part:
    kind = mapping.get("kind")
    if not isinstance(kind, str):
        raise ConfigError(f'{where}: kind: expected the name of one, such as kind = "..."')
    return Part(kind=kind, settings={key: value for key, value in mapping.items() if key != "kind"})


def _load(kind: plugins.Kind, name: str, where: str) -> Any:
    try:
        return plugins.load(kind, name)
    except UnknownPlugin as error:
        raise UnknownPlugin(f"{where}: {error}") from error


def _complete_part(part: Part, loaded: Any, where: str) -> Part:
    return Part(kind=part.kind, settings=_complete(part.settings, loaded, where))


def _complete(settings: Mapping[str, Any], loaded: Any, where: str) -> dict[str, Any]:
    complete: dict[str, Any] = msgspec.to_builtins(convert(settings, loaded.settings_type, where))
    return _without_none(complete)


def _without_none(settings: Mapping[str, Any]) -> dict[str, Any]:
    """TOML has no null."""
    return {key: value for key, value in settings.items() if value is not None}


def _change(override: str) -> tuple[str, Any]:
    """The path and the value of an ``a.b=value``."""
    path, equals, text = override.partition("=")
    if not equals or not path.strip():
        raise ConfigError(f"--set {override}: expected key=value, such as optimizer.population=100")
    try:
        value = parse(f"value = {text}")["value"]
    except ValueError:
        value = text
    return path.strip(), value


def _drop_settings(mapping: dict[str, Any], changes: Mapping[str, Any]) -> None:
    """Another kind or simulator has its own settings: where changes, by path, name one, those of the former go."""
    for part in PARTS:
        if isinstance(table := mapping.get(part), dict) and changes.get(f"{part}.kind", table.get("kind")) != table.get("kind"):
            mapping[part] = {}
    problem = mapping.get("problem")
    before = problem.get("simulator") if isinstance(problem, dict) else None
    if isinstance(problem, dict) and changes.get("problem.simulator", before) != before:
        problem["settings"] = {}


def _set(mapping: dict[str, Any], path: str, value: Any, where: str) -> None:
    """Set what a path with dots leads to; tables that are missing are made."""
    *tables, key = path.split(".")
    for table in tables:
        mapping = mapping.setdefault(table, {})
        if not isinstance(mapping, dict):
            raise ConfigError(f"{where}: {table} is no table")
    mapping[key] = _plain(value)


def _plain(value: Any) -> Any:
    """As a file would have it: numpy's numbers and arrays are as good as Python's."""
    if hasattr(value, "tolist"):
        return value.tolist()
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, (list, tuple, range)) else value
