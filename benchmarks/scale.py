"""Many servers, one optimizer, on one machine: `make scale`, or `make scale ARGS=--quick`.

The servers are true to the protocol: each has its own zenoh session on its own loopback port, the slot table, keys, codec
and liveliness token of `zswarm-ss`. Only evaluating is pretended: a batch is finished when its trials' time has passed, and
fitness is a number drawn from genome and seed. Many servers share a process and its loop. The optimizer is the `Cluster`
that `zswarm-ot run` uses, in a process of its own.

Printed, as tables for docs/benchmarks.md: how long discovery and handshake take, how many messages, what both sides use;
how much of the slots' time generations use; what is lost in tails, when slots wait for the last trials of a generation, and
what starting those twice would win. The charts go to benchmarks/scale.png.
"""

import argparse
import contextlib
import heapq
import itertools
import multiprocessing
import os
import secrets
import select
import statistics
import sys
import time
import zlib
from collections import Counter, deque
from collections.abc import Iterator
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

os.environ["ZSWARM_PLAIN"] = "1"  # nothing here is compiled

import zenoh
from usage import usage

from zswarm import session
from zswarm.ot.cluster import Cluster, Wanted, Who
from zswarm.ot.dispatch import DEPTH, Counted, Note
from zswarm.ot.workload import Workload
from zswarm.protocol import codec, keys, messages
from zswarm.ss import slots

REALM = "scale"
CAPACITY = 4  # slots per server
TRIALS = 10  # of a candidate
TICK_S = 1.0
SERVERS_PER_PROCESS = 128
GENOME = 400  # bytes
DEADLINE_S = 120.0
SETTLE_S = 20.0  # without another server or slot, before the optimizer goes on with those it has
GOAL_EFFICIENCY, GOAL_FOUND_S, GOAL_FOUND_SERVERS = 0.90, 1.0, 256

_spawn = multiprocessing.get_context("spawn")


class Times(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How long trials take: the settings of the pretended simulator."""

    mean_s: float = 1.0
    spread: str = "none"  # or uniform: 0.5 to 1.5 times the mean; heavy: a Pareto tail, up to 20 times the mean
    of: str = "trial"  # a trial takes this long everywhere; or execution: drawn anew where it is started again
    slow: float = 1.0  # times as long on the first server


# ---- the pretended work -------------------------------------------------------------------------------------------


def draws(genomes: list[bytes], participants: np.ndarray, seeds: np.ndarray, salt: int = 0) -> np.ndarray:
    """(trials,) float64 in [0, 1): the same for the same genome, seed and salt."""
    x = np.array([zlib.crc32(genome) for genome in genomes], np.uint64)[participants[:, 0]]
    for more in (seeds, np.uint64(salt)):
        x = (x ^ more) * np.uint64(0x9E3779B97F4A7C15)
        x = (x ^ (x >> np.uint64(29))) * np.uint64(0xBF58476D1CE4E5B9)
        x ^= x >> np.uint64(32)
    return (x >> np.uint64(11)) * 2.0**-53


def durations(times: Times, numbers: np.ndarray) -> np.ndarray:
    """(trials,) seconds, from numbers in [0, 1)."""
    match times.spread:
        case "uniform":
            return times.mean_s * (0.5 + numbers)
        case "heavy":
            return times.mean_s * np.minimum((1 - numbers) ** (-1 / 1.5) / 3, 20.0)
        case _:
            return np.full(len(numbers), times.mean_s)


def salt(times: Times, server: int) -> int:
    """What a server's draws differ by."""
    return server + 1 if times.of == "execution" else 0


def speed(times: Times, server: int) -> float:
    """How fast a server is."""
    return 1 / times.slow if server == 0 else 1.0


# ---- the servers --------------------------------------------------------------------------------------------------


class Kind(msgspec.Struct):
    """What a message says of its kind."""

    type: str


_kind = msgspec.msgpack.Decoder(Kind)


class Server:
    """One of them, without a loop of its own."""

    def __init__(self, index: int, endpoint: str, farm: "Farm") -> None:
        self.index = index
        self.id = keys.new_server_id(f"s{index}")
        self.queries: dict[int, zenoh.Query] = {}
        self.turns = [0] * CAPACITY  # a slot's timer counts when it is of the slot's last turn
        self.running = [(0.0, 0.0)] * CAPACITY  # since when, and seconds of work
        self.clear()
        offer = messages.Offer(
            server=self.id, program="scale", machine="none", capacity=CAPACITY, free=CAPACITY, leases=0,
            simulators=["pretended"], representations=["none"],
        )  # fmt: skip
        self.slots = slots.Slots(CAPACITY, offer, lambda _: "", lambda: secrets.token_bytes(16))
        self.session, _ = session.open_server([endpoint], [], multicast=False)
        on_query = zenoh.handlers.Callback(lambda query: farm.put(self, query), indirect=False)
        self.session.declare_queryable(keys.offer(REALM, self.id), on_query)
        self.session.declare_queryable(keys.requests(REALM, self.id), on_query)
        self.session.liveliness().declare_subscriber(
            keys.run_alive(REALM, "*", "*"),
            zenoh.handlers.Callback(lambda sample: farm.put(self, _holder(sample)), indirect=False),
            history=True,
        )
        self.token = self.session.liveliness().declare_token(keys.alive(REALM, self.id))

    def clear(self) -> None:
        """Forget what was measured."""
        self.received: Counter[str] = Counter()
        self.sent: Counter[str] = Counter()
        self.bytes = [0, 0]  # received, sent; of payload
        self.when: dict[str, float] = {}  # the first offered, leased, all ready
        self.ran: list[tuple[int, float, float, float]] = []  # slot, from, to, seconds of work


def _holder(sample: zenoh.Sample) -> slots.Event:
    user, run = keys.parse_run_key(str(sample.key_expr))
    return slots.HolderSeen(user, run) if sample.kind == zenoh.SampleKind.PUT else slots.HolderGone(user, run)


class Farm:
    """The servers of one process and their loop; a pipe tells it what to do."""

    def __init__(self, pipe: Connection) -> None:
        self.pipe = pipe
        self.servers: list[Server] = []
        self._inbox: deque[tuple[Server, zenoh.Query | slots.Event]] = deque()
        self._wake, self._woken = os.pipe()
        os.set_blocking(self._wake, False)
        os.set_blocking(self._woken, False)
        self._cpu: list[tuple[float, float]] = []  # when, seconds used
        self._timers: list[tuple[float, int, Server, int, int, slots.Event]] = []
        self._count = itertools.count()

    def put(self, server: Server, item: zenoh.Query | slots.Event) -> None:
        """From zenoh's threads."""
        self._inbox.append((server, item))
        with contextlib.suppress(BlockingIOError):
            os.write(self._woken, b"!")

    def run(self, first: int, endpoints: list[str]) -> None:
        """Open the servers and serve until told to stop."""
        before = usage(os.getpid()).rss_mb
        begin = time.monotonic()
        self.servers = [Server(first + index, endpoint, self) for index, endpoint in enumerate(endpoints)]
        self.pipe.send((time.monotonic() - begin, usage(os.getpid()).rss_mb - before))
        poll = select.poll()
        poll.register(self._wake, select.POLLIN)
        poll.register(self.pipe, select.POLLIN)
        next_tick = time.monotonic()
        while True:
            until = min(next_tick, self._timers[0][0] if self._timers else next_tick)
            ready = {descriptor for descriptor, _ in poll.poll(max(0.0, until - time.monotonic()) * 1000)}
            if self.pipe.fileno() in ready and not self._told(self.pipe.recv()):
                break
            if self._wake in ready:
                os.read(self._wake, 65536)
            for _ in range(len(self._inbox)):
                server, item = self._inbox.popleft()
                if isinstance(item, zenoh.Query):
                    self._asked(server, item)
                else:
                    self._handle(server, item)
            now = time.monotonic()
            while self._timers and self._timers[0][0] <= now:
                _, _, server, slot, turn, event = heapq.heappop(self._timers)
                if turn == server.turns[slot]:
                    self._slot_done(server, slot, event)
            if now >= next_tick:
                next_tick = now + TICK_S
                self._cpu.append((now, time.process_time()))
                for server in self.servers:
                    if server.slots.busy():
                        self._handle(server, slots.Tick((0,) * CAPACITY))
        for server in self.servers:
            session.close(server.session)

    def _told(self, word: str) -> bool:
        match word:
            case "clear":
                for server in self.servers:
                    server.clear()
                self._cpu = [(time.monotonic(), time.process_time())]
                self.pipe.send(sum(len(server.slots.leases) for server in self.servers))
            case "report":
                self.pipe.send(self._report())
        return word != "stop"

    def _report(self) -> dict[str, Any]:
        return {
            "cpu": [*self._cpu, (time.monotonic(), time.process_time())],
            "received": [server.received for server in self.servers],
            "sent": [server.sent for server in self.servers],
            "bytes": [server.bytes for server in self.servers],
            "when": [server.when for server in self.servers],
            "ran": [(server.index * CAPACITY + slot, *rest) for server in self.servers for slot, *rest in server.ran],
        }

    def _asked(self, server: Server, query: zenoh.Query) -> None:
        key = keys.parse_server_key(str(query.key_expr))
        body = query.payload.to_bytes()
        server.received[key.verb] += 1
        server.bytes[0] += len(body)
        server.queries[id(query)] = query
        self._handle(server, slots.Asked(id(query), key.user, key.run, codec.decode_request(body), body))

    def _handle(self, server: Server, event: slots.Event) -> None:
        now = time.monotonic()
        for command in server.slots.handle(event, now):
            match command:
                case slots.Answer():
                    self._answer(server, command, now)
                case slots.Prepare():
                    self._later(server, command.slot, now, slots.Prepared(command.slot, b"scale" if command.probe else b"", 0.0))
                case slots.Run():
                    self._run(server, command, now)
                case slots.Stop() | slots.Kill():
                    server.turns[command.slot] += 1
                    if isinstance(command, slots.Stop):
                        refused = codec.encode(messages.Refused(code="cancelled", reason="cancelled"))
                        self._later(server, command.slot, now, slots.Finished(command.slot, refused))

    def _run(self, server: Server, command: slots.Run, now: float) -> None:
        batch = codec.decode_request(command.body)
        participants, seeds = codec.trials(batch, 1)
        times = msgspec.convert(server.slots.slots[command.slot].setup.simulator.settings, Times)
        taken = durations(times, draws(batch.genomes, participants, seeds, salt(times, server.index)))
        seconds = float(taken.sum()) / speed(times, server.index)
        outcomes = messages.Outcomes(
            batch=batch.batch,
            fitness=draws(batch.genomes, participants, seeds).tobytes(),
            metrics=b"",
            seconds=seconds,
        )
        server.running[command.slot] = (now, seconds)
        self._later(server, command.slot, now + seconds, slots.Finished(command.slot, codec.encode(outcomes)))

    def _later(self, server: Server, slot: int, when: float, event: slots.Event) -> None:
        heapq.heappush(self._timers, (when, next(self._count), server, slot, server.turns[slot], event))

    def _slot_done(self, server: Server, slot: int, event: slots.Event) -> None:
        if isinstance(event, slots.Finished):
            begin, seconds = server.running[slot]
            server.ran.append((slot, begin, time.monotonic(), seconds))
        self._handle(server, event)

    def _answer(self, server: Server, answer: slots.Answer, now: float) -> None:
        query = server.queries.pop(answer.query)
        kind = _kind.decode(answer.body).type
        server.sent[kind] += 1
        server.bytes[1] += len(answer.body)
        if kind in ("offer", "lease"):
            ready = sum(lease.ready() for lease in server.slots.leases.values())
            for what in (kind, *(["ready"] if ready == CAPACITY else [])):
                server.when.setdefault(what, now)
        with contextlib.suppress(zenoh.ZError):  # the optimizer left
            query.reply(query.key_expr, answer.body)
        query.drop()


def farm(pipe: Connection, first: int, endpoints: list[str]) -> None:
    """A process of servers."""
    Farm(pipe).run(first, endpoints)


# ---- the optimizer ------------------------------------------------------------------------------------------------


def optimizer(pipe: Connection, endpoints: list[str], times: Times, generations: int, trials_per_slot: int) -> None:
    """The process of the optimizer; sends what it measured."""
    count = len(endpoints) * CAPACITY
    wanted = Wanted(
        messages.Part("pretended", msgspec.to_builtins(times)), messages.Part("none", {}), "", participants=1, metrics=0,
        trial_timeout_s=3600.0, trial_memory_mb=0, slots=messages.MAX_SLOTS, quarantine=False, verify=0.0, probe=b"",
    )  # fmt: skip
    who = Who(REALM, "scale", f"scale-{secrets.token_hex(4)}", 0, secrets.token_bytes(16))
    notes: Counter[str] = Counter()
    ran = []
    base_mb, base_s, begin = usage(os.getpid()).rss_mb, time.process_time(), time.monotonic()
    with Cluster(who, wanted, connect=endpoints, multicast=False) as cluster:
        leased = ready = time.monotonic()
        state = (0, 0)
        while state != (len(endpoints), count) and time.monotonic() < min(ready + SETTLE_S, begin + DEADLINE_S):
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
    pipe.send({
        "servers": servers, "slots": count, "begin": begin, "leased": leased, "ready": ready, "ready_cpu_s": ready_cpu_s,
        "threads": found.threads, "descriptors": found.descriptors, "ready_mb": found.rss_mb - base_mb, "rss_mb": used.rss_mb,
        "generations": ran, "leave_s": time.monotonic() - left, "notes": dict(notes),
    })  # fmt: skip


def work(generation: int, trials: int) -> Workload:
    """Distinct genomes, each on 10 seeds."""
    population = trials // TRIALS
    bits = np.random.default_rng(generation).integers(0, 256, (population, GENOME), np.uint8)
    participants = np.repeat(np.arange(population), TRIALS).reshape(-1, 1)
    return Workload([row.tobytes() for row in bits], participants, np.tile(np.arange(TRIALS, dtype=np.uint64), population), 0)


# ---- how short a generation could be ------------------------------------------------------------------------------


class Schedule(NamedTuple):
    """Seconds of a generation on the same servers, without any network or computing."""

    bound: float  # as dispatch does: what waits at a server stays there
    free: float  # every slot takes the next trial that nobody started
    twice: float  # and then, when none is left, one that another slot would finish later: by an oracle


def schedule(times: Times, workload: Workload, servers: int) -> Schedule:
    """Play a generation by list scheduling."""
    by_server = [
        durations(times, draws(workload.genomes, workload.participants, workload.seeds, salt(times, server)))
        / speed(times, server)
        for server in (range(servers) if times.of == "execution" else (0, 1))
    ]
    last = len(by_server) - 1

    def takes(trial: int, server: int) -> float:
        return float(by_server[min(server, last)][trial])

    count = len(workload.seeds)
    return Schedule(_bound(count, servers, takes), *_free(count, servers, takes))


def _bound(count: int, servers: int, takes: Any) -> float:
    order = iter(range(count))
    waiting: list[deque[int]] = [deque() for _ in range(servers)]
    for _ in range(DEPTH):
        for server in range(servers):
            waiting[server].extend(itertools.islice(order, CAPACITY))
    slots_free = [(0.0, slot) for slot in range(servers * CAPACITY)]
    end = 0.0
    while slots_free:
        now, slot = heapq.heappop(slots_free)
        server = slot // CAPACITY
        if now:  # it has just finished one, so the server gets another
            waiting[server].extend(itertools.islice(order, 1))
        end = max(end, now)
        if waiting[server]:
            heapq.heappush(slots_free, (now + takes(waiting[server].popleft(), server), slot))
    return end


def _free(count: int, servers: int, takes: Any) -> tuple[float, float]:
    free = [(0.0, slot) for slot in range(servers * CAPACITY)]
    ends, slots_of = {}, {}
    for trial in range(count):
        now, slot = heapq.heappop(free)
        ends[trial], slots_of[trial] = now + takes(trial, slot // CAPACITY), [slot]
        heapq.heappush(free, (ends[trial], slot))
    plain = max(ends.values())
    while free:
        now, slot = heapq.heappop(free)
        sooner = [trial for trial, end in ends.items() if end > now and now + takes(trial, slot // CAPACITY) < end]
        ends = {trial: end for trial, end in ends.items() if end >= now}
        if sooner:  # if not, nor later
            late = max(sooner, key=ends.__getitem__)
            ends[late] = now + takes(late, slot // CAPACITY)
            free = [(time, slot) for time, slot in free if slot not in slots_of[late]]  # they give it up then
            slots_of[late].append(slot)
            free += [(ends[late], slot) for slot in slots_of[late]]
            heapq.heapify(free)
    return plain, now


# ---- measuring ----------------------------------------------------------------------------------------------------


class Use(NamedTuple):
    """Of slot time in a generation, as shares of slots x wall time."""

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
    """How the servers were found, from before opening the session on."""

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


class Servers:
    """Processes of servers."""

    def __init__(self, count: int) -> None:
        net = f"127.{secrets.randbelow(253) + 1}"  # two benchmarks at a time do not meet
        self.endpoints = [f"tcp/{net}.{i // 128}.1:{20000 + i % 128}" for i in range(count)]
        self.pipes: list[Connection] = []
        self.processes = []
        for first in range(0, count, SERVERS_PER_PROCESS):
            pipe, end = _spawn.Pipe()
            process = _spawn.Process(target=farm, args=(end, first, self.endpoints[first : first + SERVERS_PER_PROCESS]))
            process.start()
            end.close()
            self.pipes.append(pipe)
            self.processes.append(process)
        opened = [pipe.recv() for pipe in self.pipes]
        self.open_s, self.mb = max(s for s, _ in opened), sum(mb for _, mb in opened) / count

    def ask(self, word: str) -> list[Any]:
        """Every process's answer."""
        for pipe in self.pipes:
            pipe.send(word)
        return [pipe.recv() for pipe in self.pipes]

    def close(self) -> None:
        """End them."""
        for pipe in self.pipes:
            pipe.send("stop")
        for process in self.processes:
            process.join(30.0)
            if process.is_alive():
                process.kill()


@contextlib.contextmanager
def running(count: int) -> Iterator[Servers]:
    """So many servers."""
    servers = Servers(count)
    try:
        yield servers
    finally:
        servers.close()


def live(servers: Servers, times: Times, generations: int, trials_per_slot: int = TRIALS) -> Run:
    """One optimizer with these servers: find them, evaluate some generations, leave."""
    deadline = time.monotonic() + DEADLINE_S
    while sum(servers.ask("clear")):  # leases of the one before
        assert time.monotonic() < deadline, "leases do not end"
        time.sleep(0.2)
    pipe, end = _spawn.Pipe()
    process = _spawn.Process(target=optimizer, args=(end, servers.endpoints, times, generations, trials_per_slot))
    process.start()
    end.close()
    told = pipe.recv()
    process.join()
    reports = servers.ask("report")
    count = len(servers.endpoints)
    when = [when for report in reports for when in report["when"]]
    begin = told["begin"]
    found = Found(
        told["servers"], max(w["offer"] for w in when if w) - begin, told["leased"] - begin,
        told["ready"] - begin, told["ready_cpu_s"], told["ready_mb"], told["threads"], told["descriptors"],
    )  # fmt: skip
    totals: Counter[str] = Counter()
    for report in reports:
        for side in ("received", "sent"):
            for counter in report[side]:
                totals.update({f"{side} {kind}": number for kind, number in counter.items()})
    ran = np.array([row for report in reports for row in report["ran"]]).reshape(-1, 4)

    def farm_cpu_s(begin: float, end: float) -> float:
        samples = [np.array(report["cpu"]).T for report in reports]
        return sum(float(np.diff(np.interp([begin, end], when, used))[0]) for when, used in samples)

    uses = [
        _use(times, ran, work(generation, told["slots"] * trials_per_slot), begin, end, (mine, farm_cpu_s(begin, end)))
        for generation, (begin, end, mine) in enumerate(told["generations"])
    ]
    exchanged = [bytes_ for report in reports for bytes_ in report["bytes"]]
    run = Run(
        found, uses, {kind: number / count for kind, number in sorted(totals.items())},
        (sum(b[0] for b in exchanged) / count / 1e3, sum(b[1] for b in exchanged) / count / 1e3),
        told["rss_mb"], told["leave_s"], told["notes"],
    )  # fmt: skip
    shares = ", ".join(f"{use.efficiency:.3f}" for use in uses)
    print(f"{count} servers, {times}: found {found}; efficiency {shares}; {told['notes']}", file=sys.stderr, flush=True)
    return run


def _use(times: Times, ran: np.ndarray, workload: Workload, begin: float, end: float, cpu: tuple[float, float]) -> Use:
    """What the slots did between two moments."""
    mine = ran[(ran[:, 1] >= begin) & (ran[:, 2] <= end + 1e-3)]
    used, slot = np.unique(mine[:, 0].astype(int), return_inverse=True)
    count, wall = len(used), end - begin
    first, last, busy = np.full(count, end), np.full(count, begin), np.zeros(count)
    np.minimum.at(first, slot, mine[:, 1])
    np.maximum.at(last, slot, mine[:, 2])
    np.add.at(busy, slot, mine[:, 3])
    tail_s = float(end - last.min())
    total = count * wall
    nominal = durations(times, draws(workload.genomes, workload.participants, workload.seeds))
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


# ---- tables and charts --------------------------------------------------------------------------------------------


class Results(NamedTuple):
    """All that was measured."""

    opened: dict[int, float]  # MB per server, by number of servers
    found: dict[int, list[Run]]
    used: dict[tuple[int, float], Run]  # by number of servers and seconds of a trial
    tails: dict[str, tuple[Run, Schedule]]


def table(head: list[str], rows: list[list[str]]) -> None:
    """As Markdown."""
    for row in (head, ["---"] * len(head), *rows):
        print("| " + " | ".join(row) + " |")
    print(flush=True)


def median(runs: list[Run], what: str) -> float:
    """Of a field of how servers were found."""
    return statistics.median(getattr(run.found, what) for run in runs)


def mean(run: Run, what: str) -> float:
    """Of a field of how a run's generations used the slots."""
    return statistics.mean(getattr(use, what) for use in run.uses)


def cpu(run: Run) -> tuple[float, float]:
    """Microseconds per evaluation, of the optimizer and of all servers."""
    mine, theirs = (sum(use.cpu[side] for use in run.uses) for side in (0, 1))
    evaluations = sum(use.evaluations for use in run.uses)
    return mine / evaluations * 1e6, theirs / evaluations * 1e6


def print_tables(results: Results) -> None:
    """For docs/benchmarks.md."""
    print("Finding servers, seconds from before the session is opened; medians\n")
    table(
        ["servers", "never found", "all offered, s", "all leased, s", "all slots ready, s", "optimizer's CPU, s", "memory, MB",
         "threads", "open files", "leaving, s", "MB per server"],
        [
            [f"{size:,}", ", ".join(str(size - run.found.servers) for run in runs),
             *(f"{median(runs, what):.2f}" for what in ("offered_s", "leased_s", "ready_s", "cpu_s")),
             *(f"{median(runs, what):.0f}" for what in ("mb", "threads", "descriptors")),
             f"{statistics.median(run.leave_s for run in runs):.2f}", f"{results.opened[size]:.2f}"]
            for size, runs in results.found.items()
        ],
    )  # fmt: skip
    print("Messages per server of a run that evaluates nothing; received and sent by the server\n")
    kinds = sorted({kind for runs in results.found.values() for run in runs for kind in run.messages})
    table(
        ["servers", *kinds],
        [
            [f"{size:,}", *(f"{statistics.mean(run.messages.get(kind, 0) for run in runs):.2f}" for kind in kinds)]
            for size, runs in results.found.items()
        ],
    )
    print("Generations; shares of slot time lost, CPU in cores and in us per evaluation: optimizer, all servers\n")
    table(
        ["slots", "a trial, s", "evaluations", "efficiency", "lost at the start", "between", "in the tail", "cores", "us each",
         "sent to a server, kB", "optimizer, MB"],
        [
            [f"{size * CAPACITY:,}", f"{mean_s:g}", f"{run.uses[0].evaluations:,}", f"{mean(run, 'efficiency'):.3f}",
             *(f"{mean(run, what):.3f}" for what in ("start", "gaps", "tail")),
             ", ".join(f"{each * mean(run, 'evaluations') / 1e6 / mean(run, 'wall_s'):.2f}" for each in cpu(run)),
             ", ".join(f"{each:.0f}" for each in cpu(run)), f"{run.kilobytes[0]:.0f}", f"{run.rss_mb:.0f}"]
            for (size, mean_s), run in results.used.items()
        ],
    )  # fmt: skip
    print("Tails: from the first slot that gets no more work to the end of the generation\n")
    table(
        ["trial times", "efficiency", "tail, s: mean, longest", "slots idle in it: mean, most", "slot time lost in it",
         "generation, s", "by the schedule", "no trial bound to a server", "and stragglers started twice"],
        [
            [name, f"{mean(run, 'efficiency'):.3f}", f"{mean(run, 'tail_s'):.2f}, {max(u.tail_s for u in run.uses):.2f}",
             f"{mean(run, 'idle'):.2f}, {max(u.idle for u in run.uses):.2f}", f"{mean(run, 'tail'):.3f}",
             f"{mean(run, 'wall_s'):.2f}", *(f"{seconds:.2f}" for seconds in schedule)]
            for name, (run, schedule) in results.tails.items()
        ],
    )  # fmt: skip


def draw(results: Results, file: Path) -> None:
    """The charts."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    plt.rcParams.update({"font.size": 10, "axes.grid": True, "grid.alpha": 0.3, "axes.axisbelow": True})
    figure, ((found, use), (load, tails)) = plt.subplots(2, 2, figsize=(12, 9), layout="constrained")
    sizes = list(results.found)
    for what, label in (
        ("offered_s", "all have offered"),
        ("leased_s", "all have given a lease"),
        ("ready_s", "all slots ready"),
    ):
        found.loglog(sizes, [median(results.found[size], what) for size in sizes], "o-", label=label)
    found.plot([GOAL_FOUND_SERVERS], [GOAL_FOUND_S], "kx", markersize=10, label="goal: below 1 s for 256 servers")
    found.set(title="Finding servers", xlabel="servers", ylabel="s from opening the session")
    found.set_xticks(sizes, [f"{size:,}" for size in sizes])
    found.minorticks_off()

    for mean_s in dict.fromkeys(mean_s for _, mean_s in results.used):
        points = [(size * CAPACITY, run) for (size, s), run in results.used.items() if s == mean_s]
        slots_ = [size for size, _ in points]
        use.semilogx(slots_, [mean(run, "efficiency") for _, run in points], "o-", label=f"trials of {mean_s:g} s")
        load.loglog([run.uses[0].evaluations / mean(run, "wall_s") for _, run in points],
                    [cpu(run)[0] * mean(run, "evaluations") / 1e6 / mean(run, "wall_s") for _, run in points],
                    "o-", label=f"optimizer, trials of {mean_s:g} s")  # fmt: skip
        load.loglog([run.uses[0].evaluations / mean(run, "wall_s") for _, run in points],
                    [cpu(run)[1] * mean(run, "evaluations") / 1e6 / mean(run, "wall_s") for _, run in points],
                    "s--", label=f"all servers, trials of {mean_s:g} s")  # fmt: skip
    use.axhline(GOAL_EFFICIENCY, color="k", linestyle=":", label=f"goal at 4,096 slots: {GOAL_EFFICIENCY:.2f}")
    ticks = sorted({size * CAPACITY for size, _ in results.used})
    use.set_xticks(ticks, [f"{tick:,}" for tick in ticks])
    use.minorticks_off()
    use.set(title="Use of the slots", xlabel="slots", ylabel="ideal time / time of a generation", ylim=(0, 1.02))
    load.axhline(os.cpu_count() or 1, color="k", linestyle=":", label=f"this machine, both sides: {os.cpu_count()} cores")
    load.set(title="What it costs", xlabel="evaluations per second", ylabel="cores busy")

    names = list(results.tails)
    place = np.arange(len(names))
    bars = [("measured", [mean(run, "wall_s") for run, _ in results.tails.values()])]
    bars += [
        (label, [schedule[i] for _, schedule in results.tails.values()])
        for i, label in (
            (0, "same schedule, free network"),
            (1, "no trial bound to a server"),
            (2, "and stragglers started twice"),
        )
    ]
    for i, (label, seconds) in enumerate(bars):
        tails.bar(place + (i - 1.5) * 0.2, seconds, 0.2, label=label)
    tails.set_xticks(place, [name.replace(", ", ",\n") for name in names], fontsize=8)
    tails.set(title="Tails: seconds per generation", ylabel="s")
    for axes in (found, use, load, tails):
        axes.legend(fontsize=8)
    figure.savefig(file, dpi=110)


TAILS = {
    "all alike": Times(0.5),
    "0.5 to 1.5 times the mean": Times(0.5, "uniform"),
    "heavy tail, the trial's own": Times(0.5, "heavy"),
    "heavy tail, the machine's": Times(0.5, "heavy", "execution"),
    "one server 10 times slower": Times(0.5, slow=10.0),
}


LOADS = [(1.0, 10, 16, 1024), (0.1, 50, 16, 64), (4.0, 5, 256, 1024)]  # s of a trial, trials per slot, from and up to servers


def measure(*, quick: bool) -> Results:
    """All sizes."""
    results = Results({}, {}, {}, {})
    for size in (16, 64) if quick else (16, 64, 256, 1024):
        with running(size) as servers:
            results.opened[size] = servers.mb
            runs = [live(servers, Times(), 0) for _ in range(1 if quick else 3)]
            results.found[size] = runs
            for mean_s, per_slot, smallest, largest in LOADS[:1] if quick else LOADS:
                if smallest <= size <= largest:
                    run = live(servers, Times(mean_s), 1 if quick else 2, per_slot)
                    if run.uses:
                        results.used[size, mean_s] = run
            if size == (16 if quick else 64):
                for name, times in TAILS.items():
                    run = live(servers, times, 1 if quick else 3)
                    schedules = [schedule(times, work(g, run.uses[g].evaluations), size) for g in range(len(run.uses))]
                    results.tails[name] = run, Schedule(*(statistics.mean(each) for each in zip(*schedules, strict=True)))
    return results


def main() -> None:
    """Measure, print, draw."""
    parser = argparse.ArgumentParser(description="How zswarm scales, on this machine.")
    parser.add_argument("--quick", action="store_true", help="a small version, for looking whether it works")
    parser.add_argument("--chart", type=Path, default=Path(__file__).with_suffix(".png"), help="where the charts go")
    options = parser.parse_args()
    results = measure(quick=options.quick)
    print_tables(results)
    draw(results, options.chart)


if __name__ == "__main__":
    main()
