"""Points of charts: few, and no peak is lost."""

from pathlib import Path

import numpy as np
import pytest

from tests.ot.invented_record import written
from zswarm.ot.dashboard import downsample
from zswarm.ot.dashboard.rows import BatchRow
from zswarm.ot.record.reader import Run


def test_a_downsampled_curve_keeps_its_peaks(tmp_path: Path) -> None:
    run = Run(written(tmp_path, [number / 100 for number in range(99)] + [5.0]))
    whole, few = downsample.curve(run), downsample.curve(run, 10)
    assert whole["generation"] == list(range(100))
    assert few["generation"] == list(range(9, 100, 10))
    assert (few["best"][-1], max(few["high"]), min(few["low"])) == (5.0, 4.0, -1.0)
    assert whole["evaluations"][-1] == few["evaluations"][-1] == 300


def test_quartiles_are_of_the_candidates_of_some_generations(tmp_path: Path) -> None:
    run = Run(written(tmp_path, [1.0, 2.0, float("nan"), 4.0], candidates=5))
    assert downsample.spread(run)["median"] == pytest.approx([1.0, 2.0, 4.0], abs=1e-5)
    assert downsample.spread(run, 2)["generation"] == [1, 3]
    assert downsample.statistics(run)["values"]["mean"] == [0.0, 1.0, None, 3.0]


def test_champions_are_recorded_when_the_best_fitness_rises(tmp_path: Path) -> None:
    run = Run(written(tmp_path, [1.0, 1.0, 3.0, 3.0]))
    assert [one["generation"] for one in downsample.champions(run)] == [0, 2]


def test_busy_slots_add_up_to_what_was_computed() -> None:
    """Between batches of a server are gaps; two parallel slots are twice as high."""
    batches = [
        BatchRow(1, 0, 5, "a", 4.0, 10.0),
        BatchRow(2, 0, 5, "a", 2.0, 20.0),
        BatchRow(3, 0, 1, "b", 20.0, 20.0),
    ]
    found = downsample.busy(batches, {"a": 2}, np.linspace(0.0, 20.0, 21))
    assert found["b"] == [1.0] * 20
    assert found["a"] == [0.0] * 8 + [2.0] * 2 + [0.0] * 9 + [2.0]
