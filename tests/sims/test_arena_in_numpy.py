"""The numpy that arena is timed beside computes the same, but for the last bits."""

import numpy as np
import pytest

from tests.repository import REPOSITORY
from zswarm.evaluate import build, evaluate
from zswarm.kernels.random import Stream

BENCHMARKS = REPOSITORY / "benchmarks"


@pytest.mark.parametrize("robots", [8, 64])
def test_numpy_computes_the_same(robots: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Walls, contacts and neighbours are there; 64 robots are in cells, 8 are not."""
    monkeypatch.syspath_prepend(BENCHMARKS)
    import in_numpy

    settings = {"robots": robots, "side": 0.6 * robots**0.5, "steps": 25}
    simulator, network = build(
        "arena",
        settings,
        "fully-meshed",
        {"hidden": 6, "iterations": 1, "activation": "tanh"},
    )
    genomes, seeds = network.random(16, Stream(1)), np.arange(16, dtype=np.uint64)
    trials = simulator, network, genomes, np.arange(16)[:, None], seeds
    ours, (fitness, metrics) = evaluate(*trials), in_numpy.Arena(*trials).play()
    np.testing.assert_allclose(fitness, ours.fitness[:, 0], atol=1e-4)
    np.testing.assert_allclose(metrics[:, :2], ours.metrics[:, :2], rtol=1e-3)
    np.testing.assert_allclose(metrics[:, 2], ours.metrics[:, 2], atol=0.1)
    assert ours.metrics[:, 2].mean() > 0.5
