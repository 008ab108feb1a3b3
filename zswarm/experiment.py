"""The experiment file: strict TOML, each default in one place (docs/experiment.md).

``load`` checks a file by itself. ``complete`` imports the parts that it names, checks their
settings and writes every default out. ``[cluster]`` takes no part in the history. ``[study]`` makes
several runs of one file: ``variants`` returns their experiments.

All functions raise ``ConfigError`` for what cannot be used.
"""

import contextlib
import functools
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import msgspec
import tomli_w
from msgspec import Meta
from msgspec.structs import asdict, replace

from zswarm.config import overrides as changes
from zswarm.config import ranges, settings_docs, studies
from zswarm.config.decode import convert, read
from zswarm.config.sections import (
    ABSOLUTE,
    AssessmentConfig,
    BudgetConfig,
    ClusterConfig,
    PartConfig,
    PartKind,
    Positive,
    ProblemConfig,
    RankingKind,
    RecordConfig,
    StopConfig,
    StudyConfig,
)
from zswarm.config.studies import LAST_SEED as LAST_SEED
from zswarm.config.suggest import nearest
from zswarm.config.toml_lines import located
from zswarm.errors import ConfigError, UnknownPlugin
from zswarm.plugins import registry as plugins
from zswarm.protocol import endpoint, keys, labels
from zswarm.system.text import clean

PARTS = studies.PARTS
SETTINGS = "problem.settings."


class Experiment(msgspec.Struct, frozen=True, kw_only=True):
    """A whole experiment."""

    name: str
    seed: int
    generations: int
    problem: ProblemConfig
    representation: PartConfig
    optimizer: PartConfig
    ranking: PartConfig = PartConfig(kind=ABSOLUTE, settings={})
    assessment: AssessmentConfig = AssessmentConfig()
    cluster: ClusterConfig
    record: RecordConfig = RecordConfig()
    stop: StopConfig = StopConfig()
    study: StudyConfig = StudyConfig()
    label: str = ""


class Variant(NamedTuple):
    """A setting of a study."""

    settings: dict[str, Any]  # changes by path
    experiment: (
        Experiment  # complete, with these changes, its label and budget, and no study
    )


class _File(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The file as it is written: a part's settings are in the same table as its kind."""

    name: Annotated[
        str, Meta(description="name of the run and of its folder", extra={"type": "id"})
    ]
    seed: Annotated[
        int, Meta(ge=0, le=LAST_SEED, description="determines everything random")
    ]
    generations: Annotated[Positive, Meta(description="generations to evolve")]
    problem: ProblemConfig
    representation: dict[str, Any]
    optimizer: dict[str, Any]
    ranking: dict[str, Any] = {}
    assessment: AssessmentConfig = AssessmentConfig()
    cluster: ClusterConfig = ClusterConfig()
    record: RecordConfig = RecordConfig()
    stop: StopConfig = StopConfig()
    study: StudyConfig = StudyConfig()
    label: Annotated[
        str,
        Meta(
            max_length=60,
            description="name of a study's setting in tables and figures, in place of what differs",
        ),
    ] = ""


TABLES: dict[str, type[msgspec.Struct]] = {
    "problem": ProblemConfig,
    "representation": PartKind,
    "optimizer": PartKind,
    "ranking": RankingKind,
    "assessment": AssessmentConfig,
    "cluster": ClusterConfig,
    "record": RecordConfig,
    "stop": StopConfig,
    "study": StudyConfig,
}
CHECKS: dict[str, Callable[[list[str], str], Any]] = {  # of [cluster]
    "connect": endpoint.check,
    "require": labels.requirements,
    "rank": labels.preferences,
}


def find(name: str) -> Path:
    """Return the file that an argument of ``run`` names: a path, or an example by name."""
    path = Path(name)
    if path.is_file():
        return path
    examples = {path.stem: path for path in examples_folder().glob("*.toml")}
    if name in examples:
        return examples[name]
    shown, known = clean(name), ", ".join(sorted(examples))
    file = path / "experiment.toml"
    if file.is_file():
        raise ConfigError(
            f"{shown}: a folder of a run or study; resume it with zswarm-ot resume, or name its "
            f"experiment, {clean(str(file))}"
        )
    if path.is_dir():
        raise ConfigError(f"{shown}: a folder; expected a file, or an example: {known}")
    meant = nearest(name, examples)
    if path.suffix == ".toml":
        raise ConfigError(
            f"{name}: no such file{meant}; zswarm-ot list names the examples"
        )
    raise ConfigError(f"{name}: no such file or example{meant}; examples are {known}")


def examples_folder() -> Path:
    """Return the folder of examples: in the installed package, or next to it in a checkout."""
    package = Path(__file__).parent
    installed = package / "examples"
    return installed if installed.is_dir() else package.parent / "examples"


def load(path: Path, overrides: Sequence[str] = ()) -> Experiment:
    """Read and check a file, except for the settings of the parts that it names.

    Args:
        overrides: ``a.b=value``. The value is TOML, otherwise a string. An override of a kind or
            simulator drops the file's settings of the previous one.
    """
    mapping = read(path)
    override(mapping, overrides)
    return check(mapping, str(path))


def override(mapping: dict[str, Any], overrides: Sequence[str]) -> None:
    """Change the mapping of a file as ``load`` does."""
    parsed = [changes.parse_override(override) for override in overrides]
    _drop_settings(mapping, dict(parsed))
    for text, (key, value) in zip(overrides, parsed, strict=True):
        changes.set_value(mapping, key, value, f"--set {text}")


def check(mapping: Mapping[str, Any], where: str) -> Experiment:
    """Convert the mapping of a file, with the checks of ``load``."""
    with located(where, lambda: mapping):
        file = convert(changes.with_flat_study(mapping, where), _File, where)
        _check_id(("name",), file.name, f"{where}: ")
        _check_cluster(file.cluster, f"{where}: ")
        tables = {
            "representation": file.representation,
            "optimizer": file.optimizer,
            "ranking": {"kind": ABSOLUTE, **file.ranking},
        }
        parts = {part: _part(table, part, where) for part, table in tables.items()}
    with located(where, lambda: mapping, "study"):
        studies.check(file.study, file.seed, f"{where}: study")
    return Experiment(**asdict(file) | parts)


def settings_with(
    settings: Mapping[str, Any], overrides: Sequence[str]
) -> dict[str, Any]:
    """Return a simulator's settings with overrides such as ``problem.settings.agents=20``."""
    changed: dict[str, Any] = changes.plain(settings)
    for override in overrides:
        path, value = changes.parse_override(override)
        if not path.startswith(SETTINGS):
            raise ConfigError(
                f"--set {override}: expected a simulator's setting, such as {SETTINGS}agents=20"
            )
        changes.set_value(
            changed, path.removeprefix(SETTINGS), value, f"--set {override}"
        )
    return changed


def complete(experiment: Experiment, where: str) -> Experiment:
    """Return the experiment with every default written out."""
    whole = _complete_one(experiment, where)
    if experiment.study != StudyConfig():
        variants(whole, where)
    return whole


def check_settings(experiment: Experiment, where: str) -> None:
    """Check the settings of the parts that are installed."""
    with contextlib.suppress(UnknownPlugin):
        complete(experiment, where)


def variants(complete: Experiment, where: str) -> list[Variant]:
    """Return the settings of a complete experiment's study; without one, only the experiment."""
    made: list[Variant] = []
    alone = replace(complete, study=StudyConfig())
    seen: dict[bytes, str] = {}
    names: set[str] = set()
    for settings, label in complete.study.settings():
        words = studies.in_words(settings)
        at = f"{where}: study: with {words}" if settings else where
        mapping = to_mapping(alone)
        _drop_settings(mapping, settings)
        for path, value in settings.items():
            changes.set_value(mapping, path, value, at)
        variant = _complete_one(check(mapping, at), at)
        whole = msgspec.json.encode(variant, order="sorted")
        if whole in seen:
            raise ConfigError(
                f"{where}: study: the same setting twice: {seen[whole]}, and {words}"
            )
        if label in names:
            raise ConfigError(
                f"{where}: study: two settings have the label {label!r}: they differ in "
                "values without a label"
            )
        seen[whole] = words
        names |= {label} - {""}
        made.append(Variant(settings, _labelled(variant, label, complete)))
    return made


def _labelled(variant: Experiment, label: str, whole: Experiment) -> Experiment:
    """Return a variant with its label, and the limits that the study's budget sets."""
    budget, stop, generations = whole.study.budget, variant.stop, variant.generations
    if budget != BudgetConfig():
        stop = replace(
            stop, evaluations=budget.evaluations, simulations=budget.simulations
        )
        each = max(1, budget.simulations // variant.problem.trials)
        generations = (
            budget.evaluations or each
        )  # a generation has one candidate at least
    return replace(variant, label=label, stop=stop, generations=generations)


def with_cluster(experiment: Experiment, changes: Mapping[str, Any]) -> Experiment:
    """Return the experiment with other ``[cluster]`` values; errors as ``cluster``."""
    values = {**msgspec.to_builtins(experiment.cluster), **changes}
    return replace(experiment, cluster=cluster(values))


def cluster(values: Mapping[str, Any]) -> ClusterConfig:
    """Convert the values of ``[cluster]``."""
    options = convert(values, ClusterConfig, "cluster")
    _check_cluster(options, "")
    if options.through_router and not options.connect and not options.multicast:
        raise ConfigError(
            "cluster.through_router: name the router in cluster.connect (--connect tcp/ROUTER:7466)"
        )
    return options


def top_level() -> list[settings_docs.Key]:
    """Return the keys of a file that are not tables."""
    return [key for key in settings_docs.keys(_File) if key.type_text != "table"]


def to_toml(experiment: Experiment) -> str:
    """Return the text of a file that ``load`` reads as the same experiment."""
    return tomli_w.dumps(to_mapping(experiment))


def to_mapping(experiment: Experiment) -> dict[str, Any]:
    """Return a mapping that ``check`` converts to the same experiment."""
    mapping: dict[str, Any] = msgspec.to_builtins(experiment)
    for part in PARTS:
        mapping[part] = {"kind": mapping[part]["kind"], **mapping[part]["settings"]}
    study, stop = mapping.pop("study"), mapping.pop("stop")
    if not experiment.label:
        del mapping["label"]
    if experiment.stop != StopConfig():
        mapping["stop"] = _without_none(stop)
    if experiment.study != StudyConfig():
        study["budget"] = {key: value for key, value in study["budget"].items() if value}
        mapping["study"] = {
            key: value for key, value in study.items() if value not in ({}, [])
        }
    return mapping


def slots_of_this_machine(options: ClusterConfig) -> int:
    """Return the number of this machine's slots to use."""
    return options.local_slots or os.cpu_count() or 1


def _complete_one(experiment: Experiment, where: str) -> Experiment:
    problem, used = experiment.problem, functools.partial(to_mapping, experiment)

    def imported(kind: Any, name: str, *path: str) -> Any:
        with located(where, used, *path):
            try:
                return plugins.load(kind, name)
            except UnknownPlugin as error:
                raise UnknownPlugin(f"{where}: {'.'.join(path)}: {error}") from error

    simulator = imported("simulator", problem.simulator, "problem", "simulator")
    kinds = {
        part: imported(part, getattr(experiment, part).kind, part, "kind")
        for part in PARTS
    }
    with located(where, used, "problem", "settings"):
        settings = ranges.complete(
            problem.settings, simulator.settings_type, f"{where}: problem.settings"
        )
    parts = {}
    for part, kind in kinds.items():
        given = getattr(experiment, part)
        with located(where, used, part):
            typed = convert(given.settings, kind.settings_type, f"{where}: {part}")
        parts[part] = replace(given, settings=_without_none(msgspec.to_builtins(typed)))
    return replace(
        experiment, problem=replace(problem, settings=_without_none(settings)), **parts
    )


def _without_none(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Drop None, because TOML has no null."""
    return {key: value for key, value in settings.items() if value is not None}


def _check_cluster(options: ClusterConfig, where: str) -> None:
    _check_id(("cluster", "realm"), options.realm, where)
    for key, check_texts in CHECKS.items():
        try:
            check_texts(getattr(options, key), f"{where}cluster.{key}")
        except ConfigError as error:
            raise ConfigError(str(error), ("cluster", key)) from None


def _check_id(path: tuple[str, ...], text: str, where: str) -> None:
    if not keys.is_id(text):
        raise ConfigError(
            f"{where}{'.'.join(path)}: expected {keys.ID_RULE}, not {text!r}", path
        )


def _part(table: Mapping[str, Any], part: str, where: str) -> PartConfig:
    settings = dict(table)
    kind = settings.pop("kind", None)
    if not isinstance(kind, str):
        expected = 'expected the name of one, such as kind = "..."'
        raise ConfigError(f"{where}: {part}: kind: {expected}", (part,))
    return PartConfig(kind=kind, settings=settings)


def _drop_settings(mapping: dict[str, Any], values: Mapping[str, Any]) -> None:
    """Drop the settings of each part and simulator that ``values``, by path, replace by another."""
    for name, key in {**dict.fromkeys(PARTS, "kind"), "problem": "simulator"}.items():
        table, path = mapping.get(name), f"{name}.{key}"
        if isinstance(table, dict) and path in values and values[path] != table.get(key):
            mapping[name] = {**table, "settings": {}} if name == "problem" else {}
