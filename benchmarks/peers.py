"""Zswarm and others, each as its documentation says to use it, with so many worker processes on this machine."""

import functools
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import quick
from by_mqtt import STEPS, Broker
from work import SLEEP_S, each, noop, sleep

CHUNKS = (1, 25, 100)  # of 400 candidates with 4 workers: one by one, four parts for each worker, one part for each
BY_ITSELF = 0  # the peer chooses


class Way(NamedTuple):
    """A way to have candidates evaluated.

    Attributes:
        evaluate: genomes, and whether to sleep -> fitness, in their order.
        chunk: candidates in a message.
        most: candidates of a generation at most, where one takes long.
        sleeps: whether it is measured with candidates that sleep.
    """

    form: str
    chunk: int
    evaluate: Callable[[list[bytes], bool], list[float]]
    most: int = 10**9
    sleeps: bool = True


Peer = Callable[[int], AbstractContextManager[list[Way]]]


def parts(genomes: list[bytes], chunk: int) -> list[list[bytes]]:
    """Of so many, the last one may be smaller."""
    return [genomes[begin : begin + chunk] for begin in range(0, len(genomes), chunk)]


@contextmanager
def zswarm_here(slots: int) -> Iterator[list[Way]]:
    """The slots of this machine, which ``zswarm-ot run`` has by itself."""
    from zswarm.ot.local import LocalServer

    with _bench_simulator(), LocalServer(slots, "default") as local, Leases(local.endpoint, slots) as leases:
        yield [Way("this machine's slots", BY_ITSELF, leases.evaluate)]


@contextmanager
def zswarm_by_tcp(slots: int) -> Iterator[list[Way]]:
    """A daemon, reached as one of another machine is."""
    endpoint = f"tcp/127.0.0.1:{quick.free_port()}"
    options = ["--capacity", str(slots), "--listen", endpoint, "--no-multicast", "--log-level", "warning"]
    with (
        _bench_simulator(),
        subprocess.Popen(
            [sys.executable, "-m", "zswarm.ss", *options, "--until-stdin-closes"],
            env={key: value for key, value in os.environ.items() if key != "ZSWARM_PLAIN"},  # it does evaluate
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
        ),  # leaving closes its stdin and waits
        Leases(endpoint, slots) as leases,
    ):
        yield [Way("a daemon, by TCP", BY_ITSELF, leases.evaluate)]


@contextmanager
def _bench_simulator() -> Iterator[None]:
    os.environ["ZSWARM_PLAIN"] = "1"  # as zswarm-ot run has it: this process evaluates nothing
    os.environ["ZSWARM_KEYS"] = "none"  # in the clear, as the others are
    with tempfile.TemporaryDirectory() as folder:
        quick.install_plugin(Path(folder))
        yield


class Leases(AbstractContextManager["Leases"]):
    """The slots of a server, for no-ops or for sleeps: another problem is another lease."""

    def __init__(self, endpoint: str, slots: int) -> None:
        self._endpoint, self._slots = endpoint, slots
        self._lease = ExitStack()
        self._opened: Any = None
        self._sleeping: bool | None = None

    def __exit__(self, *_: object) -> None:
        self._lease.close()

    def evaluate(self, genomes: list[bytes], sleeping: bool) -> list[float]:
        """A generation."""
        if sleeping != self._sleeping:
            self._lease.close()
            self._opened = self._lease.enter_context(quick.leased(self._endpoint, self._slots, SLEEP_S * sleeping))
            self._sleeping = sleeping
        return quick.evaluated(self._opened, genomes)


@contextmanager
def process_pool_executor(slots: int) -> Iterator[list[Way]]:
    from concurrent.futures import ProcessPoolExecutor

    with ProcessPoolExecutor(slots) as pool:

        def evaluate(genomes: list[bytes], sleeping: bool, chunk: int) -> list[float]:
            return list(pool.map(sleep if sleeping else noop, genomes, chunksize=chunk))

        yield [Way("map", chunk, functools.partial(evaluate, chunk=chunk)) for chunk in CHUNKS]


@contextmanager
def multiprocessing_pool(slots: int) -> Iterator[list[Way]]:
    import multiprocessing

    with multiprocessing.Pool(slots) as pool:

        def evaluate(genomes: list[bytes], sleeping: bool, chunk: int) -> list[float]:
            return pool.map(sleep if sleeping else noop, genomes, chunksize=chunk)

        yield [Way("map", chunk, functools.partial(evaluate, chunk=chunk)) for chunk in CHUNKS]


@contextmanager
def joblib_loky(slots: int) -> Iterator[list[Way]]:
    from joblib import Parallel, delayed

    with ExitStack() as stack:
        ways = []
        for chunk in (BY_ITSELF, *CHUNKS):
            how: Any = {"batch_size": chunk, "pre_dispatch": "all"} if chunk else {}  # by itself it learns as it sends
            parallel = stack.enter_context(Parallel(slots, backend="loky", **how))  # all of them share the processes

            def evaluate(genomes: list[bytes], sleeping: bool, parallel: Parallel = parallel) -> list[float]:
                return parallel(delayed(sleep if sleeping else noop)(genome) for genome in genomes)

            ways.append(Way("Parallel", chunk, evaluate))
        yield ways


@contextmanager
def dask_distributed(slots: int) -> Iterator[list[Way]]:
    from distributed import Client, LocalCluster

    with (
        LocalCluster(n_workers=slots, threads_per_worker=1, dashboard_address=None) as cluster,
        Client(cluster) as client,
    ):
        client.wait_for_workers(slots)

        def evaluate(genomes: list[bytes], sleeping: bool, chunk: int) -> list[float]:
            judge = sleep if sleeping else noop
            if chunk == 1:
                return client.gather(client.map(judge, genomes, pure=False))
            futures = client.map(functools.partial(each, judge), parts(genomes, chunk), pure=False)
            return [fitness for part in client.gather(futures) for fitness in part]

        yield [Way("Client.map", chunk, functools.partial(evaluate, chunk=chunk)) for chunk in CHUNKS]


@contextmanager
def ray_local(slots: int) -> Iterator[list[Way]]:
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    os.environ["RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO"] = "0"  # it would warn of a change to come
    import ray

    ray.init(num_cpus=slots, include_dashboard=False, log_to_driver=False, logging_level="error")
    try:
        task = ray.remote(each)

        class Worker:
            def each(self, judge: Callable[[bytes], float], genomes: list[bytes]) -> list[float]:
                return each(judge, genomes)

        single = {judge: ray.remote(judge) for judge in (noop, sleep)}
        workers: list[Any] = []

        def by_tasks(genomes: list[bytes], sleeping: bool, chunk: int) -> list[float]:
            judge = sleep if sleeping else noop
            if chunk == 1:
                return ray.get([single[judge].remote(genome) for genome in genomes])
            found = ray.get([task.remote(judge, part) for part in parts(genomes, chunk)])
            return [fitness for part in found for fitness in part]

        def by_actors(genomes: list[bytes], sleeping: bool, chunk: int) -> list[float]:
            if not workers:  # after the tasks: they hold the cores
                workers.extend(ray.remote(num_cpus=1)(Worker).remote() for _ in range(slots))
            judge = sleep if sleeping else noop
            calls = [workers[n % slots].each.remote(judge, part) for n, part in enumerate(parts(genomes, chunk))]
            return [fitness for part in ray.get(calls) for fitness in part]

        yield [
            *(Way("tasks", chunk, functools.partial(by_tasks, chunk=chunk)) for chunk in CHUNKS),
            Way("actors in turn", 1, functools.partial(by_actors, chunk=1)),
        ]
    finally:
        ray.shutdown()


@contextmanager
def mqtt(slots: int, nodelay: bool) -> Iterator[list[Way]]:
    """Request and reply for whole evaluations; and the messages of the paper that zswarm began from."""
    with Broker(slots, nodelay) as broker:
        yield [
            *(Way("two messages out per slot", chunk, functools.partial(broker.in_parts, chunk=chunk)) for chunk in CHUNKS),
            Way("the paper's messages, no step", 1, functools.partial(broker.in_steps, steps=0), most=40),
            Way("the paper's messages, 8 agents, 50 steps", 1, functools.partial(broker.in_steps, steps=STEPS), 8, False),
        ]


class Known(NamedTuple):
    """A peer, and the distribution whose version tells which one it is."""

    peer: Peer
    distribution: str | None  # None: Python's own


PEERS = {
    "zswarm": Known(zswarm_here, "zswarm"),
    "zswarm (TCP)": Known(zswarm_by_tcp, "zswarm"),
    "ProcessPoolExecutor": Known(process_pool_executor, None),
    "multiprocessing.Pool": Known(multiprocessing_pool, None),
    "joblib (loky)": Known(joblib_loky, "joblib"),
    "Dask distributed": Known(dask_distributed, "distributed"),
    "Ray": Known(ray_local, "ray"),
    "MQTT (stock)": Known(functools.partial(mqtt, nodelay=False), "paho-mqtt"),
    "MQTT (TCP_NODELAY)": Known(functools.partial(mqtt, nodelay=True), "paho-mqtt"),
}
