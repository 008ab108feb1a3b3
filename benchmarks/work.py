"""What the servers of every peer do with a candidate; the answer is the genome's first number, so that it can be checked."""

import os
import struct
import time
from collections.abc import Callable

TASK_S = 0.005


def noop(genome: bytes) -> float:
    """No work."""
    return struct.unpack_from("<f", genome)[0]


def sleep(genome: bytes) -> float:
    """Five milliseconds that need no core."""
    time.sleep(TASK_S)
    return struct.unpack_from("<f", genome)[0]


def cpu(genome: bytes) -> float:
    """Five milliseconds of a core's time."""
    end = time.thread_time() + TASK_S
    while time.thread_time() < end:
        pass
    return struct.unpack_from("<f", genome)[0]


WORKS: dict[str, Callable[[bytes], float]] = {"noop": noop, "sleep": sleep, "cpu": cpu}


def each(judge: Callable[[bytes], float], genomes: list[bytes]) -> list[float]:
    """Several candidates in one task."""
    return [judge(genome) for genome in genomes]


def ideal_s(work: str, candidates: int, workers: int) -> float:
    """Seconds that so many workers of this machine would take if nothing were sent: the sleeps or the cores' time alone."""
    busy = min(workers, len(os.sched_getaffinity(0))) if work == "cpu" else workers
    return 0.0 if work == "noop" else candidates * TASK_S / busy
