"""The simulation server: a loop around the slot table. Zenoh's callbacks only enqueue; the loop owns all state.

Life: start the workers, open the session, declare what can be asked, declare the liveliness token last, serve, drain.
"""

import contextlib
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
from zswarm.protocol.messages import MAX_MESSAGE, MAX_TEXT, Offer, Refused, Requirements, Reserve
from zswarm.ss import slots
from zswarm.ss.worker import Ready, Worker
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
    drain_s: Annotated[float, Meta(ge=0, le=1e6)] = 60.0  # at most, on SIGTERM


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
        self.workers = [Worker() for _ in range(capacity)]
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
            on_query = zenoh.handlers.Callback(self._on_query, indirect=False)
            opened.declare_queryable(keys.offer(realm, self.id), on_query)
            opened.declare_queryable(keys.requests(realm, self.id), on_query)
            opened.liveliness().declare_subscriber(
                keys.run_alive(realm, "*", "*"), zenoh.handlers.Callback(self._on_run, indirect=False), history=True
            )
            token = opened.liveliness().declare_token(keys.alive(realm, self.id))
            log.info(
                "server_ready", server=self.id, capacity=len(self.workers), realm=realm, listen=endpoints,
                simulators=self.simulators, program=zswarm.__version__,
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
            poll = select.poll()
            for descriptor in (self._wake, *(worker.pipe.fileno() for worker in self.workers)):
                poll.register(descriptor, select.POLLIN)
            if self._until_stdin_closes:
                poll.register(sys.stdin.fileno(), select.POLLIN)
            ticking = self.slots.busy() or self._signals
            ready = {
                descriptor for descriptor, _ in poll.poll(max(0.0, next_tick - time.monotonic()) * 1000 if ticking else None)
            }
            if self._wake in ready:
                os.read(self._wake, 4096)
            if self._until_stdin_closes and sys.stdin.fileno() in ready:
                self._exit = 0
            if self._signals:
                self._on_stop_asked(token)
            for index, worker in enumerate(self.workers):
                if worker.pipe.fileno() in ready:
                    self._handle(self._from_worker(index, worker))
            for _ in range(len(self._inbox)):
                item = self._inbox.popleft()
                if isinstance(item, zenoh.Query):
                    self._from_run(item)
                else:
                    self._handle(item)
            if time.monotonic() >= next_tick:
                next_tick = time.monotonic() + TICK_S
                self._handle(slots.Tick(tuple(int(worker.progress[0]) for worker in self.workers)))

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
        who = "offer"
        try:
            key = keys.parse_server_key(str(query.key_expr))
            who = f"{key.user}/{key.run}"
            size = len(query.payload) if query.payload is not None else 0
            if size > MAX_MESSAGE:
                raise RemoteProtocolError(f"a message has {size} bytes; at most {MAX_MESSAGE} are taken")
            body = query.payload.to_bytes() if query.payload is not None else b""
            message = codec.decode_request(body)
            if key.verb != ("offer" if isinstance(message, Requirements) else type(message).__name__.lower()):
                raise RemoteProtocolError(f"a {type(message).__name__} was sent to {key.verb}")
        except RemoteProtocolError as error:
            self._log_malformed(who, error)
            self._send(query, who, codec.encode(Refused(code="malformed", reason=str(error))))
            return
        number = id(query)
        self._queries[number] = (query, who)
        self._handle(slots.Asked(number, key.user, key.run, message, body))

    def _from_worker(self, index: int, worker: Worker) -> slots.Event:
        try:
            letter, body = worker.receive()
        except (EOFError, OSError):
            trial = max(0, int(worker.progress[0]))
            return slots.Died(index, trial, f"the slot's process was {worker.exit_reason()}")
        match letter:
            case b"R":
                ready = msgspec.msgpack.decode(body, type=Ready)
                return slots.Prepared(index, ready.probe, ready.trial_s)
            case b"F":
                return slots.Unprepared(index, codec.clean(body.decode()))
            case _:
                return slots.Finished(index, body)

    def _handle(self, event: slots.Event) -> None:
        for command in self.slots.handle(event, time.monotonic()):
            match command:
                case slots.Answer():
                    self._send(*self._queries.pop(command.query), command.body)
                case slots.Prepare():
                    self.workers[command.slot].prepare(command.setup, probe=command.probe)
                case slots.Run():
                    self.workers[command.slot].evaluate(command.body)
                case slots.Stop():
                    self.workers[command.slot].stop()
                case slots.Kill():
                    self.workers[command.slot].restart()
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

    def _log_malformed(self, who: str, error: RemoteProtocolError) -> None:
        """The 1st, 2nd, 4th, 8th ... of them: a flood must not fill the disk."""
        self._malformed += 1
        if self._malformed & (self._malformed - 1) == 0:
            log.warning("malformed", run=codec.clean(who), reason=str(error), count=self._malformed)

    def _mismatch(self, asked: Requirements | Reserve) -> str:
        if isinstance(asked, Reserve):
            simulator, representation = asked.simulator.kind, asked.representation.kind
        else:
            simulator, representation = asked.simulator, asked.representation
        if not simulator and not representation:
            return ""
        if simulator not in self.simulators:
            return f"no simulator {codec.clean(simulator)!r} here; there are {', '.join(self.simulators)}"[:MAX_TEXT]
        if (simulator, representation) not in self._hashes:
            return f"no representation {codec.clean(representation)!r} here"
        if self._hashes[simulator, representation] != asked.version_hash:
            return f"another version of {simulator}, {representation}, zswarm or numba is installed here"
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
