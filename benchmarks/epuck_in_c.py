"""Measure e-pucks in C beside zswarm's kernel: the same trials, on one core.

Three missions of docs/epuck.md, with random networks without hidden nodes. ``kernels/epuck.c`` is
compiled with -O3 -march=native, its network into the loop. The two take turns; the best round of
each counts, because other programs only ever slow it down.

    python benchmarks/epuck_in_c.py --rounds 5
"""

import argparse

import in_c
import numpy as np
from kernels import timed

from zswarm.evaluate import build, evaluate
from zswarm.kernels.random import Stream

MISSIONS = ("grid-exploration", "aggregation", "foraging")
NETWORK = {"hidden": [], "weight_range": 5.0, "bias_range": 5.0, "steepness": 4.924273}
CANDIDATES = 8


def compared(mission: str, peer: in_c.Epuck, rounds: int) -> tuple[float, float]:
    """Return agent-steps per second of CPU time of zswarm's kernel, and in C."""
    simulator, network = build("epuck", {"mission": mission}, "feed-forward", NETWORK)
    genomes = network.random(CANDIDATES, Stream(1))
    participants = np.arange(CANDIDATES)[:, None]
    trials = simulator, network, genomes, participants, np.zeros(CANDIDATES, np.uint64)
    steps = CANDIDATES * simulator.world.steps * simulator.world.number
    found = [
        [
            timed(lambda play=play: play(*trials), CANDIDATES, steps)["agent_steps_per_s"]
            for play in (evaluate, peer.evaluate)
        ]
        for _ in range(rounds)
    ]
    ours, theirs = map(max, zip(*found, strict=True))
    return ours, theirs


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=5, help="[default] 5")
    rounds = parser.parse_args().rounds
    peer = in_c.Epuck(in_c.FAST)
    for mission in MISSIONS:
        ours, theirs = compared(mission, peer, rounds)
        print(
            f"{mission:18} zswarm {ours / 1e3:7,.0f} k agent-steps/s, C {theirs / 1e3:7,.0f} k: "
            f"{theirs / ours:.2f} times the time of C",
            flush=True,
        )


if __name__ == "__main__":
    main()
