"""What dispatch costs and how fast whole runs are, on this machine: `make bench`.

- no-op: microseconds per candidate, 400 distinct candidates per generation, through zenoh and the slots' processes;
- sleep: efficiency with 5 ms of sleep per candidate: ideal time / time;
- emergency-exit: simulations per second of a whole NNGA run of 50 x 200, everything included but the start.

Medians; nothing else should run meanwhile.
"""

import contextlib
import os
import secrets
import socket
import statistics
import struct
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

SLOTS = (1, 2, 4, 8, 16)
POPULATION = 400
HIDDEN = 15  # with one input and one output: genomes of 288 float32
SLEEP_S = 0.005
NOOP_ROUNDS, SLEEP_ROUNDS = 30, 5

PLUGIN = '''
import time
import msgspec
import numpy as np
from zswarm.nets.fully_meshed import HEADER
from zswarm.sims.simulator import CompiledSimulator, Outcome, Turn


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    sleep_s: float = 0.0


class Sleep(CompiledSimulator):
    """Sleeps and says the genome's first number: a trial that costs nothing but its dispatch."""

    settings_type = Settings
    inputs, outputs, owners = 1, 1, (0,)

    def reset(self, seed):
        return Turn((0,), np.zeros((1, 1), np.float32))

    def step(self, actions):
        return None

    def outcome(self):
        return Outcome([0.0], [])

    def play(self, step, state_size, parameters, participants, seeds, progress, fitness, metrics):
        fitness[:, 0] = parameters[participants[:, 0], HEADER]
        if self.settings.sleep_s:
            for trial in range(len(seeds)):
                progress[0] = trial
                time.sleep(self.settings.sleep_s)
'''


def install_plugin(folder: Path) -> None:
    """Make the simulator known to this process and its children."""
    (folder / "zswarm_bench.py").write_text(PLUGIN)
    metadata = folder / "zswarm_bench-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: zswarm-bench\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text("[zswarm.simulators]\nbench-sleep = zswarm_bench:Sleep\n")
    sys.path.insert(0, str(folder))
    os.environ["PYTHONPATH"] = os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")])


@contextlib.contextmanager
def cluster(slots: int, sleep_s: float) -> Iterator[object]:
    """This machine's slots, so many, and an optimizer that has all of them ready."""
    from zswarm.ot.local import LocalServer

    with LocalServer(slots, "default") as local, leased(local.endpoint, slots, sleep_s) as opened:
        yield opened


@contextlib.contextmanager
def leased(endpoint: str, slots: int, sleep_s: float) -> Iterator[object]:
    """An optimizer that has all slots of a server ready, with the options that a run has by itself."""
    from zswarm import experiment
    from zswarm.ot.cluster import Cluster
    from zswarm.ot.requests import Wanted, Who
    from zswarm.protocol.messages import Part
    from zswarm.session import Reach
    from zswarm.version_hash import version_hash

    options = experiment.Cluster()
    wanted = Wanted(
        Part("bench-sleep", {"sleep_s": sleep_s}), Part("fully-meshed", {"hidden": HIDDEN}),
        version_hash("bench-sleep", "fully-meshed"),
        participants=1, metrics=0, trial_timeout_s=options.trial_timeout_s, trial_memory_mb=options.trial_memory_mb,
        slots=slots, quarantine=False, verify=options.verify, probe=b"",
    )  # fmt: skip
    who = Who("default", "bench", f"bench-{secrets.token_hex(4)}", 0, secrets.token_bytes(16))
    with Cluster(who, wanted, reach=Reach([endpoint], multicast=False)) as opened:
        for _ in opened.wait(1, 60.0):
            pass
        while opened.standing.slots < slots:
            time.sleep(0.01)
        yield opened


def free_port() -> int:
    """A port of this machine that nobody listens at."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        return free.getsockname()[1]


def random_genomes(size: int) -> list[bytes]:
    """Distinct candidates."""
    import numpy as np

    numbers = (HIDDEN + 1) * (HIDDEN + 3)
    return [genome.tobytes() for genome in np.random.default_rng().uniform(-2, 2, (size, numbers)).astype("<f4")]


def evaluated(opened: object, genomes: list[bytes]) -> list[float]:
    """The fitness of each."""
    import numpy as np

    from zswarm.ot.workload import Workload

    workload = Workload(genomes, np.arange(len(genomes)).reshape(-1, 1), np.zeros(len(genomes), np.uint64), 0)
    for _ in opened.evaluate(workload):
        pass
    return workload.fitness[:, 0].tolist()


def generation_s(opened: object, size: int) -> float:
    """Seconds for one generation of distinct candidates."""
    genomes = random_genomes(size)
    begin = time.perf_counter()
    fitness = evaluated(opened, genomes)
    elapsed = time.perf_counter() - begin
    if fitness != [struct.unpack_from("<f", genome)[0] for genome in genomes]:
        raise AssertionError("a candidate got another's fitness")
    return elapsed


def dispatch() -> None:
    """The first two tables."""
    print(f"{'slots':>6} {'no-op, us per candidate':>24} {'sleep 5 ms, efficiency':>24}")
    for slots in SLOTS:
        with cluster(slots, 0.0) as opened:
            times = [generation_s(opened, POPULATION) for _ in range(NOOP_ROUNDS)]
        with cluster(slots, SLEEP_S) as opened:
            sleeps = [generation_s(opened, POPULATION) for _ in range(SLEEP_ROUNDS)]
        ideal = POPULATION * SLEEP_S / slots
        noop = statistics.median(times[2:]) / POPULATION * 1e6
        print(f"{slots:>6} {noop:>24.1f} {ideal / statistics.median(sleeps[1:]):>24.3f}", flush=True)


def runs() -> None:
    """The third table; FREVO's numbers are quoted: both cores of an EPYC, whole command without start."""
    from zswarm import experiment
    from zswarm.ot import evolution
    from zswarm.ot.connection import Connection
    from zswarm.ot.logger import Logger

    print(f"\n{'field':>8} {'simulations/s':>14} {'x FREVO':>8}   (whole run, 50 x 200)")
    for name, frevo in (("stadium", 838), ("emergency-exit", 12740)):
        loaded = experiment.load(experiment.find(name), ["cluster.servers=local"])
        rates = []
        for _ in range(3):
            with (
                tempfile.TemporaryDirectory() as out,
                Connection(loaded.cluster) as connection,
                evolution.start(loaded, name, Path(out), connection, Logger()) as begun,
            ):
                result = begun.finish()
            rates.append(result.evaluations * loaded.problem.trials / result.seconds)
        rate = statistics.median(rates)
        print(f"{'stadium' if name == 'stadium' else 'random':>8} {rate:>14.0f} {rate / frevo:>8.1f}", flush=True)


def main() -> None:
    """All of it."""
    os.environ["ZSWARM_PLAIN"] = "1"  # this process evaluates nothing
    with tempfile.TemporaryDirectory() as folder:
        install_plugin(Path(folder))
        dispatch()
        runs()


if __name__ == "__main__":
    main()
