"""Check the ``[study]`` of an experiment file."""

import itertools
import json
from collections.abc import Mapping
from typing import Any

from zswarm.config.sections import MAX_RUNS, StudyConfig
from zswarm.config.suggest import nearest
from zswarm.errors import ConfigError
from zswarm.system.text import clean

PARTS = ("representation", "optimizer", "ranking")
LAST_SEED = 2**63 - 2
MAX_SHOWN = 60  # characters of a value in an error


def check(study: StudyConfig, seed: int, where: str) -> None:
    """Raise ConfigError for a study that no experiment can have."""
    if (study.grid or study.variants) and study.listed:
        raise ConfigError(
            f"{where}: expected a grid or variants, or a list of settings, not both"
        )
    for name, values in study.variants.items():
        if not name.strip() or name != clean(name):
            raise ConfigError(
                f"{where}.variants: expected a printable name, not {name!r}"
            )
        for path in values:
            check_path(path, f"{where}.variants.{name}")
            if path in study.grid:
                raise ConfigError(
                    f"{where}: {path}: expected in the grid or the variants only"
                )
    for path, choices in study.grid.items():
        check_path(path, f"{where}.grid")
        if not choices:
            raise ConfigError(
                f"{where}.grid: {path}: expected a list of at least one value"
            )
    for path in itertools.chain.from_iterable(study.listed):
        check_path(path, f"{where}.list")
    if (runs := study.runs()) > MAX_RUNS:
        raise ConfigError(f"{where}: {runs:,} runs; expected {MAX_RUNS:,} at most")
    if seed + study.repeat - 1 > LAST_SEED:
        raise ConfigError(
            f"{where}: repeat: expected seed + repeat - 1, the last seed, to be {LAST_SEED} at most"
        )


def check_path(path: str, where: str) -> None:
    """Raise ConfigError for a path that a study cannot vary."""
    table, *keys_below = path.split(".")
    if table == "seed":
        raise ConfigError(
            f"{where}: seed: the runs of a setting have the seeds seed, seed + 1, ...; give their "
            "number as study.repeat"
        )
    varied = ("generations", "problem", *PARTS)
    if table not in varied or not all(keys_below):
        meant = nearest(table, varied) if table not in varied else ""
        raise ConfigError(
            f"{where}: '{clean(path)}'{meant}: expected generations, or a path below problem, "
            "representation, optimizer or ranking, such as optimizer.population"
        )


def in_words(settings: Mapping[str, Any]) -> str:
    """Return ``optimizer.population = 50, generations = 100``, for errors."""
    words = []
    for path, value in settings.items():
        text = clean(json.dumps(value, default=str))
        short = text if len(text) <= MAX_SHOWN else f"{text[: MAX_SHOWN - 3]}..."
        words.append(f"{clean(path)} = {short}")
    return ", ".join(words) or "nothing changed"
