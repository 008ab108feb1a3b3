"""The sessions of a run: send queries, receive answers, and watch for servers.

Zenoh's callbacks never wait, neither for a lock nor for a link. Each server has a thread that sends
to it, because a send into a dying link blocks.
"""

import contextlib
import threading
import time
from collections import Counter
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

import msgspec
import zenoh

from zswarm import session
from zswarm.errors import NoRouter, RemoteProtocolError
from zswarm.ot.cluster import diagnosis, discovery
from zswarm.ot.cluster.announced import SAME_NAME, Announced
from zswarm.ot.cluster.events import QUERY_S, Answered, Ask, Event, Gone, Seen
from zswarm.ot.cluster.machines import machine, name_of
from zswarm.ot.notes import Note, RunEvent
from zswarm.protocol import codec, keys, messages
from zswarm.protocol.messages import Evaluate, Fault, Outcomes
from zswarm.security import refusals
from zswarm.security.keyring import Keyring
from zswarm.session import Reach
from zswarm.system.sending import Sender, Threads

if TYPE_CHECKING:
    # It loads the compiler.
    from zswarm.ot.cluster.remote_controllers import RemoteControllers

RETRY_S = 0.1  # between two attempts to reach a router
VERSIONS_S = 1.0  # for the token of this version, after one of another
CONTROL = zenoh.Priority.INTERACTIVE_HIGH  # overtakes batches on the way
RELEASE_S = 2.0  # for the last messages, at most
# Bytes of a message that zenoh takes without waiting, on a link on which nothing is unanswered.
AT_ONCE = 12_000


def _size(message: Evaluate) -> int:
    """Return about how many bytes a message takes."""
    arrays = len(message.participants) + len(message.seeds)
    return sum(map(len, message.genomes)) + 8 * len(message.genomes) + arrays


class Links(msgspec.Struct, eq=False):
    """The sessions of a run."""

    key: keys.RunKey
    reach: Reach
    # Those that servers ask; None: candidates are sent.
    controllers: "RemoteControllers | None"
    post: Callable[[Event | Note], None]
    answered: Callable[[Answered], None]  # takes the answers to batches
    failed: Callable[[BaseException], None]  # takes bugs
    slots: Callable[[str], int]  # returns how many slots of a server the run holds
    sessions: list[zenoh.Session] = []
    # The session that saw a server; written before the server is Seen.
    home: dict[str, zenoh.Session] = {}
    senders: dict[str, Sender] = {}
    _threads: Threads = msgspec.field(default_factory=Threads)
    own: set[str] = set()  # this machine's servers whose tokens were seen
    _present: set[str] = set()  # servers whose token is there
    _addresses: dict[str, str] = {}  # of links, by zenoh's id of the other side
    _members: frozenset[str] = frozenset()  # names of servers with certificates
    _announced: Announced = msgspec.UNSET  # type: ignore[assignment]
    # Names of which too many servers, or servers of another version, are there, as the user knows.
    _many: set[str] = set()
    _others: set[str] = set()
    _tokens: list[zenoh.LivelinessToken] = []
    _leaving: threading.Event = msgspec.field(default_factory=threading.Event)
    _unanswered: dict[int, str] = {}  # questions that carry batches, with the server
    _waited_for: Counter[str] = msgspec.field(default_factory=Counter)  # these, by server

    def __post_init__(self) -> None:
        if (ring := self.reach.keyring) is not None:
            self._members = frozenset(ring.members.servers)
        self._announced = Announced(partial(name_of, members=self._members))

    def open(self, local: str) -> None:
        """Open sessions; one through a router opens once the router is there.

        Args:
            local: endpoint of this machine's slots; "": there are none.
        """
        reach = self.reach
        # This machine's slots have a session of their own: nobody else is there to take their name,
        # and they are reached neither through a router nor with keys.
        if local:
            here = Reach([local], multicast=False)
            self._join(session.open_optimizer(here), own=True)
        if reach.through_router:
            threading.Thread(
                target=self._open_through_router, name="router", daemon=True
            ).start()
        elif reach.connect or reach.multicast:
            self._join(session.open_optimizer(reach), reach.keyring)

    def close(self) -> None:
        """Send what waits, for some seconds at most, and close the sessions."""
        deadline = time.monotonic() + RELEASE_S
        for sender in list(self.senders.values()):
            sender.wait(max(0.0, deadline - time.monotonic()))
        self._threads.close()
        self._leaving.set()
        for opened in self.sessions:
            session.close(opened)

    def hang_up(self, server: str) -> None:
        """Drop the sender to a server that left: one that is restarted is another server."""
        del self.senders[server]

    def forget(self, server: str) -> None:
        """Forget a server that left long ago, unless its token appears just now."""
        home = self.home.pop(server, None)
        if home is not None and server in self._present:
            self.home.setdefault(server, home)

    def was_answered(self, question: int) -> None:
        """Take note that a question which carried a batch has ended."""
        if server := self._unanswered.pop(question, ""):
            self._waited_for[server] -= 1

    def ask(self, ask: Ask, *, may_block: bool) -> None:
        """Send a query.

        Args:
            may_block: this thread may wait for one of zenoh's locks; zenoh's own must not.
        """
        key, server, message, controllers = (
            self.key,
            ask.server,
            ask.message,
            self.controllers,
        )
        verb = messages.verb(message)
        if (
            isinstance(message, Evaluate)
            and controllers is not None
            and ask.trials is not None
        ):
            controllers.give(server, message.lease, message.batch, ask.trials)

        def on_answer(answer: bytes | None, replier: str = "") -> None:
            if answer is None:
                self.post(Answered(ask.question, None))
                return
            by = self._machine(server, replier) if verb == "offer" else ""
            event = Answered(ask.question, discovery.read_reply(answer), by)
            if controllers is not None and isinstance(event.reply, Outcomes | Fault):
                controllers.take_back(server, event.reply.batch)
            (self.answered if verb == "evaluate" else self.post)(event)

        def send() -> None:
            try:
                home = self.home[server]
                body = codec.encode(message)  # not before: many may wait here
            except BaseException:  # which the sender reports
                on_answer(None)
                raise
            session.ask(
                home,
                keys.request(key.realm, server, key.user, key.run, verb),
                body,
                on_answer,
                timeout_s=QUERY_S[verb],
                priority=zenoh.Priority.DATA if verb == "evaluate" else CONTROL,
            )

        at_once = False
        if isinstance(message, Evaluate):
            at_once = self._takes_at_once(server, message) and may_block
            self._unanswered[ask.question] = server
            self._waited_for[server] += 1
        if not self._hand_over(server, send, at_once=at_once):
            on_answer(None)

    def _machine(self, server: str, replier: str) -> str:
        """Return the machine of a server by zenoh's id of who answered for it."""
        opened = self.home.get(server)
        if replier not in self._addresses and opened is not None:
            # Zenoh has not told of the link yet, or there is none.
            for link in opened.info.links():
                self._addresses[str(link.zid)] = link.dst
        return machine(server, self._addresses.get(replier, ""), self._members)

    def _takes_at_once(self, server: str, message: Evaluate) -> bool:
        """Return whether zenoh takes a batch without waiting."""
        shared = self.reach.through_router
        link_busy = self._unanswered if shared else self._waited_for[server]
        return not link_busy and _size(message) < AT_ONCE

    def _hand_over(self, server: str, send: Callable[[], None], *, at_once: bool) -> bool:
        """Have a call to a server made; return False if that cannot be."""
        failed = partial(self._failed_at, f"sending to {server}")
        try:
            if server not in self.senders:
                self.senders[server] = Sender(self._threads, failed)
            return self.senders[server].send(send, at_once=at_once)
        except Exception as error:  # no thread can be started
            failed(error)
            return False

    def _failed_at(self, what: str, error: BaseException) -> None:
        """Report what failed in a thread, which may be one of zenoh's; the run continues."""
        self.post(Note(RunEvent.DIAGNOSIS, "", f"{what} failed: {error!r}"))

    def _open_through_router(self) -> None:
        while not self._leaving.wait(RETRY_S):
            try:
                opened = session.open_through_router(self.reach)
            except NoRouter:
                continue
            except BaseException as error:
                self.failed(error)
                return
            if self._leaving.is_set():
                session.close(opened)
            else:
                self._join(opened, self.reach.keyring)
            return

    def _join(
        self, opened: zenoh.Session, ring: Keyring | None = None, *, own: bool = False
    ) -> None:
        """Show the run on a session, and watch for servers there; only this machine's if own."""
        self.sessions.append(opened)
        on_link = zenoh.handlers.Callback(self._on_link, indirect=False)
        opened.info.declare_link_events_listener(on_link, history=True)
        if self.controllers is not None:
            on_sensors = partial(self._on_sensors, self.controllers)
            callback = zenoh.handlers.Callback(on_sensors, indirect=False)
            opened.declare_queryable(keys.control(*self.key, "*"), callback)
        liveliness = opened.liveliness()
        self._tokens.append(liveliness.declare_token(keys.run_alive(*self.key)))
        if ring is not None:
            refusals.watch_members(opened, ring, self._on_refusal)
        on_token = zenoh.handlers.Callback(
            partial(self._on_token, opened, own), indirect=False
        )
        alive = keys.any_version_alive(self.key.realm)
        liveliness.declare_subscriber(alive, on_token, history=True)

    def _on_link(self, event: zenoh.LinkEvent) -> None:
        if event.kind == zenoh.SampleKind.PUT:
            self._addresses[str(event.link.zid)] = event.link.dst
        else:
            self._addresses.pop(str(event.link.zid), None)

    def _on_refusal(self, name: str, at: str, reason: str) -> None:
        self.post(Note(RunEvent.DIAGNOSIS, "", f"{name} at {at} is {reason}"))

    def _on_token(self, opened: zenoh.Session, own: bool, sample: zenoh.Sample) -> None:
        seen = sample.kind == zenoh.SampleKind.PUT
        key = diagnosis.parsed(sample)
        if key is None or (key.server in self.own and not own):
            return
        name = name_of(key.server, self._members)
        if key.version == keys.CURRENT:
            if own:
                self._on_own(opened, key.server, seen=seen)
            else:
                self._on_server(opened, key.server, name, seen=seen)
        elif seen and name not in self._others:
            self._others.add(name)
            wait = threading.Timer(VERSIONS_S, self._note_other_version, (key,))
            wait.daemon = True
            wait.start()

    def _on_own(self, opened: zenoh.Session, server: str, *, seen: bool) -> None:
        """Take the token of this machine's server, or its end; it may be started again."""
        if seen:
            self.own.add(server)
            self._present.add(server)
            self.home[server] = opened
            self.post(Seen(server, own=True))
        else:
            self._present.discard(server)
            self.post(Gone(server))

    def _on_server(
        self, opened: zenoh.Session, server: str, name: str, *, seen: bool
    ) -> None:
        """Take the token of a server, or its end; of too many servers of a name, only some."""
        if seen:
            if self._announced.add(server, opened):
                self._present.add(server)
                self.home[server] = opened
                self.post(Seen(server))
            elif name not in self._many:
                self._many.add(name)
                text = (
                    f"{SAME_NAME} servers named {name} are used already; if these are several "
                    "machines, each needs a --name of its own"
                )
                self.post(Note(RunEvent.SERVER_MISMATCH, server, text))
            return
        self._present.discard(server)
        instead = self._announced.remove(server)
        self.post(Gone(server))
        if instead is not None:
            self._present.add(instead[0])
            name, self.home[name] = instead
            self.post(Seen(name))

    def _note_other_version(self, key: keys.ServerKey) -> None:
        if key.server not in self.home:
            text = diagnosis.other_version(key)
            self.post(Note(RunEvent.SERVER_MISMATCH, key.server, text))

    def _on_sensors(self, controllers: "RemoteControllers", query: zenoh.Query) -> None:
        try:
            server = keys.parse_control_key(str(query.key_expr))
            payload = query.payload.to_bytes() if query.payload is not None else b""
            body = controllers.react(server, payload)
        except RemoteProtocolError:  # not such a key
            query.drop()
            return
        except BaseException as error:  # the server asks again
            query.drop()
            self._failed_at("answering a server", error)
            return

        def answer() -> None:
            with query, contextlib.suppress(zenoh.ZError):  # the session is closing
                query.reply(query.key_expr, body)

        if self.slots(server) * len(body) < AT_ONCE:  # each slot waits for one answer
            answer()
        elif (sender := self.senders.get(server)) is None or not sender.send(answer):
            query.drop()
