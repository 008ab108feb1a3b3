"""Run zswarm and its peers as their documentation says, with the same number of workers."""

import functools
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import leased
from by_mqtt import STEPS, Broker
from work import WORKS, each

# How a generation is cut into messages.
BY_ITSELF, ONE, QUARTERS, WHOLES = "automatic", "1", "4 per worker", "1 per worker"
CUTS = (ONE, QUARTERS, WHOLES)


class Way(NamedTuple):
    """A way to have candidates evaluated.

    Attributes:
        form: which of a peer's ways.
        cut: the candidates of one message, or how many messages for each worker.
        evaluate: genomes, the work, candidates in a message -> fitness, in their order.
        most: candidates of a generation at most, where one takes long.
        works: what it is measured with.
        aside: it is not the peer's usual way: it is measured in one place only.
    """

    form: str
    cut: str
    evaluate: Callable[[list[bytes], str, int], list[float]]
    most: int = 10**9
    works: tuple[str, ...] = tuple(WORKS)
    aside: bool = False


Peer = Callable[[int], AbstractContextManager[list[Way]]]


def chunk(cut: str, candidates: int, workers: int) -> int:
    """Return candidates per message; 0 where the peer chooses."""
    per_worker = {QUARTERS: 4, WHOLES: 1}
    return (
        {BY_ITSELF: 0, ONE: 1}[cut]
        if cut not in per_worker
        else max(1, candidates // (per_worker[cut] * workers))
    )


def parts(genomes: list[bytes], size: int) -> list[list[bytes]]:
    """Split candidates into parts; the last may be smaller."""
    return [genomes[begin : begin + size] for begin in range(0, len(genomes), size)]


@contextmanager
def zswarm_here(slots: int) -> Iterator[list[Way]]:
    """Use local slots, the default of ``zswarm-ot run``."""
    from zswarm.ot.cluster.local import LocalServer

    with (
        leased.bench_simulator(),
        closing(LocalServer(slots, "default")) as local,
        leased.Lease(local.endpoint, slots) as lease,
    ):
        yield [Way("this machine's slots", BY_ITSELF, lease.evaluate)]


@contextmanager
def zswarm_by_tcp(slots: int) -> Iterator[list[Way]]:
    """Use a daemon, reached as one of another machine is."""
    endpoint = f"tcp/127.0.0.1:{leased.free_port()}"
    with (
        leased.bench_simulator(),
        leased.daemon(slots, endpoint),
        leased.Lease(endpoint, slots) as lease,
    ):
        yield [Way("a daemon, by TCP", BY_ITSELF, lease.evaluate)]


@contextmanager
def loop(_slots: int) -> Iterator[list[Way]]:
    """Evaluate in one process without dispatch."""
    yield [
        Way(
            "a loop in one process",
            ONE,
            lambda genomes, work, _chunk: each(WORKS[work], genomes),
        )
    ]


@contextmanager
def process_pool_executor(slots: int) -> Iterator[list[Way]]:
    from concurrent.futures import ProcessPoolExecutor

    with ProcessPoolExecutor(slots) as pool:

        def evaluate(genomes: list[bytes], work: str, chunk: int) -> list[float]:
            return list(pool.map(WORKS[work], genomes, chunksize=chunk))

        yield [Way("map", cut, evaluate) for cut in CUTS]


@contextmanager
def multiprocessing_pool(slots: int) -> Iterator[list[Way]]:
    import multiprocessing

    with multiprocessing.Pool(slots) as pool:

        def evaluate(genomes: list[bytes], work: str, chunk: int) -> list[float]:
            return pool.map(WORKS[work], genomes, chunksize=chunk)

        yield [Way("map", cut, evaluate) for cut in CUTS]


@contextmanager
def joblib_loky(slots: int) -> Iterator[list[Way]]:
    from joblib import Parallel, delayed

    with ExitStack() as stack:
        opened: dict[int, Parallel] = {}  # all of them share the processes

        def evaluate(genomes: list[bytes], work: str, chunk: int) -> list[float]:
            if chunk not in opened:
                # Without it, it learns while it sends.
                how: Any = {"batch_size": chunk, "pre_dispatch": "all"} if chunk else {}
                opened[chunk] = stack.enter_context(
                    Parallel(slots, backend="loky", **how)
                )
            return opened[chunk](delayed(WORKS[work])(genome) for genome in genomes)

        yield [Way("Parallel", cut, evaluate) for cut in (BY_ITSELF, *CUTS)]


@contextmanager
def dask_distributed(slots: int) -> Iterator[list[Way]]:
    from distributed import Client, LocalCluster

    with (
        LocalCluster(
            n_workers=slots, threads_per_worker=1, dashboard_address=None
        ) as cluster,
        Client(cluster) as client,
    ):
        client.wait_for_workers(slots)

        def evaluate(genomes: list[bytes], work: str, chunk: int) -> list[float]:
            if chunk == 1:
                return client.gather(client.map(WORKS[work], genomes, pure=False))
            futures = client.map(
                functools.partial(each, WORKS[work]), parts(genomes, chunk), pure=False
            )
            return [fitness for part in client.gather(futures) for fitness in part]

        yield [Way("Client.map", cut, evaluate) for cut in CUTS]


@contextmanager
def ray_local(slots: int) -> Iterator[list[Way]]:
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    # It would warn of a change to come.
    os.environ["RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO"] = "0"
    import ray

    ray.init(
        num_cpus=slots,
        include_dashboard=False,
        log_to_driver=False,
        logging_level="error",
    )
    try:
        task = ray.remote(each)

        class Worker:
            def each(
                self, judge: Callable[[bytes], float], genomes: list[bytes]
            ) -> list[float]:
                return each(judge, genomes)

        single = {work: ray.remote(judge) for work, judge in WORKS.items()}
        workers: list[Any] = []

        def by_tasks(genomes: list[bytes], work: str, chunk: int) -> list[float]:
            if chunk == 1:
                return ray.get([single[work].remote(genome) for genome in genomes])
            found = ray.get(
                [task.remote(WORKS[work], part) for part in parts(genomes, chunk)]
            )
            return [fitness for part in found for fitness in part]

        def by_actors(genomes: list[bytes], work: str, chunk: int) -> list[float]:
            if not workers:  # after the tasks: they hold the cores
                workers.extend(
                    ray.remote(num_cpus=1)(Worker).remote() for _ in range(slots)
                )
            calls = [
                workers[n % slots].each.remote(WORKS[work], part)
                for n, part in enumerate(parts(genomes, chunk))
            ]
            return [fitness for part in ray.get(calls) for fitness in part]

        yield [
            *(Way("tasks", cut, by_tasks) for cut in CUTS),
            Way("actors in turn", ONE, by_actors, aside=True),
        ]
    finally:
        ray.shutdown()


@contextmanager
def mpi_futures(slots: int) -> Iterator[list[Way]]:
    """Use the processes that it spawns itself, as without ``mpiexec``."""
    programs = str(Path(sys.executable).parent)  # where MPI is that pip installed
    os.environ["PATH"] = os.pathsep.join([programs, os.environ.get("PATH", "")])
    from mpi4py.futures import MPIPoolExecutor

    with MPIPoolExecutor(slots, path=[str(Path(__file__).parent)]) as pool:

        def evaluate(genomes: list[bytes], work: str, chunk: int) -> list[float]:
            return list(pool.map(WORKS[work], genomes, chunksize=chunk))

        yield [Way("map", cut, evaluate) for cut in CUTS]


@contextmanager
def mqtt(slots: int, nodelay: bool) -> Iterator[list[Way]]:
    """Send whole evaluations by request and reply; and send the paper's messages."""
    paper = functools.partial(Way, cut=ONE, aside=True)
    with Broker(slots, nodelay) as broker:
        yield [
            *(
                Way("two messages in flight per slot", cut, broker.in_parts)
                for cut in CUTS
            ),
            paper(
                "the paper's messages, no step",
                evaluate=functools.partial(broker.in_steps, steps=0),
                most=40,
                works=("noop", "sleep"),
            ),
            paper(
                "the paper's messages, 8 agents, 50 steps",
                evaluate=functools.partial(broker.in_steps, steps=STEPS),
                most=8,
                works=("noop",),
            ),
        ]


class Known(NamedTuple):
    """A peer, and the distributions whose versions tell which one it is."""

    peer: Peer
    distributions: tuple[str, ...] = ()  # none: Python's own
    # Numbers of workers that it is measured with, where not all.
    slots: tuple[int, ...] = ()


PEERS = {
    "zswarm": Known(zswarm_here, ("zswarm",)),
    "zswarm (TCP)": Known(zswarm_by_tcp, ("zswarm",), (4,)),
    "no dispatch": Known(loop, (), (1,)),
    "ProcessPoolExecutor": Known(process_pool_executor),
    "multiprocessing.Pool": Known(multiprocessing_pool),
    "joblib (loky)": Known(joblib_loky, ("joblib",)),
    "Dask distributed": Known(dask_distributed, ("distributed",)),
    "Ray": Known(ray_local, ("ray",)),
    "mpi4py.futures": Known(mpi_futures, ("mpi4py", "mpich", "openmpi")),
    "MQTT (stock)": Known(
        functools.partial(mqtt, nodelay=False), ("paho-mqtt", "mosquitto")
    ),
    "MQTT (TCP_NODELAY)": Known(
        functools.partial(mqtt, nodelay=True), ("paho-mqtt", "mosquitto")
    ),
}
