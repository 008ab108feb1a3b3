"""The optimizer's side of the network: a shell around ``Dispatch``, whose state belongs to whoever holds its lock.

The caller's thread hands in a workload and takes what is counted, in the order it comes. What arrives while nothing else goes
on is handled in the thread it arrives in, for waking another one takes longer than that; all else waits in a queue for a
thread of its own, which looks at the clock, too. Zenoh's callbacks never wait, neither for the lock nor for a link.
"""

import contextlib
import queue
import threading
import time
from collections import Counter
from collections.abc import Iterator
from functools import partial
from types import TracebackType
from typing import TYPE_CHECKING, NamedTuple, Self

import zenoh

from zswarm import session
from zswarm.errors import EvaluationError, NoRouter, NoServers, RemoteProtocolError
from zswarm.ot import discovery, dispatch
from zswarm.ot.dispatch import (
    Ask,
    Complete,
    Counted,
    Dispatch,
    Disputed,
    Failed,
    Note,
    ProbeDisputed,
    ProbeSettled,
    Retracted,
    Settled,
)
from zswarm.ot.newcomers import Newcomers
from zswarm.ot.requests import Wanted, Who, request
from zswarm.ot.workload import Workload
from zswarm.protocol import codec, keys, messages
from zswarm.protocol.messages import Fault, Outcomes, Running
from zswarm.security import refusals
from zswarm.security.keyring import Keyring
from zswarm.session import Reach

if TYPE_CHECKING:
    from zswarm.ot.controllers import Controllers  # which loads the compiler

FLUSH_S = 0.1  # a waiting caller gets a None this often
TOLD_AT_ONCE = 100  # things for the caller that are kept back at most while more events wait
QUERY_S = {"offer": discovery.OFFER_S, "reserve": 10.0, "renew": 25.0, "evaluate": 60.0, "cancel": 3.0, "release": 3.0}
CONTROL = zenoh.Priority.INTERACTIVE_HIGH  # overtakes batches on the way
RELEASE_S = 2.0  # at most, on leaving
AT_ONCE = 12_000  # bytes of a message that zenoh takes without waiting, on a link on which nothing is unanswered
ALONE_S = 5.0  # with this machine's slots only, before it is found out where the servers in ``connect`` are


class Standing(NamedTuple):
    """How a run stands with its servers."""

    serving: list[str]  # servers with a slot ready
    preparing: list[str]  # servers that get their first one ready
    leased: int  # servers that gave a lease
    spare: int  # servers that would
    slots: int  # ready ones
    probe: bytes  # digest of the probe's outcomes, once known


class Stopped(NamedTuple):
    """The thread ended by an error."""

    error: BaseException


class Woken(NamedTuple):
    """The thread is to look at the clock earlier than it would."""


Item = Counted | Note | Disputed | ProbeDisputed | Retracted


class Cluster:
    """All servers that evaluate for one run, from entering to leaving.

    Args:
        reach: how other machines are reached.
        local: where this machine's slots are dialled; "": there are none.
        controllers: those that servers ask; None: the controllers are sent.
    """

    def __init__(
        self,
        who: Who,
        wanted: Wanted,
        *,
        reach: Reach,
        local: str = "",
        controllers: "Controllers | None" = None,
    ) -> None:
        self.who, self.wanted = who, wanted
        self.standing = Standing([], [], 0, 0, 0, wanted.probe)  # the last one that its thread told
        self._dispatch = Dispatch(
            wanted.participants,
            wanted.metrics,
            wanted_slots=wanted.slots,
            choice=wanted.choice,
            quarantine=wanted.quarantine,
            probe=wanted.probe,
            verify=wanted.verify,
        )
        self._reach, self._local, self._controllers = reach, local, controllers
        self._sessions: list[zenoh.Session] = []
        self._tokens: list[zenoh.LivelinessToken] = []
        self._home: dict[str, zenoh.Session] = {}  # the session that saw a server; written before the server is Seen
        self._leaving = threading.Event()
        self._alone = threading.Timer(ALONE_S, self._on_alone)
        self._alone.daemon = True
        self._owner = threading.Lock()  # of the state: the dispatch, and what is up to the outbox
        self._inbox: queue.SimpleQueue[dispatch.Event | Woken | None] = queue.SimpleQueue()
        self._told: list[Item | Complete | Failed] = []  # for the caller, once the standing is of after them
        self._changed = False  # the standing
        self._unanswered: dict[int, str] = {}  # questions that carry batches, with the server
        self._waited_for = Counter[str]()  # these questions, by server
        self._awake_at = 0.0  # the thread looks at the clock then
        self._newcomers = Newcomers[str]()
        self._outbox: queue.SimpleQueue[Item | Complete | Failed | Stopped] = queue.SimpleQueue()
        self._senders: dict[str, session.Sender] = {}
        self._workload: Workload | None = None

    def __enter__(self) -> Self:
        reach, local = self._reach, [self._local] if self._local else []
        try:
            if reach.through_router or reach.keyring is not None:  # this machine's slots are reached by neither
                if local:
                    self._watch(session.open_optimizer(Reach(local, multicast=False)))
                if not reach.through_router:
                    self._watch(session.open_optimizer(reach), reach.keyring)
            else:
                self._watch(session.open_optimizer(reach._replace(connect=[*reach.connect, *local])))
        except BaseException:  # __exit__ is not called then, whatever it was, Ctrl-C too
            self._close()
            raise
        if reach.through_router:
            threading.Thread(target=self._open_through_router, name="router", daemon=True).start()
        if local and reach.connect:
            self._alone.start()
        self._thread = threading.Thread(target=self._work, name="dispatch", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._inbox.put(dispatch.Leave())
        self._inbox.put(None)
        self._thread.join(RELEASE_S)
        deadline = time.monotonic() + RELEASE_S
        for sender in list(self._senders.values()):
            sender.close(max(0.0, deadline - time.monotonic()))
        self._close()

    def _open_through_router(self) -> None:
        """Opening waits for a router; the run goes on meanwhile."""
        while not self._leaving.wait(FLUSH_S):
            try:
                opened = session.open_through_router(self._reach)
            except NoRouter:
                continue
            if self._leaving.is_set():
                session.close(opened)
            else:
                self._watch(opened, self._reach.keyring)
            return

    def _watch(self, opened: zenoh.Session, ring: Keyring | None = None) -> None:
        self._sessions.append(opened)
        if self._controllers is not None:
            on_sensors = zenoh.handlers.Callback(partial(self._on_sensors, self._controllers), indirect=False)
            opened.declare_queryable(keys.control(self.who.realm, self.who.user, self.who.run, "*"), on_sensors)
        liveliness = opened.liveliness()
        self._tokens.append(liveliness.declare_token(keys.run_alive(self.who.realm, self.who.user, self.who.run)))

        if ring is not None:
            refusals.watch_members(
                opened, ring, lambda name, at, reason: self._outbox.put(Note("diagnosis", "", f"{name} at {at} is {reason}"))
            )

        def on_token(sample: zenoh.Sample) -> None:
            self._on_token(opened, sample)

        liveliness.declare_subscriber(
            keys.any_version_alive(self.who.realm), zenoh.handlers.Callback(on_token, indirect=False), history=True
        )

    def _on_alone(self) -> None:
        if all(server.startswith("local-") for server in list(self._home)):
            self.diagnose()

    def _close(self) -> None:
        self._leaving.set()
        self._alone.cancel()
        for opened in self._sessions:
            session.close(opened)

    # ---- the caller's thread

    def evaluate(self, workload: Workload) -> Iterator[Item | None]:
        """Have evaluated what is not counted yet, from now on; yields what is counted and what happens.

        It yields None when nothing does for 0.1 s. A Disputed or ProbeDisputed wants a call of ``settle``.

        Raises:
            EvaluationError: a trial faults again and again, or the run was taken over.
        """
        self._happened(dispatch.Work(workload), may_send=True)
        return self._until_complete()

    def _until_complete(self) -> Iterator[Item | None]:
        while not isinstance(item := self._next(FLUSH_S), Complete):
            yield item

    def settle(self, settled: Settled | ProbeSettled) -> None:
        """Tell what this machine computes."""
        self._inbox.put(settled)

    def wait(self, servers: int, timeout_s: float) -> Iterator[Item | None]:
        """Wait until so many servers match, busy ones included, and gave a lease if it is wanted; yields as ``evaluate`` does.

        Raises:
            NoServers: not in time.
        """
        deadline = time.monotonic() + timeout_s
        look_at = deadline - timeout_s / 2
        while (found := self.standing.leased + self.standing.spare) < servers:
            if time.monotonic() > look_at:
                look_at = deadline
                self.diagnose()
            left = deadline - time.monotonic()
            if left <= 0:
                raise NoServers(f"{found} of {servers} matching servers were found in {timeout_s:g} s")
            item = self._next(min(left, FLUSH_S))
            if not isinstance(item, Complete):
                yield item

    def rest(self) -> Iterator[Item]:
        """What happened that was not yielded yet."""
        while (item := self._next(0.0)) is not None:
            if not isinstance(item, Complete):
                yield item

    def diagnose(self) -> None:
        """Have it found out why servers are not there; what is found comes as notes, some seconds later."""

        def look() -> None:
            for line in discovery.diagnose(
                self.who.realm,
                list(self._sessions),
                self._reach,
                known=list(self._home),
            ):
                self._outbox.put(Note("diagnosis", "", line))

        threading.Thread(target=look, name="diagnosis", daemon=True).start()

    def _next(self, timeout_s: float) -> Item | Complete | None:
        try:
            item = self._outbox.get(timeout=timeout_s)
        except queue.Empty:
            return None
        if isinstance(item, Stopped):
            raise item.error
        if isinstance(item, Failed):
            raise EvaluationError(item.reason)
        return item

    # ---- zenoh's threads

    def _on_token(self, opened: zenoh.Session, sample: zenoh.Sample) -> None:
        try:
            key = keys.parse_server_key(str(sample.key_expr))
        except RemoteProtocolError:
            return
        if key.version != f"v{keys.VERSION}":
            if sample.kind == zenoh.SampleKind.PUT:
                text = f"speaks version {key.version} of the protocol, this program v{keys.VERSION}"
                self._outbox.put(Note("server_mismatch", key.server, text))
            return
        seen = sample.kind == zenoh.SampleKind.PUT
        self._home[key.server] = opened
        self._inbox.put(dispatch.Seen(key.server) if seen else dispatch.Gone(key.server))

    def _on_sensors(self, controllers: "Controllers", query: zenoh.Query) -> None:
        try:
            server = keys.parse_control_key(str(query.key_expr))
            body = controllers.react(server, query.payload.to_bytes() if query.payload is not None else b"")
        except RemoteProtocolError:  # no such key
            query.drop()
            return
        except BaseException as error:  # a bug
            query.drop()
            self._stop(error)
            return

        def answer() -> None:
            with query, contextlib.suppress(zenoh.ZError):  # the session is closing
                query.reply(query.key_expr, body)

        slots = known.slots if (known := self._dispatch.servers.get(server)) is not None else 1  # each waits for one answer
        if slots * len(body) < AT_ONCE:
            answer()
        elif (sender := self._senders.get(server)) is None or not sender.send(answer):
            query.drop()

    # ---- the owner of the state

    def _happened(self, event: dispatch.Event, *, may_send: bool) -> None:
        """Handle it here and now if nothing else goes on, or have it handled.

        Args:
            may_send: this is the caller's thread, which may wait for a lock of zenoh's.
        """
        if not self._inbox.empty() or not self._owner.acquire(blocking=False):
            self._inbox.put(event)
            return
        try:
            self._handle(event, may_send=may_send)
            self._tell()
            if self._dispatch.next_time() < self._awake_at:
                self._inbox.put(Woken())
        except BaseException as error:  # as in the thread
            if may_send:  # Ctrl-C, most times: it is not kept until the caller asks what happened
                raise
            self._stop(error)
        finally:
            self._owner.release()

    def _work(self) -> None:
        """The thread's."""
        try:
            while True:
                if self._inbox.empty() or len(self._told) >= TOLD_AT_ONCE:  # a look at all servers, not for every event
                    with self._owner:
                        self._tell()
                for event in self._take():
                    if event is None:
                        return
                    with self._owner:
                        self._handle(event, may_send=True)
        except BaseException as error:  # a bug, or a panic in zenoh, which is no Exception: the caller's thread raises it
            self._stop(error)

    def _stop(self, error: BaseException) -> None:
        for last in (*self._told, Stopped(error)):
            self._outbox.put(last)

    def _tell(self) -> None:
        if self._changed:
            self.standing, self._changed = self._standing(), False
        for item in self._told:
            self._outbox.put(item)
        self._told.clear()

    def _handle(self, event: dispatch.Event, *, may_send: bool) -> None:
        if isinstance(event, dispatch.Work):
            self._workload = event.workload
            if self._controllers is not None:
                self._controllers.begin(event.workload)
        elif isinstance(event, dispatch.Answered) and (server := self._unanswered.pop(event.question, "")):
            self._waited_for[server] -= 1
            if not self._waited_for[server]:
                del self._waited_for[server]
        commands = self._dispatch.handle(event, time.monotonic())
        self._changed |= not (isinstance(event, dispatch.Answered) and isinstance(event.reply, Outcomes | Running))
        for command in commands:
            if isinstance(command, Ask):
                self._ask(command, may_send=may_send)
            else:
                self._told.append(command)
        lost = any(isinstance(command, Note) and command.event == "server_lost" for command in commands)
        if lost or isinstance(event, dispatch.Gone):
            self._hang_up()

    def _take(self) -> list[dispatch.Event | None]:
        """The next events; a Tick when it is time for one."""
        now = time.monotonic()
        if new := self._newcomers.take(now):
            return [dispatch.Seen(server) for server in new]
        with self._owner:
            tick_at = self._awake_at = self._dispatch.next_time()
        wait = min(tick_at, self._newcomers.due) - now
        try:
            event = self._inbox.get(timeout=max(0.0, wait)) if wait < 3600 else self._inbox.get()
        except queue.Empty:
            return [dispatch.Tick()] if time.monotonic() >= tick_at else []
        if isinstance(event, Woken):
            return []
        if isinstance(event, dispatch.Seen):
            self._newcomers.add(event.server, time.monotonic())
            return []
        if isinstance(event, dispatch.Gone):
            self._newcomers.remove(event.server)
        return [event]

    def _hang_up(self) -> None:
        """End the senders of servers that left: one that is restarted is another server."""
        for server in [server for server in self._senders if self._dispatch.servers[server].phase == dispatch.Phase.IDLE]:
            self._senders.pop(server).close()

    def _standing(self) -> Standing:
        state = self._dispatch
        return Standing(state.serving(), state.preparing(), state.leased(), state.spare(), state.slots(), state.probe)

    def _ask(self, ask: Ask, *, may_send: bool) -> None:
        question, verb = ask.question, ask.verb
        if verb == "offer":
            key = keys.offer(self.who.realm, ask.server)
        else:
            key = keys.request(self.who.realm, ask.server, self.who.user, self.who.run, verb)
        body = codec.encode(request(ask, self.who, self.wanted, self._workload))
        if self._controllers is not None and ask.trials is not None:
            self._controllers.give(ask.server, ask.lease, ask.batch, ask.trials)
        answered = False

        def on_reply(reply: zenoh.Reply) -> None:  # not the end: zenoh waits for that of every link on which it may be answered
            nonlocal answered
            if reply.ok is not None and not answered:
                answered = True
                event = dispatch.Answered(question, _decode(reply.ok.payload.to_bytes()))
                if self._controllers is not None and isinstance(event.reply, Outcomes | Fault):
                    self._controllers.take_back(ask.server, event.reply.batch)
                if verb == "evaluate":
                    self._happened(event, may_send=False)
                else:
                    self._inbox.put(event)

        def on_end() -> None:
            if not answered:
                self._inbox.put(dispatch.Answered(question, None))

        def send() -> None:
            try:
                self._home[ask.server].get(
                    key,
                    zenoh.handlers.Callback(on_reply, on_end, indirect=False),
                    target=zenoh.QueryTarget.ALL,
                    consolidation=zenoh.ConsolidationMode.NONE,
                    timeout=QUERY_S[verb],
                    congestion_control=zenoh.CongestionControl.BLOCK,
                    priority=zenoh.Priority.DATA if verb == "evaluate" else CONTROL,
                    payload=body,
                )
            except zenoh.ZError:
                self._inbox.put(dispatch.Answered(question, None))  # the session is closing

        if ask.server not in self._senders:
            self._senders[ask.server] = session.Sender(ask.server)
        at_once = False
        if verb == "evaluate":
            waited_for = self._unanswered if self._reach.through_router else self._waited_for[ask.server]  # on its link
            at_once = may_send and len(body) < AT_ONCE and not waited_for
            self._unanswered[question] = ask.server
            self._waited_for[ask.server] += 1
        if not self._senders[ask.server].send(send, at_once=at_once):
            self._inbox.put(dispatch.Answered(question, None))


def _decode(body: bytes) -> messages.Reply | str:
    try:
        return codec.decode_reply(body)
    except RemoteProtocolError as error:
        return str(error)
