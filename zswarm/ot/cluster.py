"""The optimizer's side of the network: a thread around ``Dispatch``. Zenoh's callbacks only enqueue; the thread owns all state.

The caller's thread hands in a workload and takes what is counted, in the order it comes.
"""

import queue
import threading
import time
from collections.abc import Iterator
from types import TracebackType
from typing import NamedTuple, Self

import msgspec
import zenoh

from zswarm import session
from zswarm.errors import EvaluationError, NoServers, RemoteProtocolError
from zswarm.ot import dispatch
from zswarm.ot.dispatch import Ask, Complete, Counted, Dispatch, Failed, Note, Workload
from zswarm.protocol import codec, keys, messages
from zswarm.protocol.messages import Message, Offer, Outcomes, Part, Requirements, Reserve

FLUSH_S = 0.1  # a waiting caller gets a None this often
QUERY_S = {"offer": 3.0, "reserve": 10.0, "renew": 25.0, "evaluate": 60.0, "cancel": 3.0, "release": 3.0}
CONTROL = zenoh.Priority.INTERACTIVE_HIGH  # overtakes batches on the way
RELEASE_S = 2.0  # at most, on leaving


class Wanted(NamedTuple):
    """What a run asks of servers."""

    simulator: Part
    representation: Part
    version_hash: str
    participants: int
    metrics: int
    trial_timeout_s: float
    slots: int
    quarantine: bool
    probe: bytes


class Who(NamedTuple):
    """Who asks."""

    realm: str
    user: str
    run: str
    epoch: int
    nonce: bytes


class Standing(NamedTuple):
    """How a run stands with its servers."""

    serving: list[str]  # servers with a slot ready
    preparing: list[str]  # servers that get their first one ready
    leased: int  # servers that gave a lease
    slots: int  # ready ones
    probe: bytes  # digest of the probe's outcomes, once known


class Stopped(NamedTuple):
    """The thread ended by an error."""

    error: BaseException


class Cluster:
    """All servers that evaluate for one run, from entering to leaving."""

    def __init__(self, who: Who, wanted: Wanted, *, connect: list[str], multicast: bool) -> None:
        self.who, self.wanted = who, wanted
        self.standing = Standing([], [], 0, 0, wanted.probe)  # the last one that its thread told
        self._dispatch = Dispatch(
            wanted.participants,
            wanted.metrics,
            wanted_slots=wanted.slots,
            quarantine=wanted.quarantine,
            probe=wanted.probe,
        )
        self._connect, self._multicast = connect, multicast
        self._inbox: queue.SimpleQueue[dispatch.Event | None] = queue.SimpleQueue()
        self._outbox: queue.SimpleQueue[Counted | Note | Complete | Failed | Stopped] = queue.SimpleQueue()
        self._senders: dict[str, session.Sender] = {}
        self._workload: Workload | None = None

    def __enter__(self) -> Self:
        self._session = session.open_optimizer(self._connect, multicast=self._multicast)
        try:
            liveliness = self._session.liveliness()
            self._token = liveliness.declare_token(keys.run_alive(self.who.realm, self.who.user, self.who.run))
            liveliness.declare_subscriber(
                keys.any_version_alive(self.who.realm),
                zenoh.handlers.Callback(self._on_token, indirect=False),
                history=True,
            )
        except BaseException:
            session.close(self._session)
            raise
        self._thread = threading.Thread(target=self._work, name="dispatch", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._inbox.put(dispatch.Leave())
        self._inbox.put(None)
        self._thread.join(RELEASE_S)
        deadline = time.monotonic() + RELEASE_S
        for sender in self._senders.values():
            sender.close(max(0.0, deadline - time.monotonic()))
        session.close(self._session)

    # ---- the caller's thread

    def evaluate(self, workload: Workload) -> Iterator[Counted | Note | None]:
        """Evaluate what is not counted yet; yields what is counted and what happens, and None when nothing does for 0.1 s.

        Raises:
            EvaluationError: a trial faults again and again, or the run was taken over.
        """
        self._inbox.put(dispatch.Work(workload))
        while True:
            item = self._next(FLUSH_S)
            if isinstance(item, Complete):
                return
            yield item

    def wait(self, servers: int, timeout_s: float) -> Iterator[Note]:
        """Wait until so many servers match and gave a lease, busy ones included; yields what happens.

        Raises:
            NoServers: not in time.
        """
        deadline = time.monotonic() + timeout_s
        while (leased := self.standing.leased) < servers:
            left = deadline - time.monotonic()
            if left <= 0:
                raise NoServers(f"{leased} of {servers} matching servers were found in {timeout_s:g} s")
            item = self._next(min(left, FLUSH_S))
            if isinstance(item, Note):
                yield item

    def _next(self, timeout_s: float) -> Counted | Note | Complete | None:
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

    def _on_token(self, sample: zenoh.Sample) -> None:
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
        self._inbox.put(dispatch.Seen(key.server) if seen else dispatch.Gone(key.server))

    # ---- the owner's thread

    def _work(self) -> None:
        try:
            while True:
                wait = self._dispatch.next_time() - time.monotonic()
                try:
                    event = self._inbox.get(timeout=max(0.0, wait)) if wait < 3600 else self._inbox.get()
                except queue.Empty:
                    event = dispatch.Tick()
                if event is None:
                    return
                if isinstance(event, dispatch.Work):
                    self._workload = event.workload
                commands = self._dispatch.handle(event, time.monotonic())
                if not (isinstance(event, dispatch.Answered) and isinstance(event.reply, Outcomes)):
                    self.standing = self._standing()  # before the caller is told why
                for command in commands:
                    if isinstance(command, Ask):
                        self._ask(command)
                    else:
                        self._outbox.put(command)
        except BaseException as error:  # a bug: the caller's thread raises it
            self._outbox.put(Stopped(error))

    def _standing(self) -> Standing:
        state = self._dispatch
        return Standing(state.serving(), state.preparing(), state.leased(), state.slots(), state.probe)

    def _ask(self, ask: Ask) -> None:
        question, verb = ask.question, ask.verb
        if verb == "offer":
            key = keys.offer(self.who.realm, ask.server)
        else:
            key = keys.request(self.who.realm, ask.server, self.who.user, self.who.run, verb)
        body = codec.encode(self._message(ask))
        replies: list[bytes] = []

        def on_reply(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                replies.append(reply.ok.payload.to_bytes())

        def on_end() -> None:
            self._inbox.put(dispatch.Answered(question, _decode(replies[0]) if replies else None))

        def send() -> None:
            try:
                self._session.get(
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
        if not self._senders[ask.server].send(send):
            self._inbox.put(dispatch.Answered(question, None))

    def _message(self, ask: Ask) -> Message:
        wanted = self.wanted
        match ask.verb:
            case "offer":
                return Requirements(
                    simulator=wanted.simulator.kind,
                    representation=wanted.representation.kind,
                    version_hash=wanted.version_hash,
                )
            case "reserve":
                return Reserve(
                    nonce=self.who.nonce,
                    epoch=self.who.epoch,
                    slots=wanted.slots,
                    simulator=wanted.simulator,
                    representation=wanted.representation,
                    version_hash=wanted.version_hash,
                    trial_timeout_s=wanted.trial_timeout_s,
                )
            case "renew":
                return messages.Renew(lease=ask.lease, known_ready=ask.known_ready)
            case "cancel":
                return messages.Cancel(lease=ask.lease, batches=list(ask.batches))
            case "release":
                return messages.Release(lease=ask.lease)
        assert self._workload is not None and ask.trials is not None  # noqa: PT018, S101  an evaluate has both
        genomes, participants, seeds = self._workload.batch(ask.trials)
        return messages.Evaluate(
            lease=ask.lease,
            batch=ask.batch,
            genomes=genomes,
            participants=participants.astype("<u4").tobytes(),
            seeds=seeds.astype("<u8").tobytes(),
        )


def _decode(body: bytes) -> messages.Reply | str:
    try:
        return codec.decode_reply(body)
    except RemoteProtocolError as error:
        return str(error)


class Found(msgspec.Struct, frozen=True):
    """A server, or why nothing is known of it."""

    server: str
    offer: Offer | None
    reason: str = ""


def servers(realm: str, *, connect: list[str], multicast: bool, requirements: Requirements, wait_s: float) -> list[Found]:
    """All servers of a realm that show up within a time, with their offers."""
    tokens: queue.SimpleQueue[str] = queue.SimpleQueue()

    def on_token(sample: zenoh.Sample) -> None:
        if sample.kind == zenoh.SampleKind.PUT:
            tokens.put(str(sample.key_expr))

    found: dict[str, Found] = {}
    opened = session.open_optimizer(connect, multicast=multicast)
    try:
        opened.liveliness().declare_subscriber(
            keys.any_version_alive(realm), zenoh.handlers.Callback(on_token, indirect=False), history=True
        )
        deadline = time.monotonic() + wait_s
        while (left := deadline - time.monotonic()) > 0:
            try:
                key = keys.parse_server_key(tokens.get(timeout=left))
            except queue.Empty:
                break
            except RemoteProtocolError:
                continue
            if key.version != f"v{keys.VERSION}":
                found[key.server] = Found(key.server, None, f"speaks version {key.version} of the protocol")
            else:
                found[key.server] = _offer(opened, realm, key.server, requirements)
    finally:
        session.close(opened)
    return [found[server] for server in sorted(found)]


def _offer(opened: zenoh.Session, realm: str, server: str, requirements: Requirements) -> Found:
    for reply in opened.get(
        keys.offer(realm, server),
        target=zenoh.QueryTarget.ALL,
        timeout=QUERY_S["offer"],
        payload=codec.encode(requirements),
    ):
        if reply.ok is not None:
            answer = _decode(reply.ok.payload.to_bytes())
            if isinstance(answer, Offer):
                return Found(server, answer)
            return Found(server, None, answer if isinstance(answer, str) else str(getattr(answer, "reason", "")))
    return Found(server, None, "does not answer")
