"""Many protocol-true servers in one process; only evaluating is simulated."""

import contextlib
import heapq
import itertools
import multiprocessing
import os
import secrets
import select
import socket
import subprocess
import sys
import time
from collections import Counter, deque
from collections.abc import Iterator
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import msgspec
import psutil
import zenoh
from usage import usage

from scale.pretended import CAPACITY, Times, draws, durations, salt, speed
from zswarm import session
from zswarm.protocol import codec, keys, messages
from zswarm.session import Reach
from zswarm.ss.slots import events
from zswarm.ss.slots.table import SlotTable

REALM = "scale"
TICK_S = 1.0
SERVERS_PER_PROCESS = 128
LINK_S = 0.05  # between two looks whether all servers have a link to the router

spawn = multiprocessing.get_context("spawn")


class Kind(msgspec.Struct):
    """The kind of a message, decoded alone."""

    type: str


_kind = msgspec.msgpack.Decoder(Kind)


class Server:
    """One of them, without a loop of its own."""

    def __init__(self, index: int, endpoint: str, reach: Reach, farm: "Farm") -> None:
        self.index = index
        self.id = keys.new_server_id(f"s{index}")
        self.queries: dict[int, zenoh.Query] = {}
        # A slot's timer counts when it is of the slot's last turn.
        self.turns = [0] * CAPACITY
        self.running = [(0.0, 0.0)] * CAPACITY  # since when, and seconds of work
        self.tick_at = float("inf")  # before the next one of the clock
        self.clear()
        offer = messages.Offer(
            server=self.id,
            program="scale",
            machine="none",
            capacity=CAPACITY,
            free=CAPACITY,
            leases=0,
            simulators=["pretended"],
            representations=["none"],
        )
        self.slots = SlotTable(
            CAPACITY, offer, lambda _: "", lambda: secrets.token_bytes(16)
        )
        self.session, _ = session.open_server([endpoint], reach)
        on_query = zenoh.handlers.Callback(
            lambda query: farm.put(self, query), indirect=False
        )
        self.session.declare_queryable(keys.offer(REALM, self.id), on_query)
        self.session.declare_queryable(keys.requests(REALM, self.id), on_query)
        self.session.liveliness().declare_subscriber(
            keys.run_alive(REALM, "*", "*"),
            zenoh.handlers.Callback(
                lambda sample: farm.put(self, _holder(sample)), indirect=False
            ),
            history=True,
        )
        self.token = self.session.liveliness().declare_token(keys.alive(REALM, self.id))

    def clear(self) -> None:
        """Drop the measurements."""
        self.received: Counter[str] = Counter()
        self.sent: Counter[str] = Counter()
        self.bytes = [0, 0]  # received, sent; of payload
        self.when: dict[str, float] = {}  # the first offered, leased, all ready
        # Slot, from, to, seconds of work.
        self.ran: list[tuple[int, float, float, float]] = []


def _holder(sample: zenoh.Sample) -> events.Event:
    user, run = keys.parse_run_key(str(sample.key_expr))
    return events.HolderAlive(user, run, sample.kind == zenoh.SampleKind.PUT)


class Farm:
    """The servers of one process and their loop; a pipe tells it what to do."""

    def __init__(self, pipe: Connection) -> None:
        self.pipe = pipe
        self.servers: list[Server] = []
        self._inbox: deque[tuple[Server, zenoh.Query | events.Event]] = deque()
        self._wake, self._woken = os.pipe()
        os.set_blocking(self._wake, False)
        os.set_blocking(self._woken, False)
        self._cpu: list[tuple[float, float]] = []  # when, seconds used
        self._timers: list[tuple[float, int, Server, int, int, events.Event]] = []
        self._count = itertools.count()

    def put(self, server: Server, item: zenoh.Query | events.Event) -> None:
        """Take a message from Zenoh's threads."""
        self._inbox.append((server, item))
        with contextlib.suppress(BlockingIOError):
            os.write(self._woken, b"!")

    def run(self, first: int, endpoints: list[str], reach: Reach) -> None:
        """Open the servers and serve until stopped."""
        before = usage(os.getpid()).rss_mb
        begin = time.monotonic()
        self.servers = [
            Server(first + index, endpoint, reach, self)
            for index, endpoint in enumerate(endpoints)
        ]
        while reach.connect and not all(
            server.session.info.routers_zid() for server in self.servers
        ):
            time.sleep(LINK_S)
        self.pipe.send((time.monotonic() - begin, usage(os.getpid()).rss_mb - before))
        poll = select.poll()
        poll.register(self._wake, select.POLLIN)
        poll.register(self.pipe, select.POLLIN)
        next_tick = time.monotonic()
        while True:
            until = min(next_tick, self._timers[0][0] if self._timers else next_tick)
            ready = {
                descriptor
                for descriptor, _ in poll.poll(max(0.0, until - time.monotonic()) * 1000)
            }
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
                if isinstance(event, events.Tick):
                    server.tick_at = float("inf")
                    self._handle(server, event)
                elif turn == server.turns[slot]:
                    self._slot_done(server, slot, event)
            if now >= next_tick:
                next_tick = now + TICK_S
                self._cpu.append((now, time.process_time()))
                for server in self.servers:
                    if server.slots.busy():
                        self._handle(server, events.Tick((0,) * CAPACITY))
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
            "ran": [
                (server.index * CAPACITY + slot, *rest)
                for server in self.servers
                for slot, *rest in server.ran
            ],
        }

    def _asked(self, server: Server, query: zenoh.Query) -> None:
        key = keys.parse_server_key(str(query.key_expr))
        body = query.payload.to_bytes()
        server.received[key.verb] += 1
        server.bytes[0] += len(body)
        server.queries[id(query)] = query
        self._handle(
            server, events.Asked(id(query), key.user, key.run, codec.decode_request(body))
        )

    def _handle(self, server: Server, event: events.Event) -> None:
        now = time.monotonic()
        for command in server.slots.handle(event, now):
            match command:
                case events.Answer():
                    self._answer(server, command, now)
                case events.PrepareSlot(slot, first=first, most=count):
                    self._later(server, slot, now, prepared(slot, first, count))
                case events.PlayProbe(slot, first, count):
                    played = prepared(slot, first, count, loaded=True)
                    self._later(server, slot, now, played)
                case events.RunChunk():
                    self._run(server, command, now)
                case events.StopSlot() | events.KillSlot():
                    server.turns[command.slot] += 1
                    if isinstance(command, events.StopSlot):
                        refused = messages.Refused(code="cancelled", reason="cancelled")
                        self._later(
                            server,
                            command.slot,
                            now,
                            events.Finished(command.slot, refused),
                        )
        if (tick_at := server.slots.next_time()) < server.tick_at:
            server.tick_at = tick_at
            self._later(server, 0, tick_at, events.Tick((0,) * CAPACITY))

    def _run(self, server: Server, command: events.RunChunk, now: float) -> None:
        batch = command.work
        participants, seeds = codec.trials(batch, 1)
        times = msgspec.convert(
            server.slots.slots[command.slot].prepared_for.simulator.settings, Times
        )
        taken = durations(
            times, draws(batch.genomes, participants, seeds, salt(times, server.index))
        )
        seconds = float(taken.sum()) / speed(times, server.index)
        outcomes = messages.Outcomes(
            batch=batch.batch,
            fitness=draws(batch.genomes, participants, seeds).tobytes(),
            metrics=b"",
            seconds=seconds,
        )
        server.running[command.slot] = (now, seconds)
        self._later(
            server,
            command.slot,
            now + seconds,
            events.Finished(command.slot, outcomes),
        )

    def _later(self, server: Server, slot: int, when: float, event: events.Event) -> None:
        heapq.heappush(
            self._timers,
            (when, next(self._count), server, slot, server.turns[slot], event),
        )

    def _slot_done(self, server: Server, slot: int, event: events.Event) -> None:
        if isinstance(event, events.Finished):
            begin, seconds = server.running[slot]
            server.ran.append((slot, begin, time.monotonic(), seconds))
        self._handle(server, event)

    def _answer(self, server: Server, answer: events.Answer, now: float) -> None:
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


def prepared(
    slot: int, first: int, count: int, *, loaded: bool = False
) -> events.Prepared:
    """Return the event of a slot that played trials of the probe in no time."""
    probe = bytes(messages.PROBE_DIGEST * count)
    return events.Prepared(slot, probe, 0.0, first=first, loaded=loaded)


def farm(pipe: Connection, first: int, endpoints: list[str], reach: Reach) -> None:
    """Run a process of servers."""
    # A server of its own has a process of its own.
    os.environ["ZENOH_RUNTIME"] = "(tx: (worker_threads: 1))"
    Farm(pipe).run(first, endpoints, reach)


class Router:
    """A ``zswarm-router`` that carries all messages."""

    def __init__(self, host: str, port: int = 7466) -> None:
        self.endpoint = f"tcp/{host}:{port}"
        program = Path(sys.executable).with_name("zswarm-router")
        self._process = subprocess.Popen(
            [program, "--listen", self.endpoint, "--no-multicast"],
            env={**os.environ, "ZSWARM_KEYS": "none"},
            stderr=subprocess.DEVNULL,
        )
        while self._process.poll() is None:
            with contextlib.suppress(OSError), socket.create_connection((host, port)):
                return
            time.sleep(LINK_S)
        raise RuntimeError(f"{program} ended with code {self._process.returncode}")

    def cpu_s(self) -> float:
        """Return the processor time that it used so far."""
        user, system, *_ = psutil.Process(self._process.pid).cpu_times()
        return float(user + system)

    def close(self) -> None:
        """End it."""
        self._process.terminate()
        self._process.wait()


class Servers:
    """Processes of servers.

    Args:
        routed: a router carries what they and the optimizer say; otherwise, they have links.

    Attributes:
        reach: how an optimizer reaches them.
    """

    def __init__(self, count: int, *, routed: bool = False) -> None:
        # Random, so that two benchmarks at a time do not meet.
        net = f"127.{secrets.randbelow(253) + 1}"
        self.count = count
        self.router = Router(f"{net}.200.1") if routed else None
        endpoints = [f"tcp/{net}.{i // 128}.1:{20000 + i % 128}" for i in range(count)]
        found = Reach(
            [] if self.router is None else [self.router.endpoint], multicast=False
        )
        self.reach = Reach(
            found.connect or endpoints, multicast=False, through_router=routed
        )
        self.pipes: list[Connection] = []
        self.processes = []
        for first in range(0, count, SERVERS_PER_PROCESS):
            pipe, end = spawn.Pipe()
            process = spawn.Process(
                target=farm,
                args=(end, first, endpoints[first : first + SERVERS_PER_PROCESS], found),
            )
            process.start()
            end.close()
            self.pipes.append(pipe)
            self.processes.append(process)
        opened = [pipe.recv() for pipe in self.pipes]
        self.open_s, self.mb = (
            max(s for s, _ in opened),
            sum(mb for _, mb in opened) / count,
        )

    def ask(self, word: str) -> list[Any]:
        """Return every process's answer."""
        for pipe in self.pipes:
            pipe.send(word)
        return [pipe.recv() for pipe in self.pipes]

    def close(self) -> None:
        """End the processes."""
        for pipe in self.pipes:
            pipe.send("stop")
        for process in self.processes:
            process.join(30.0)
            if process.is_alive():
                process.kill()
        if self.router is not None:
            self.router.close()


@contextlib.contextmanager
def running(count: int, *, routed: bool = False) -> Iterator[Servers]:
    """Start that many servers, and end them afterwards; the rest as ``Servers``."""
    servers = Servers(count, routed=routed)
    try:
        yield servers
    finally:
        servers.close()
