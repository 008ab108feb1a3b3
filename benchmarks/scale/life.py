"""One optimizer's life with many servers, measured: finding them, evaluating, leaving."""

import os
import secrets
import sys
import time
from collections import Counter
from multiprocessing.connection import Connection
from typing import NamedTuple, NoReturn

import msgspec
import numpy as np
from usage import usage

from scale.farm import REALM, Servers, spawn
from scale.pretended import CAPACITY, TRIALS, Times, draws, durations, speed, work
from zswarm.ot.cluster.events import Counted
from zswarm.ot.cluster.matching import Terms
from zswarm.ot.cluster.shell import Cluster
from zswarm.ot.notes import Note
from zswarm.ot.workload import Workload
from zswarm.protocol import messages
from zswarm.protocol.keys import RunKey
from zswarm.session import Reach

DEADLINE_S = 120.0
# Without another server or slot, before the optimizer continues with those it has.
SETTLE_S = 20.0


class Use(NamedTuple):
    """The use of slot time in a generation, as shares of slots x wall time."""

    efficiency: float  # ideal time / time
    wall_s: float
    start: float  # before a slot's first batch
    gaps: float  # between batches, and what a pretended one ended late
    tail: float  # after a slot's last batch
    tail_s: float  # from the first slot without work to the end
    idle: float  # of the slots in that time
    cpu: tuple[float, float]  # seconds of the optimizer and of all servers
    evaluations: int


class Found(NamedTuple):
    """The result of discovery, measured from before the session opens."""

    servers: int
    offered_s: float
    leased_s: float
    ready_s: float
    cpu_s: float
    mb: float
    threads: int
    descriptors: int


class Run(NamedTuple):
    """One optimizer's life."""

    found: Found
    uses: list[Use]
    messages: dict[str, float]  # per server, by kind
    kilobytes: tuple[float, float]  # per server, to and from it
    rss_mb: float
    leave_s: float
    notes: dict[str, int]
    router_s: float  # of processor time, in all; 0 without one


def differ(dispute: object, _workload: object) -> NoReturn:
    """Nothing can decide: outcomes are pretended."""
    raise RuntimeError(f"pretended servers do not differ: {dispute}")


def optimizer(
    pipe: Connection,
    servers: int,
    reach: Reach,
    times: Times,
    generations: int,
    trials_per_slot: int,
) -> None:
    """Run the optimizer in this process and send its measurements."""
    count, wanted = servers * CAPACITY, servers
    terms = Terms(
        requirements=messages.Requirements(simulator="pretended", representation="none"),
        reserve=messages.Reserve(
            nonce=secrets.token_bytes(16),
            epoch=0,
            slots=messages.MAX_SLOTS,
            simulator=messages.Part("pretended", msgspec.to_builtins(times)),
            representation=messages.Part("none", {}),
            version_hash="",
            trial_timeout_s=3600.0,
        ),
    )
    key = RunKey(REALM, "scale", f"scale-{secrets.token_hex(4)}")
    notes: Counter[str] = Counter()
    ran = []
    base_mb, base_s, begin = (
        usage(os.getpid()).rss_mb,
        time.process_time(),
        time.monotonic(),
    )
    with Cluster(key, terms, reach=reach, arbitrate=differ) as cluster:
        leased = ready = time.monotonic()
        state = (0, 0)
        while state != (wanted, count) and time.monotonic() < min(
            ready + SETTLE_S, begin + DEADLINE_S
        ):
            if (now := (cluster.standing.leased, cluster.standing.slots)) != state:
                ready = time.monotonic()
                leased = ready if now[0] != state[0] else leased
                state = now
            time.sleep(0.002)
        servers, count = state
        ready_cpu_s, found = time.process_time() - base_s, usage(os.getpid())
        for generation in range(generations):
            workload = work(generation, count * trials_per_slot)
            counted = 0
            start, start_s = time.monotonic(), time.process_time()
            for item in cluster.evaluate(workload):
                if isinstance(item, Counted):
                    counted += len(item.trials)
                elif isinstance(item, Note):
                    notes[item.event] += 1
                if time.monotonic() > start + DEADLINE_S:
                    break
            if counted < len(workload.seeds):
                break  # this machine cannot do it
            ran.append((start, time.monotonic(), time.process_time() - start_s))
            expected = draws(workload.genomes, workload.participants, workload.seeds)
            assert (workload.fitness[:, 0] == expected).all()
        used, left = usage(os.getpid()), time.monotonic()
    pipe.send(
        {
            "servers": servers,
            "slots": count,
            "begin": begin,
            "leased": leased,
            "ready": ready,
            "ready_cpu_s": ready_cpu_s,
            "threads": found.threads,
            "descriptors": found.descriptors,
            "ready_mb": found.rss_mb - base_mb,
            "rss_mb": used.rss_mb,
            "generations": ran,
            "leave_s": time.monotonic() - left,
            "notes": dict(notes),
        }
    )


def live(
    servers: Servers, times: Times, generations: int, trials_per_slot: int = TRIALS
) -> Run:
    """Find the servers, evaluate some generations, leave."""
    deadline = time.monotonic() + DEADLINE_S
    while sum(servers.ask("clear")):  # leases of the one before
        assert time.monotonic() < deadline, "leases do not end"
        time.sleep(0.2)
    pipe, end = spawn.Pipe()
    process = spawn.Process(
        target=optimizer,
        args=(end, servers.count, servers.reach, times, generations, trials_per_slot),
    )
    router = servers.router
    before_s = router.cpu_s() if router is not None else 0.0
    process.start()
    end.close()
    told = pipe.recv()
    process.join()
    router_s = router.cpu_s() - before_s if router is not None else 0.0
    reports, count = servers.ask("report"), servers.count
    when = [when for report in reports for when in report["when"]]
    begin = told["begin"]
    found = Found(
        told["servers"],
        max(w["offer"] for w in when if w) - begin,
        told["leased"] - begin,
        told["ready"] - begin,
        told["ready_cpu_s"],
        told["ready_mb"],
        told["threads"],
        told["descriptors"],
    )
    totals: Counter[str] = Counter()
    for report in reports:
        for side in ("received", "sent"):
            for counter in report[side]:
                totals.update(
                    {f"{side} {kind}": number for kind, number in counter.items()}
                )
    ran = np.array([row for report in reports for row in report["ran"]]).reshape(-1, 4)

    def farm_cpu_s(begin: float, end: float) -> float:
        samples = [np.array(report["cpu"]).T for report in reports]
        return sum(
            float(np.diff(np.interp([begin, end], when, used))[0])
            for when, used in samples
        )

    uses = [
        _use(
            times,
            ran,
            work(generation, told["slots"] * trials_per_slot),
            begin,
            end,
            (mine, farm_cpu_s(begin, end)),
        )
        for generation, (begin, end, mine) in enumerate(told["generations"])
    ]
    exchanged = [bytes_ for report in reports for bytes_ in report["bytes"]]
    run = Run(
        found,
        uses,
        {kind: number / count for kind, number in sorted(totals.items())},
        (
            sum(b[0] for b in exchanged) / count / 1e3,
            sum(b[1] for b in exchanged) / count / 1e3,
        ),
        told["rss_mb"],
        told["leave_s"],
        told["notes"],
        router_s,
    )
    shares = ", ".join(f"{use.efficiency:.3f}" for use in uses)
    print(
        f"{count} servers, {times}: found {found}; efficiency {shares}; {told['notes']}",
        file=sys.stderr,
        flush=True,
    )
    return run


def _use(
    times: Times,
    ran: np.ndarray,
    workload: Workload,
    begin: float,
    end: float,
    cpu: tuple[float, float],
) -> Use:
    """Return the slots' use between two moments."""
    mine = ran[(ran[:, 1] >= begin) & (ran[:, 2] <= end + 1e-3)]
    used, slot = np.unique(mine[:, 0].astype(int), return_inverse=True)
    count, wall = len(used), end - begin
    first, last, busy = np.full(count, end), np.full(count, begin), np.zeros(count)
    np.minimum.at(first, slot, mine[:, 1])
    np.maximum.at(last, slot, mine[:, 2])
    np.add.at(busy, slot, mine[:, 3])
    tail_s = float(end - last.min())
    total = count * wall
    nominal = durations(
        times, draws(workload.genomes, workload.participants, workload.seeds)
    )
    capacity = sum(speed(times, slot // CAPACITY) for slot in used)
    return Use(
        efficiency=float(nominal.sum()) / (capacity * wall),
        wall_s=wall,
        start=float((first - begin).sum()) / total,
        gaps=float((last - first - busy).sum()) / total,
        tail=float((end - last).sum()) / total,
        tail_s=tail_s,
        idle=float((end - last).sum()) / (count * tail_s),
        cpu=cpu,
        evaluations=len(workload.seeds),
    )
