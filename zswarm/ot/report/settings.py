"""The settings of an experiment as rows of a report, and which differ from their defaults."""

from typing import Any, NamedTuple

import msgspec

from zswarm import experiment
from zswarm.config import ranges, sections
from zswarm.errors import UnknownPlugin
from zswarm.plugins import registry as plugins
from zswarm.plugins.used_settings import used_settings


class SettingRow(NamedTuple):
    """A key of the experiment."""

    key: str
    value: str
    default: str | None = None  # if it differs


def settings_rows(complete: experiment.Experiment) -> list[SettingRow]:
    """Return every setting that is used; those of the ranking only if it is not the default.

    An unused setting of the simulator is left out, unless somebody changed it: then it says so.
    """
    tables = experiment.to_mapping(complete)
    problem, network, optimizer, ranking = (
        tables[key] for key in ("problem", "representation", "optimizer", "ranking")
    )
    settings = problem.pop("settings")
    ranking_defaults = _defaults(sections.RankingKind)
    ranking_defaults |= _part_defaults("ranking", ranking["kind"])
    if ranking["kind"] == sections.ABSOLUTE:
        ranking = {}
    used = used_settings("simulator", problem["simulator"], settings)
    rows = [SettingRow(key, str(tables[key])) for key in ("name", "seed", "generations")]
    for table, values, defaults in (
        ("problem", problem, _defaults(sections.ProblemConfig)),
        ("problem.settings", settings, _part_defaults("simulator", problem["simulator"])),
        ("representation", network, _part_defaults("representation", network["kind"])),
        ("optimizer", optimizer, _part_defaults("optimizer", optimizer["kind"])),
        ("ranking", ranking, ranking_defaults),
        ("cluster", tables["cluster"], _defaults(sections.ClusterConfig)),
    ):
        for key, value in values.items():
            default = defaults.get(key, value)
            shown = _value(default) if default != value else None
            text = _value(value)
            if table == "problem.settings" and key not in used:
                if shown is None:
                    continue
                text += " (not used)"
            rows.append(SettingRow(f"{table}.{key}", text, shown))
    return rows


def _value(value: Any) -> str:
    return (
        f"{ranges.words(value)}, by trial"
        if ranges.is_range(value)
        else ranges.shown(value)
    )


def _defaults(struct: type[msgspec.Struct]) -> dict[str, Any]:
    return {
        field.name: msgspec.to_builtins(
            field.default_factory()
            if field.default is msgspec.NODEFAULT
            else field.default
        )
        for field in msgspec.structs.fields(struct)
        if not field.required
    }


def _part_defaults(kind: plugins.Kind, name: str) -> dict[str, Any]:
    """Return the defaults of a part; none if it is not installed."""
    try:
        return _defaults(plugins.load(kind, name).settings_type)
    except UnknownPlugin:
        return {}
