"""Simulated work: duration and fitness of a trial are drawn from genome and seed."""

import zlib

import msgspec
import numpy as np

from zswarm.ot.workload import Workload

CAPACITY = 4  # slots per server
TRIALS = 10  # of a candidate
GENOME = 400  # bytes


class Times(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The duration of trials: settings of the simulated work."""

    mean_s: float = 1.0
    # Or uniform: 0.5 to 1.5 times the mean; heavy: a Pareto tail, up to 20 times the mean
    spread: str = "none"
    # A trial takes this long everywhere; or execution: drawn anew where it is started again
    of: str = "trial"
    slow: float = 1.0  # times as long on the first server


def draws(
    genomes: list[bytes], participants: np.ndarray, seeds: np.ndarray, salt: int = 0
) -> np.ndarray:
    """Return (trials,) float64 in [0, 1), fixed by genome, seed and salt."""
    x = np.array([zlib.crc32(genome) for genome in genomes], np.uint64)[
        participants[:, 0]
    ]
    for more in (seeds, np.uint64(salt)):
        x = (x ^ more) * np.uint64(0x9E3779B97F4A7C15)
        x = (x ^ (x >> np.uint64(29))) * np.uint64(0xBF58476D1CE4E5B9)
        x ^= x >> np.uint64(32)
    return (x >> np.uint64(11)) * 2.0**-53


def durations(times: Times, numbers: np.ndarray) -> np.ndarray:
    """Return (trials,) seconds from numbers in [0, 1)."""
    match times.spread:
        case "uniform":
            return times.mean_s * (0.5 + numbers)
        case "heavy":
            return times.mean_s * np.minimum((1 - numbers) ** (-1 / 1.5) / 3, 20.0)
        case _:
            return np.full(len(numbers), times.mean_s)


def salt(times: Times, server: int) -> int:
    """Return what makes a server's draws its own."""
    return server + 1 if times.of == "execution" else 0


def speed(times: Times, server: int) -> float:
    """Return a server's speed."""
    return 1 / times.slow if server == 0 else 1.0


def work(generation: int, trials: int) -> Workload:
    """Return distinct genomes, each on 10 seeds."""
    population = trials // TRIALS
    bits = np.random.default_rng(generation).integers(
        0, 256, (population, GENOME), np.uint8
    )
    participants = np.repeat(np.arange(population), TRIALS).reshape(-1, 1)
    return Workload(
        [row.tobytes() for row in bits],
        participants,
        np.tile(np.arange(TRIALS, dtype=np.uint64), population),
        0,
    )
