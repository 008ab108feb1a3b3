"""Run generations on zswarm slots that do nothing, sleep or burn time, as a run uses them."""

import contextlib
import os
import secrets
import socket
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NoReturn

from work import TASK_S

HIDDEN = 15  # with one input and one output: genomes of 288 float32

PLUGIN = '''
import time
import msgspec
import numpy as np
from zswarm.nets.fully_meshed import HEADER
from zswarm.sims.simulator import CompiledSimulator, Outcome, Turn


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    sleep_s: float = 0.0
    cpu_s: float = 0.0


class Bench(CompiledSimulator):
    """Sleep or burn time and return the genome's first number: a trial that is all dispatch."""

    settings_type = Settings
    inputs, outputs, owners = 1, 1, (0,)

    def reset(self, seed):
        return Turn((0,), np.zeros((1, 1), np.float32))

    def step(self, actions):
        return None

    def outcome(self):
        return Outcome([0.0], [])

    def play(self, step, batch):
        batch.fitness[:, 0] = batch.parameters[batch.participants[:, 0], HEADER]
        if self.settings.sleep_s or self.settings.cpu_s:
            for trial in range(len(batch.seeds)):
                batch.progress[0] = trial
                time.sleep(self.settings.sleep_s)
                end = time.thread_time() + self.settings.cpu_s
                while self.settings.cpu_s and time.thread_time() < end:
                    pass
'''
SETTINGS = {"noop": {}, "sleep": {"sleep_s": TASK_S}, "cpu": {"cpu_s": TASK_S}}


@contextlib.contextmanager
def bench_simulator() -> Iterator[None]:
    """Register the simulator ``bench`` for this process and its children."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "zswarm_bench.py").write_text(PLUGIN)
        metadata = folder / "zswarm_bench-1.0.dist-info"
        metadata.mkdir()
        (metadata / "METADATA").write_text(
            "Metadata-Version: 2.1\nName: zswarm-bench\nVersion: 1.0\n"
        )
        (metadata / "entry_points.txt").write_text(
            "[zswarm.simulators]\nbench = zswarm_bench:Bench\n"
        )
        sys.path.insert(0, name)
        os.environ["PYTHONPATH"] = os.pathsep.join(
            [name, os.environ.get("PYTHONPATH", "")]
        )
        os.environ["ZSWARM_KEYS"] = "none"  # in the clear, as others are
        yield


@contextlib.contextmanager
def daemon(slots: int, endpoint: str, *more: str) -> Iterator["subprocess.Popen[bytes]"]:
    """Run a local zswarm-ss until the context ends."""
    options = [
        "--capacity",
        str(slots),
        "--listen",
        endpoint,
        "--no-multicast",
        "--log-level",
        "warning",
        *more,
    ]
    with subprocess.Popen(
        [sys.executable, "-m", "zswarm.ss", *options, "--until-stdin-closes"],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
    ) as process:
        # Leaving closes its stdin and waits.
        yield process


def _differ(dispute: object, _workload: object) -> NoReturn:
    raise RuntimeError(f"the measured servers do not compute the same: {dispute}")


@contextlib.contextmanager
def leased(
    endpoints: Sequence[str], slots: int, settings: dict[str, Any]
) -> Iterator[object]:
    """Connect with all slots of some servers ready, with a run's default options."""
    from zswarm.config import sections
    from zswarm.ot.cluster.matching import Terms
    from zswarm.ot.cluster.shell import Cluster
    from zswarm.plugins.version_hash import version_hash
    from zswarm.protocol.keys import RunKey
    from zswarm.protocol.messages import Part, Requirements, Reserve
    from zswarm.session import Reach

    options = sections.ClusterConfig()
    code = version_hash("bench", "fully-meshed")
    terms = Terms(
        requirements=Requirements(
            simulator="bench", representation="fully-meshed", version_hash=code
        ),
        reserve=Reserve(
            nonce=secrets.token_bytes(16),
            epoch=0,
            slots=slots,
            simulator=Part("bench", settings),
            representation=Part("fully-meshed", {"hidden": HIDDEN}),
            version_hash=code,
            trial_timeout_s=options.trial_timeout_s,
            trial_memory_mb=options.trial_memory_mb,
        ),
        verify=options.verify,
    )
    key = RunKey("default", "bench", f"bench-{secrets.token_hex(4)}")
    reach = Reach(list(endpoints), multicast=False)
    with Cluster(key, terms, reach=reach, arbitrate=_differ) as opened:
        for _ in opened.wait(1, 60.0):
            pass
        while opened.standing.slots < slots:
            time.sleep(0.01)
        yield opened


class Lease(contextlib.AbstractContextManager["Lease"]):
    """The slots of a server, for one kind of work at a time: another problem is another lease."""

    def __init__(self, endpoint: str, slots: int) -> None:
        self._endpoint, self._slots = endpoint, slots
        self._lease = contextlib.ExitStack()
        self._opened: Any = None
        self._work = ""

    def __exit__(self, *_: object) -> None:
        self._lease.close()

    def evaluate(self, genomes: list[bytes], work: str, _chunk: int = 0) -> list[float]:
        """Evaluate a generation; dispatch chooses the batch size."""
        if work != self._work:
            self._lease.close()
            self._opened = self._lease.enter_context(
                leased([self._endpoint], self._slots, SETTINGS[work])
            )
            self._work = work
        return evaluated(self._opened, genomes)


def free_port() -> int:
    """Return a free local port."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        return free.getsockname()[1]


def random_genomes(size: int) -> list[bytes]:
    """Return distinct candidates of 1152 bytes."""
    import numpy as np

    numbers = (HIDDEN + 1) * (HIDDEN + 3)
    return [
        genome.tobytes()
        for genome in np.random.default_rng()
        .uniform(-2, 2, (size, numbers))
        .astype("<f4")
    ]


def evaluated(opened: Any, genomes: list[bytes]) -> list[float]:
    """Return the fitness of each candidate."""
    import numpy as np

    from zswarm.ot.workload import Workload

    workload = Workload(
        genomes,
        np.arange(len(genomes)).reshape(-1, 1),
        np.zeros(len(genomes), np.uint64),
        0,
    )
    for _ in opened.evaluate(workload):
        pass
    return workload.fitness[:, 0].tolist()


def right(genomes: list[bytes]) -> list[float]:
    """Return the expected fitness of each candidate."""
    return [struct.unpack_from("<f", genome)[0] for genome in genomes]
