"""The C that epuck is timed beside computes the same: its bits are those of the kernel."""

import sys

import numpy as np
import pytest

from tests.repository import REPOSITORY
from zswarm.evaluate import build, evaluate
from zswarm.kernels.random import Stream


def test_c_has_the_same_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    """With contacts: random controllers drive into walls and each other."""
    monkeypatch.syspath_prepend(REPOSITORY / "benchmarks")
    import in_c

    if in_c.compiler() is None:
        pytest.skip("no C compiler")
    monkeypatch.delitem(sys.modules, "in_c")
    exact = in_c.Epuck(in_c.EXACT)
    for mission in ("aggregation", "foraging", "grid-exploration"):
        settings = {"mission": mission, "seconds": 20.0}
        simulator, network = build("epuck", settings, "feed-forward", {"hidden": []})
        genomes, seeds = network.random(4, Stream(1)), np.arange(4, dtype=np.uint64)
        trials = simulator, network, genomes, np.arange(4)[:, None], seeds
        ours, (fitness, metrics) = evaluate(*trials), exact.evaluate(*trials)
        assert fitness.tobytes() == ours.fitness.tobytes(), mission
        assert metrics.tobytes() == ours.metrics.tobytes(), mission
