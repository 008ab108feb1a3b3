"""Define what each peer's workers do with a candidate; the answer is the genome's first number."""

import os
import struct
import time
from collections.abc import Callable

TASK_S = 0.005


def noop(genome: bytes) -> float:
    """Do nothing."""
    return struct.unpack_from("<f", genome)[0]


def sleep(genome: bytes) -> float:
    """Sleep five milliseconds."""
    time.sleep(TASK_S)
    return struct.unpack_from("<f", genome)[0]


def cpu(genome: bytes) -> float:
    """Use five milliseconds of a core."""
    end = time.thread_time() + TASK_S
    while time.thread_time() < end:
        pass
    return struct.unpack_from("<f", genome)[0]


WORKS: dict[str, Callable[[bytes], float]] = {"noop": noop, "sleep": sleep, "cpu": cpu}


def each(judge: Callable[[bytes], float], genomes: list[bytes]) -> list[float]:
    """Evaluate several candidates in one task."""
    return [judge(genome) for genome in genomes]


def ideal_s(work: str, candidates: int, workers: int) -> float:
    """Return the seconds that the workers need without any messages."""
    busy = min(workers, len(os.sched_getaffinity(0))) if work == "cpu" else workers
    return 0.0 if work == "noop" else candidates * TASK_S / busy
