"""Check that the C program used as a benchmark for emergency-exit has the kernels' bits."""

import sys

import numpy as np
import pytest

from tests.repository import REPOSITORY
from zswarm.evaluate import build, evaluate
from zswarm.kernels.random import Stream

BENCHMARKS = REPOSITORY / "benchmarks"


def test_c_has_the_same_bits_as_emergency_exit(monkeypatch: pytest.MonkeyPatch) -> None:
    """Play both fields, one trial at a time and in lanes of eight.

    The last group of lanes is incomplete, and some trials end early.
    """
    monkeypatch.syspath_prepend(BENCHMARKS)
    import in_c

    if in_c.compiler() is None:
        pytest.skip("no C compiler")
    monkeypatch.delitem(sys.modules, "in_c")
    ways = [
        in_c.EmergencyExit(in_c.EXACT, side_by_side=side_by_side)
        for side_by_side in (False, True)
    ]
    rounds: set[float] = set()
    for settings in (
        {"field": "stadium"},
        {"field": "random"},
        {"field": "random", "agents": 1, "steps": 400},
    ):
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
