"""Explain a study before it starts: each of its settings, and the work of all runs together."""

import time
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import msgspec

from zswarm.experiment import Experiment
from zswarm.ot.build import build
from zswarm.ot.estimate import dry_run
from zswarm.ot.estimate.dry_run import (
    EXAMPLE_SERVERS,
    EXAMPLE_SLOTS,
    Explanation,
    TrialSample,
)
from zswarm.ot.study import effort, effort_table
from zswarm.ot.study.effort import Cell

SAMPLES_S = 3.0  # of trials, of all settings together


class Forecast(NamedTuple):
    """A study in numbers."""

    cells: list[Cell]
    explained: list[Explanation]  # of a run of each
    simulations: int  # of all runs, after the expected savings of racing
    seconds: float  # on this machine
    seconds_elsewhere: float
    record_bytes: int
    warnings: list[str]

    def for_programs(self, complete: Experiment) -> dict[str, Any]:
        """Return an object for JSON."""
        each = zip(effort_table.as_objects(self.cells), self.explained, strict=True)
        settings = [known | msgspec.to_builtins(one) for known, one in each]
        names = ("simulations", "seconds", "seconds_elsewhere", "record_bytes")
        return {
            "experiment": complete.name,
            "runs": complete.study.runs(),
            "settings": settings,
            **{name: getattr(self, name) for name in names},
            "warnings": self.warnings,
        }


def forecast(loaded: Experiment, complete: Experiment, cells: list[Cell]) -> Forecast:
    """Explain the runs of each setting; ``loaded`` is the study's file without defaults."""
    explained = list(_explained(cells))
    repeat = complete.study.repeat
    simulations, seconds = 0, 0.0
    for one in explained:
        played = repeat * (one.simulations_expected + one.assessment_simulations)
        simulations += played
        seconds += played * one.trial_s
    record = repeat * sum(one.record_bytes for one in explained)
    texts = by_text(cells, [one.warnings + one.unportable for one in explained])
    return Forecast(
        cells,
        explained,
        simulations,
        seconds / explained[0].slots,
        seconds / (EXAMPLE_SERVERS * EXAMPLE_SLOTS),
        record,
        [
            *(for_settings(text, names) for text, names in texts.items()),
            *effort.warnings(loaded, cells),
            *dry_run.too_large(record),
        ],
    )


def by_text(
    cells: Sequence[Cell], texts: Sequence[Sequence[str]]
) -> Mapping[str, list[str]]:
    """Return the labels of the settings that each text is about; none if it is about all."""
    found: dict[str, list[str]] = {}
    for cell, some in zip(cells, texts, strict=True):
        for text in some:
            found.setdefault(text, []).append(cell.label)
    return {
        text: names if len(names) < len(cells) else [] for text, names in found.items()
    }


def for_settings(text: str, names: Sequence[str]) -> str:
    """Return a text after the settings that it is about; ``names`` are none if it is about all."""
    return f"{effort.listed(names)}: {text}" if names else text


def _explained(cells: Sequence[Cell]) -> Iterator[Explanation]:
    """Explain each setting; play trials of different problems and networks for a few seconds."""
    samples: dict[str, TrialSample] = {}
    left = time.monotonic() + SAMPLES_S
    for cell in cells:
        complete = cell.experiment
        key = repr((complete.problem, complete.representation))
        if key not in samples and (not samples or time.monotonic() < left):
            problem, optimizer = build(complete)
            samples[key] = dry_run.time_trials(problem, optimizer.ask())
        yield dry_run.explain(
            complete, build(complete), samples.get(key) or _unknown(samples)
        )


def _unknown(samples: Mapping[str, TrialSample]) -> TrialSample:
    """Return the sample of a setting of which no trial was played."""
    mean = sum(one.trial_s for one in samples.values()) / len(samples)
    return TrialSample(mean, differs=False, same=False, failed=False, error="")
