"""What the servers of every peer do with a candidate; the answer is the genome's first number, so that it can be checked."""

import struct
import time
from collections.abc import Callable

SLEEP_S = 0.005


def noop(genome: bytes) -> float:
    """No work."""
    return struct.unpack_from("<f", genome)[0]


def sleep(genome: bytes) -> float:
    """Five milliseconds that need no core."""
    time.sleep(SLEEP_S)
    return struct.unpack_from("<f", genome)[0]


def each(judge: Callable[[bytes], float], genomes: list[bytes]) -> list[float]:
    """Several candidates in one task."""
    return [judge(genome) for genome in genomes]
