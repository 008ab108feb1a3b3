"""The C that emergency-exit is timed beside computes the same: its bits are those of the kernels."""

import sys
from pathlib import Path

import numpy as np
import pytest

from zswarm.draws import Stream
from zswarm.evaluate import build, evaluate

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


def test_c_has_the_same_bits_as_emergency_exit(monkeypatch: pytest.MonkeyPatch) -> None:
    """On both fields, one trial after the other and eight side by side; some lanes are left over, and some trials end early."""
    monkeypatch.syspath_prepend(BENCHMARKS)
    import in_c

    if in_c.compiler() is None:
        pytest.skip("no C compiler")
    monkeypatch.delitem(sys.modules, "in_c")
    ways = [in_c.EmergencyExit(in_c.EXACT, side_by_side=side_by_side) for side_by_side in (False, True)]
    rounds: set[float] = set()
    for settings in ({"field": "stadium"}, {"field": "random"}, {"field": "random", "agents": 1, "steps": 400}):
        simulator, network = build("emergency-exit", settings, "fully-meshed", {})
        genomes, seeds = network.random(60, Stream(1)), np.arange(60, dtype=np.uint64)
        trials = simulator, network, genomes, np.arange(60)[:, None], seeds
        ours = evaluate(*trials)
        rounds.update(ours.metrics[:, 1])
        for way in ways:
            fitness, metrics = way.evaluate(*trials)
            assert fitness.tobytes() == ours.fitness.tobytes()
            assert metrics.tobytes() == ours.metrics.tobytes()
    assert len(rounds) > 3
