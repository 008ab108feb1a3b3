"""The C that arena is timed beside computes the same: its bits are those of the kernel."""

import sys

import numpy as np
import pytest

from tests.repository import REPOSITORY
from zswarm.evaluate import build, evaluate
from zswarm.kernels.random import Stream

BENCHMARKS = REPOSITORY / "benchmarks"


def test_c_has_the_same_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    """32 robots are in cells, 8 are not."""
    monkeypatch.syspath_prepend(BENCHMARKS)
    import in_c

    if in_c.compiler() is None:
        pytest.skip("no C compiler")
    monkeypatch.delitem(sys.modules, "in_c")
    exact = in_c.Arena(in_c.EXACT)
    for robots in (8, 32):
        settings = {"robots": robots, "side": robots**0.5, "steps": 200}
        simulator, network = build(
            "arena",
            settings,
            "fully-meshed",
            {"hidden": 6, "iterations": 1, "activation": "tanh"},
        )
        genomes, seeds = network.random(4, Stream(1)), np.arange(4, dtype=np.uint64)
        trials = simulator, network, genomes, np.arange(4)[:, None], seeds
        ours, (fitness, metrics) = evaluate(*trials), exact.evaluate(*trials)
        assert fitness.tobytes() == ours.fitness.tobytes()
        assert metrics.tobytes() == ours.metrics.tobytes()
