"""Check that the kernel computes what its functions compute as plain Python, bit for bit."""

import numpy as np
from my_simulator import MySimulator, Settings

from zswarm.evaluate import evaluate
from zswarm.kernels.jit import interpreted
from zswarm.kernels.random import Stream
from zswarm.nets.fully_meshed import FullyMeshed, FullyMeshedSettings


def test_compiled_and_plain_trials_have_equal_bits() -> None:
    """Play two trials of each of three random networks; eight of the nine robots decide at once."""
    simulator = MySimulator(Settings(robots=9, steps=20))
    network = FullyMeshed(FullyMeshedSettings(), simulator.inputs, simulator.outputs)
    genomes = network.random(3, Stream(1))
    participants = np.array([[0], [0], [1], [1], [2], [2]])
    seeds = np.array([1, 2, 1, 2, 1, 2], np.uint64)
    compiled = evaluate(simulator, network, genomes, participants, seeds)
    with interpreted():
        plain = evaluate(simulator, network, genomes, participants, seeds)
    assert compiled.error == plain.error == ""
    assert compiled.fitness.tobytes() == plain.fitness.tobytes()
    assert compiled.metrics.tobytes() == plain.metrics.tobytes()
    assert len(np.unique(plain.fitness)) == len(seeds)
