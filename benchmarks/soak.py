"""Look for growth: real servers and optimizers that come and go for minutes (`make soak`).

One long `zswarm-ot run` of short evaluations, on two `zswarm-ss` that stay and on four more that
come and go: they are killed, drained, started again. Beside it short runs follow one another; they
connect to the servers that stay, evaluate on one that serves them only, and on slots of their own.
Every 2 s the memory, open files, threads and files in /dev/shm of each process that stays are
noted. After a warm-up the slope of memory (Theil-Sen: the median of the slopes between all pairs of
samples) must stay below 0.5 MB a minute, and the rest must not grow; else the exit code is 1. The
record grows by design: its size is told.
"""

import argparse
import contextlib
import heapq
import itertools
import json
import os
import random
import secrets
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from usage import Usage, children, usage

SAMPLE_S = 2.0
# Zenoh keeps something of each query until its timeout, 60 s: until then memory grows.
WARM_UP_S = 90.0
WATCHED_S = 300.0
EVALUATIONS = 1_000_000
SLOPE_MB = 0.5  # a minute
# Between the quiet samples of the first and last third.
GROWTH = {"descriptors": 4, "threads": 2, "shm": 0}
LIMIT_S = 1800.0
COMING_AND_GOING = 4
ENOUGH = 8  # samples
SMALL = [
    "emergency-exit",
    "--set",
    "problem.trials=1",
    "--set",
    "problem.settings.steps=5",
    "--set",
    "problem.settings.agents=2",
    "--no-multicast",
]

Actor = Iterator[float]  # yields the seconds until it continues


class Grown(NamedTuple):
    """The growth of a process while it was watched."""

    name: str
    slope: float  # MB a minute
    first: Usage  # its quiet samples of the first third
    last: Usage  # and of the last
    samples: int
    complaints: list[str]


def theil_sen(times: np.ndarray, values: np.ndarray) -> float:
    """Return the median slope between all pairs of points."""
    i, j = np.triu_indices(len(times), 1)
    return float(np.median((values[j] - values[i]) / (times[j] - times[i])))


def judge(name: str, samples: list[tuple[float, Usage]]) -> Grown:
    """Return what grew, from samples with times in seconds."""
    values = np.array([usage for _, usage in samples], float)
    slope = theil_sen(np.array([when for when, _ in samples]), values[:, 0]) * 60
    third = max(1, len(samples) // 3)
    # The lower quartile: connections come and go, and a leak stays.
    first, last = (
        Usage(*np.quantile(part, 0.25, axis=0))
        for part in (values[:third], values[-third:])
    )
    complaints = [f"memory grows by {slope:.2f} MB a minute"] if slope > SLOPE_MB else []
    for what, allowed in GROWTH.items():
        if getattr(last, what) > getattr(first, what) + allowed:
            complaints.append(
                f"{what} grow from {getattr(first, what):.0f} to {getattr(last, what):.0f}"
            )
    return Grown(name, slope, first, last, len(samples), complaints)


# ---- programs ----------------------------------------------------------------------------------


class Programs:
    """The started programs, in a separate folder; all end with this context."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.temporary = folder / "tmp"
        self.temporary.mkdir()
        self._running: list[subprocess.Popen[bytes]] = []
        self._count = itertools.count()
        # Meets no other server of this machine
        self._net = f"127.{secrets.randbelow(253) + 1}.{secrets.randbelow(254)}.1"

    def endpoint(self, index: int) -> str:
        """Return a server's endpoint."""
        return f"tcp/{self._net}:{21000 + index}"

    def start(self, *arguments: str) -> tuple["subprocess.Popen[bytes]", Path, Path]:
        """Start one of our programs, with files for output and errors."""
        out, err = (
            self.folder / f"{next(self._count)}.{what}" for what in ("out", "err")
        )
        with out.open("wb") as stdout, err.open("wb") as stderr:
            process = subprocess.Popen(
                [sys.executable, *arguments],
                stdin=subprocess.DEVNULL,
                stdout=stdout,
                stderr=stderr,
                cwd=self.folder,
                env=os.environ | {"TMPDIR": str(self.temporary)},
            )
        self._running = [
            running for running in self._running if running.poll() is None
        ] + [process]
        return process, out, err

    def server(self, index: int) -> tuple["subprocess.Popen[bytes]", Callable[[], bool]]:
        """Start a server and wait until it is ready."""
        process, _, err = self.start(
            "-m",
            "zswarm.ss",
            "--name",
            f"s{index}",
            "--capacity",
            "1",
            "--no-multicast",
            "--listen",
            self.endpoint(index),
        )

        def ready() -> bool:
            if process.poll() not in (None, -signal.SIGKILL):
                raise SystemExit(
                    f"a server ended with {process.poll()}: {err.read_text()[-2000:]}"
                )
            return "server_ready" in err.read_text()

        return process, ready

    def logs(self, count: int) -> str:
        """Return the ends of the first programs' logs."""
        return "\n".join(
            (self.folder / f"{2 * number + 1}.err").read_text()[-2000:]
            for number in range(count)
        )

    def close(self) -> None:
        """End all programs."""
        for process in self._running:
            if process.poll() is None:
                process.kill()
            process.wait()


def coming_and_going(
    programs: Programs, index: int, counts: dict[str, int], draw: random.Random
) -> Actor:
    """Run a server that is ended by SIGKILL or SIGTERM and restarted again and again."""
    yield 5.0 * (index - 2)  # the first time, it is a server that joins
    for turn in itertools.count():
        process, ready = programs.server(index)
        while not ready():
            yield 0.2
        yield draw.uniform(3.0, 12.0)
        killed = (turn + index) % 2
        process.send_signal(signal.SIGKILL if killed else signal.SIGTERM)
        while process.poll() is None:
            yield 0.2
        counts["killed" if killed else "drained"] += 1
        yield draw.uniform(0.2, 2.0)


def short_runs(programs: Programs, connect: list[str], counts: dict[str, int]) -> Actor:
    """Run short runs one after another."""
    for turn in itertools.count():
        process, _, err = programs.start(
            "-m",
            "zswarm.ot",
            "run",
            *SMALL,
            *(f"--connect={endpoint}" for endpoint in connect),
            "--set",
            "generations=3",
            "--set",
            "optimizer.population=100",
            "--set",
            "cluster.local_slots=1",
            "--seed",
            str(turn),
            "--out",
            "short",
        )
        while process.poll() is None:
            yield 0.2
        if process.returncode:
            raise SystemExit(
                f"a short run ended with {process.returncode}: {err.read_text()[-2000:]}"
            )
        counts["short runs"] += 1
        yield 1.0


def leak() -> None:
    """Grow by 6 MB a minute, to see the test fail."""
    hoard = []
    while True:
        hoard.append(os.urandom(200_000))
        time.sleep(SAMPLE_S)


# ---- the test ----------------------------------------------------------------------------------


def family(name: str, pid: int) -> dict[str, int]:
    """Return a server's processes: its own, the fork server, the slots."""
    found = {name: pid}
    for child in children(pid):
        slots = children(child)
        found |= {f"{name} fork server": child} if slots else {f"{name} tracker": child}
        found |= {f"{name} slot": slot for slot in slots}
    return found


def evaluations(out: Path) -> int:
    """Return the long run's evaluations so far."""
    lines = out.read_bytes().splitlines()[-2:]
    counts = [json.loads(line)["evaluations"] for line in lines if line.endswith(b"}")]
    return max(counts, default=0)


def soak(
    programs: Programs,
    *,
    warm_up_s: float,
    watched_s: float,
    wanted: int,
    with_leak: bool,
) -> bool:
    """Run everything, print what grew, return whether all is well."""
    counts = {"killed": 0, "drained": 0, "short runs": 0}
    staying = [programs.server(index) for index in range(3)]
    while not all(ready() for _, ready in staying):
        time.sleep(0.1)
    connect = [
        programs.endpoint(index) for index in (0, 1, *range(3, 3 + COMING_AND_GOING))
    ]
    optimizer, out, err = programs.start(
        "-m",
        "zswarm.ot",
        "run",
        *SMALL,
        *(f"--connect={endpoint}" for endpoint in connect),
        "--servers",
        "2",
        "--json",
        "--set",
        "generations=1000000",
        "--set",
        "optimizer.population=400",
        "--set",
        "name=long",
        "--out",
        "long",
    )
    pids = {"optimizer": optimizer.pid}
    if with_leak:
        pids["leak"] = programs.start(__file__, "--leak-here")[0].pid
    while not evaluations(out):
        if optimizer.poll() is not None:
            raise SystemExit(
                f"the long run ended with {optimizer.returncode}: {err.read_text()[-2000:]}"
            )
        time.sleep(0.1)
    for index, (process, _) in enumerate(staying):
        pids |= family(f"server {index}", process.pid)
    draw = random.Random(1)
    actors = [
        coming_and_going(programs, 3 + i, counts, draw) for i in range(COMING_AND_GOING)
    ]
    actors.append(
        short_runs(programs, [programs.endpoint(index) for index in range(3)], counts)
    )
    begin = time.monotonic()
    order = itertools.count()
    agenda = [(begin, next(order), actor) for actor in actors]
    samples: dict[str, list[tuple[float, Usage]]] = {name: [] for name in pids}
    next_sample, counted = begin, 0
    while (
        elapsed := time.monotonic() - begin
    ) < warm_up_s + watched_s or counted < wanted:
        if elapsed > LIMIT_S:
            raise SystemExit(f"{counted:,} of {wanted:,} evaluations in {LIMIT_S:g} s")
        if time.monotonic() >= next_sample:
            next_sample += SAMPLE_S
            counted = evaluations(out)
            for name, pid in pids.items():
                now = usage(pid)
                if now is None:
                    raise SystemExit(
                        f"{name} ended; the logs of the servers that "
                        f"stay:\n{programs.logs(len(staying))}"
                    )
                if elapsed > warm_up_s:
                    samples[name].append((elapsed, now))
        while agenda[0][0] <= time.monotonic():
            _, _, actor = heapq.heappop(agenda)
            heapq.heappush(agenda, (time.monotonic() + next(actor), next(order), actor))
        time.sleep(max(0.0, min(next_sample, agenda[0][0]) - time.monotonic()))
    record = {
        path.name: path.stat().st_size / 1e6
        for path in (programs.folder / "long" / "long").glob("run.sqlite*")
    }
    optimizer.send_signal(signal.SIGINT)
    ended = optimizer.wait(60)
    return report(
        [judge(name, each) for name, each in samples.items()],
        counted,
        elapsed,
        counts,
        record,
        programs,
        ended,
    )


def report(
    grown: list[Grown],
    counted: int,
    elapsed: float,
    counts: dict[str, int],
    record: dict[str, float],
    programs: Programs,
    ended: int,
) -> bool:
    """Print the report and return whether nothing grew."""
    print(
        f"{counted:,} evaluations in {elapsed:.0f} s beside: "
        f"{', '.join(f'{n} {what}' for what, n in counts.items())}\n"
    )
    print("| process | memory, MB | MB a minute | open files | threads | in /dev/shm |")
    print("| --- | --- | --- | --- | --- | --- |")
    for each in grown:
        spans = [
            f"{getattr(each.first, what):.0f}, {getattr(each.last, what):.0f}"
            for what in ("descriptors", "threads", "shm")
        ]
        print(
            f"| {each.name} | {each.first.rss_mb:.1f}, {each.last.rss_mb:.1f} | {each.slope:+.3f} "
            f"| {' | '.join(spans)} |"
        )
    sizes = ", ".join(f"{name} {size:.1f} MB" for name, size in sorted(record.items()))
    left = len(list(programs.temporary.iterdir()))
    print(
        f"\nThe record, by design: {sizes}. In the folder of temporary files, with programs still "
        f"there: {left}."
    )
    complaints = [f"{each.name}: {text}" for each in grown for text in each.complaints]
    complaints += [
        f"{each.name}: {each.samples} samples are too few"
        for each in grown
        if each.samples < ENOUGH
    ]
    complaints += [f"the long run ended with {ended}, not 130"] if ended != 130 else []
    for text in complaints:
        print(f"FAILED: {text}")
    return not complaints


def main() -> None:
    """Parse and soak."""
    parser = argparse.ArgumentParser(
        description="Whether anything grows while servers and runs come and go."
    )
    parser.add_argument("--quick", action="store_true", help="8 s: whether it works")
    parser.add_argument("--leak", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--leak-here", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.leak_here:
        leak()
    with (
        tempfile.TemporaryDirectory(prefix="zswarm-soak-") as folder,
        contextlib.ExitStack() as stack,
    ):
        programs = Programs(Path(folder))
        stack.callback(programs.close)
        times = (
            (2.0, 6.0, 1_000) if options.quick else (WARM_UP_S, WATCHED_S, EVALUATIONS)
        )
        well = soak(
            programs,
            warm_up_s=times[0],
            watched_s=times[1],
            wanted=times[2],
            with_leak=options.leak,
        )
    sys.exit(0 if well or options.quick else 1)  # 8 s say nothing of growth


if __name__ == "__main__":
    main()
