"""The settings of runs as rows of a report: their defaults, and what differs between groups."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import msgspec

from zswarm import experiment
from zswarm.config import ranges, sections
from zswarm.errors import UnknownPlugin
from zswarm.ot.record import stopping
from zswarm.ot.record.reader import Run
from zswarm.plugins import registry as plugins
from zswarm.plugins.used_settings import used_settings
from zswarm.system.text import clean

NO_LIMIT = "no limit"
ORDER = (
    *("name", "seed", "generations", "study", "stop", "problem", "representation"),
    *("optimizer", "ranking", "assessment", "cluster"),
)


class SettingRow(NamedTuple):
    """A key of the experiment."""

    key: str
    value: str
    default: str | None = None  # if it differs


class Contrast(NamedTuple):
    """The settings of groups of runs."""

    common: list[SettingRow]
    # By key, one for each group; None: the group has no such setting.
    differing: dict[str, list[SettingRow | None]]


def contrast(groups: Mapping[str, Sequence[SettingRow]]) -> Contrast:
    """Return what groups have in common, and by key what differs between them."""
    tables = [{row.key: row for row in rows} for rows in groups.values()]
    cells = {
        key: [table.get(key) for table in tables]
        for key in sorted({key: None for table in tables for key in table}, key=_place)
    }
    common = [row[0] for row in cells.values() if row[0] and len({*row}) == 1]
    differing = {key: row for key, row in cells.items() if len({*row}) > 1}
    return Contrast(common, differing)


def rows_of(runs: Sequence[Run]) -> list[SettingRow]:
    """Return the settings of a run, or of the repeats of one."""
    found: dict[str, dict[SettingRow, None]] = {}
    for run in runs:
        for row in settings_rows(run.experiment):
            found.setdefault(row.key, {})[row] = None
    names = dict.fromkeys(run.experiment.name for run in runs)
    rows = [
        SettingRow("name", ", ".join(names)),
        SettingRow("seed", _seeds([run.experiment.seed for run in runs])),
        SettingRow("generations", _generations(runs)),
    ]
    for key, several in found.items():
        values = dict.fromkeys(row.value for row in several)
        defaults = [row.default for row in several if row.default is not None]
        rows.append(SettingRow(key, " or ".join(values), next(iter(defaults), None)))
    return in_order(rows)


def study_rows(complete: experiment.Experiment) -> list[SettingRow]:
    """Return what a study gives each of its settings."""
    repeat, budget = complete.study.repeat, msgspec.to_builtins(complete.study.budget)
    return [
        SettingRow("study.repeat", str(repeat), "1" if repeat > 1 else None),
        *(
            SettingRow(f"study.budget.{key}", _value(limit), NO_LIMIT)
            for key, limit in budget.items()
            if limit
        ),
    ]


def in_order(rows: Sequence[SettingRow]) -> list[SettingRow]:
    """Return rows in the order of their tables."""
    return sorted(rows, key=lambda row: _place(row.key))


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
    unlimited = _defaults(sections.StopConfig)
    rows = [
        SettingRow(f"stop.{key}", _value(value), NO_LIMIT)
        for key, value in tables.get("stop", {}).items()
        if value != unlimited[key]
    ]
    for table, values, defaults in (
        ("problem", problem, _defaults(sections.ProblemConfig)),
        ("problem.settings", settings, _part_defaults("simulator", problem["simulator"])),
        ("representation", network, _part_defaults("representation", network["kind"])),
        ("optimizer", optimizer, _part_defaults("optimizer", optimizer["kind"])),
        ("ranking", ranking, ranking_defaults),
        ("assessment", tables["assessment"], _defaults(sections.AssessmentConfig)),
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


def _place(key: str) -> int:
    return ORDER.index(key.partition(".")[0])


def _generations(runs: Sequence[Run]) -> str:
    """Return how many generations runs have, of how many, and why they ended earlier."""
    done = [run.generations() for run in runs]
    limits = [run.experiment.generations for run in runs]
    if done == limits:
        return _numbers(done)
    why = [clean(stopping.ended(run.meta, run.experiment)) for run in runs]
    if len(runs) > 1:
        why = [text.partition(":")[0] for text in why]
    reasons = [text for text in dict.fromkeys(why) if text]
    if not all(run.finished for run in runs):
        reasons.append("not finished")
    text = f"{_numbers(done)} of at most {_numbers(limits)}"
    return f"{text}: {'; '.join(reasons)}" if reasons else text


def _numbers(values: Sequence[int]) -> str:
    """Return ``7`` or ``20 to 26``."""
    first, last = min(values), max(values)
    return str(first) if first == last else f"{first} to {last}"


def _seeds(values: Sequence[int]) -> str:
    """Return ``1 to 5``, or ``3, 8``."""
    found = sorted({*values})
    if len(found) > 2 and found[-1] - found[0] + 1 == len(found):
        return _numbers(found)
    return ", ".join(map(str, found))


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
