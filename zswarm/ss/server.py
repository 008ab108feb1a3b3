"""The simulation server: a loop around the slot table. Zenoh's callbacks only enqueue; the loop owns all state.

Life: start the workers, open the session, declare what can be asked, declare the liveliness token last, serve, drain.
"""

import contextlib
import math
import os
import platform
import secrets
import select
import signal
import sys
import time
from collections import deque
from collections.abc import Callable
from types import FrameType
from typing import Annotated

import msgspec
import structlog
import zenoh
from msgspec import Meta

import zswarm
from zswarm import plugins, session
from zswarm.errors import RemoteProtocolError
from zswarm.protocol import codec, keys
from zswarm.protocol.messages import MAX_TEXT, MIN_MEMORY_MB, Megabytes, Offer, Refused, Requirements, Reserve
from zswarm.ss import memory, slots
from zswarm.ss.worker import Ready, Rest, Worker
from zswarm.version_hash import version_hash

TICK_S = 0.25
INBOX = 10_000  # queries that wait; more are dropped unanswered
SENDERS = 256  # runs that are answered at once

log = structlog.get_logger()


class Options(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a server is told at its start: command line or ``--config`` file."""

    capacity: Annotated[int, Meta(ge=0, le=65_535)] = 0  # slots; 0: one per core
    name: str = ""  # "": the host's name
    realm: str = "default"
    listen: list[str] = []
    connect: list[str] = []
    multicast: bool = True
    simulators: list[str] = []  # offered; empty: all that are installed
    slot_memory_mb: Megabytes = 0  # of a slot's process; 0: its share of the machine's memory
    drain_s: Annotated[float, Meta(ge=0, le=1e6)] = 60.0  # at most, on SIGTERM

    def __post_init__(self) -> None:
        if 0 < self.slot_memory_mb < MIN_MEMORY_MB:
            raise ValueError(f"slot_memory_mb: expected 0 or at least {MIN_MEMORY_MB}, not {self.slot_memory_mb}")


class Server:
    """One daemon."""

    def __init__(self, options: Options, *, until_stdin_closes: bool = False) -> None:
        capacity = options.capacity or os.cpu_count() or 1
        self.options = options
        self.id = keys.new_server_id(options.name or keys.fold(platform.node()))
        self.simulators = options.simulators or plugins.names("simulator")
        offer = Offer(
            server=self.id,
            program=zswarm.__version__,
            machine=f"{platform.system()} {platform.machine()}",
            capacity=capacity,
            free=capacity,
            leases=0,
            simulators=self.simulators,
            representations=plugins.names("representation"),
        )
        self.slots = slots.Slots(capacity, offer, self._mismatch, lambda: secrets.token_bytes(16))
        self.slot_memory_mb = options.slot_memory_mb or memory.per_slot_mb(capacity)
        self.workers = [Worker(self.slot_memory_mb) for _ in range(capacity)]
        self._start_workers()
        self._until_stdin_closes = until_stdin_closes
        self._inbox: deque[zenoh.Query | slots.Event] = deque()
        self._wake, self._woken = os.pipe()
        os.set_blocking(self._wake, False)
        os.set_blocking(self._woken, False)
        self._queries: dict[int, tuple[zenoh.Query, str]] = {}  # with the run that asked
        self._senders: dict[str, session.Sender] = {}
        self._signals: list[int] = []
        self._hashes = {
            (simulator, representation): version_hash(simulator, representation)
            for simulator in self.simulators
            for representation in offer.representations
        }  # of the code as it is now, which the slots run; not of what an upgrade puts there later
        self._drain_by = float("inf")
        self._exit: int | None = None
        self._malformed = 0

    def run(self) -> int:
        """Serve until told to stop; the program's exit code."""
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self._on_signal)
        realm = self.options.realm
        with contextlib.ExitStack() as stack:
            stack.callback(self._close_workers)
            opened, endpoints = session.open_server(self.options.listen, self.options.connect, multicast=self.options.multicast)
            stack.callback(session.close, opened)
            if self.options.multicast and (fault := session.multicast_fault()):
                log.warning("multicast_unavailable", reason=fault, listen=endpoints)  # optimizers need --connect then
            on_query = zenoh.handlers.Callback(self._on_query, indirect=False)
            opened.declare_queryable(keys.offer(realm, self.id), on_query)
            opened.declare_queryable(keys.requests(realm, self.id), on_query)
            opened.liveliness().declare_subscriber(
                keys.run_alive(realm, "*", "*"), zenoh.handlers.Callback(self._on_run, indirect=False), history=True
            )
            token = opened.liveliness().declare_token(keys.alive(realm, self.id))
            log.info(
                "server_ready", server=self.id, capacity=len(self.workers), realm=realm, listen=endpoints,
                simulators=self.simulators, slot_memory_mb=self.slot_memory_mb, program=zswarm.__version__,
            )  # fmt: skip
            self._loop(token)
            for sender in self._senders.values():
                sender.close(2.0)
        log.info("server_stopped", server=self.id)
        return self._exit or 0

    # ---- what other threads and the kernel tell

    def _on_query(self, query: zenoh.Query) -> None:
        if len(self._inbox) < INBOX:
            self._put(query)
        else:
            query.drop()

    def _on_run(self, sample: zenoh.Sample) -> None:
        try:
            user, run = keys.parse_run_key(str(sample.key_expr))
        except RemoteProtocolError:
            return
        seen = sample.kind == zenoh.SampleKind.PUT
        self._put(slots.HolderSeen(user, run) if seen else slots.HolderGone(user, run))

    def _on_signal(self, number: int, _frame: FrameType | None) -> None:
        self._signals.append(number)
        self._awake()

    def _put(self, item: zenoh.Query | slots.Event) -> None:
        self._inbox.append(item)
        self._awake()

    def _awake(self) -> None:
        with contextlib.suppress(BlockingIOError):
            os.write(self._woken, b"!")

    # ---- the loop

    def _loop(self, token: zenoh.LivelinessToken) -> None:
        next_tick = time.monotonic()
        while self._exit is None:
            self._start_workers()
            workers = {worker.pipe.fileno(): index for index, worker in enumerate(self.workers) if worker.pipe is not None}
            poll = select.poll()
            for descriptor in (self._wake, *workers):
                poll.register(descriptor, select.POLLIN)
            if self._until_stdin_closes:
                poll.register(sys.stdin.fileno(), select.POLLIN)
            next_start = min(worker.start_at for worker in self.workers)
            until = min(next_tick, next_start) if self.slots.busy() or self._signals else next_start
            wait = None if math.isinf(until) else max(0.0, until - time.monotonic()) * 1000
            ready = [descriptor for descriptor, _ in poll.poll(wait)]
            if self._wake in ready:
                os.read(self._wake, 4096)
            if self._until_stdin_closes and sys.stdin.fileno() in ready:
                self._exit = 0
            if self._signals:
                self._on_stop_asked(token)
            for descriptor in ready:
                if descriptor in workers:
                    self._handle(self._from_worker(workers[descriptor]))
            for _ in range(len(self._inbox)):
                item = self._inbox.popleft()
                if isinstance(item, zenoh.Query):
                    self._from_run(item)
                else:
                    self._handle(item)
                    if isinstance(item, slots.HolderGone) and (sender := self._senders.pop(f"{item.user}/{item.run}", None)):
                        sender.close()  # or a server would gather a thread for every run
            if time.monotonic() >= next_tick:
                next_tick = time.monotonic() + TICK_S
                self._handle(slots.Tick(tuple(worker.trial() for worker in self.workers)))

    def _on_stop_asked(self, token: zenoh.LivelinessToken) -> None:
        if self.slots.draining and (len(self._signals) > 1 or time.monotonic() > self._drain_by):
            log.warning("drain_cut_short", signals=len(self._signals))
            self._exit = 128 + self._signals[0]
        elif not self.slots.draining:
            log.info("draining", limit_s=self.options.drain_s)
            self._drain_by = time.monotonic() + self.options.drain_s
            token.undeclare()
            self._handle(slots.Drain())

    def _from_run(self, query: zenoh.Query) -> None:
        body = query.payload.to_bytes() if query.payload is not None else b""
        try:
            key, message = codec.decode_query(str(query.key_expr), body)
        except RemoteProtocolError as error:
            self._log_malformed(str(query.key_expr), error)
            self._send(query, "malformed", codec.encode(Refused(code="malformed", reason=str(error))))
            return
        number = id(query)
        self._queries[number] = (query, f"{key.user}/{key.run}")
        self._handle(slots.Asked(number, key.user, key.run, message, body))

    def _start_workers(self) -> None:
        now = time.monotonic()
        for index, worker in enumerate(self.workers):
            if worker.start_at <= now and (reason := worker.start()):
                self._log_pause(index, worker, reason)

    def _from_worker(self, index: int) -> slots.Event:
        worker = self.workers[index]
        try:
            letter, body = worker.receive()
        except (EOFError, OSError):
            trial, reason = worker.trial(), worker.exit_reason()
            self._log_pause(index, worker, reason)
            return slots.Died(index, trial, f"the slot's process {reason}")
        match letter:
            case b"R":
                ready = msgspec.msgpack.decode(body, type=Ready)
                return slots.Prepared(index, ready.probe, ready.trial_s)
            case b"F":
                return slots.Unprepared(index, codec.clean(body.decode(errors="replace")))
            case b"X":
                rest = msgspec.msgpack.decode(body, type=Rest)
                return slots.Exhausted(index, rest.part, rest.done, rest.alone)
            case b"M":
                trial = worker.trial()
                worker.kill()
                return slots.Died(index, trial, body.decode(), "memory")
            case _:
                return slots.Finished(index, body, worn=letter == b"W")

    def _handle(self, event: slots.Event) -> None:
        for command in self.slots.handle(event, time.monotonic()):
            match command:
                case slots.Answer():
                    self._send(*self._queries.pop(command.query), command.body)
                case slots.Prepare():
                    self.workers[command.slot].prepare(command.setup, probe=command.probe)
                case slots.Run():
                    self.workers[command.slot].evaluate(command.body, command.first, command.alone)
                case slots.Stop():
                    self.workers[command.slot].stop()
                case slots.Kill():
                    self.workers[command.slot].kill()
                case slots.Log():
                    log.info(command.event, **command.fields)
                case slots.Drained():
                    self._exit = 128 + self._signals[0]

    # ---- answers

    def _send(self, query: zenoh.Query, who: str, body: bytes) -> None:
        if who not in self._senders:
            if len(self._senders) >= SENDERS:
                oldest = next(iter(self._senders))
                self._senders.pop(oldest).close()
            self._senders[who] = session.Sender(who)
        if not self._senders[who].send(_reply(query, body)):
            log.warning("answer_dropped", run=who)
            query.drop()

    def _log_pause(self, slot: int, worker: Worker, reason: str) -> None:
        if (pause := worker.start_at - time.monotonic()) > 0:
            log.warning("slot_pauses", slot=slot, reason=reason, seconds=round(pause, 1))

    def _log_malformed(self, key: str, error: RemoteProtocolError) -> None:
        """The 1st, 2nd, 4th, 8th ... of them: a flood must not fill the disk."""
        self._malformed += 1
        if self._malformed & (self._malformed - 1) == 0:
            log.warning("malformed", key=codec.clean(key), reason=str(error), count=self._malformed)

    def _mismatch(self, asked: Requirements | Reserve) -> str:
        if isinstance(asked, Reserve):
            simulator, representation = asked.simulator.kind, asked.representation.kind
        else:
            simulator, representation = asked.simulator, asked.representation
        if not simulator and not representation:
            return ""
        if simulator not in self.simulators:
            return f"no simulator {simulator!r} here; there are {', '.join(self.simulators)}"[:MAX_TEXT]
        if (simulator, representation) not in self._hashes:
            return f"no representation {representation!r} here"
        if self._hashes[simulator, representation] != asked.version_hash:
            return f"another version of {simulator}, {representation}, zswarm or numba is installed here"
        if asked.trial_memory_mb > self.slot_memory_mb:
            return f"a slot here has {self.slot_memory_mb} MB, the run asks for {asked.trial_memory_mb}"
        return ""

    def _close_workers(self) -> None:
        for worker in self.workers:
            worker.close()


def _reply(query: zenoh.Query, body: bytes) -> Callable[[], None]:
    def reply() -> None:
        try:
            query.reply(query.key_expr, body)
        except zenoh.ZError as error:
            log.debug("answer_failed", reason=str(error))
        finally:
            query.drop()

    return reply
