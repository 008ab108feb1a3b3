"""A server as the network sees it: a session, its queryables, and a liveliness token.

It can be opened again with other keys or endpoints: the server stays the same, and runs that lost
their link return to their leases. Zenoh's callbacks only put items into the inbox.
"""

import contextlib
import os
import threading
from collections import Counter, deque
from collections.abc import Callable, Iterator
from functools import partial

import msgspec
import zenoh

from zswarm import daemon, session
from zswarm.errors import RemoteProtocolError, UnknownMessageError
from zswarm.protocol import codec, keys, versions
from zswarm.protocol.messages import MAX_TEXT, Refusal, Refused
from zswarm.security import refusals
from zswarm.session import Reach
from zswarm.ss.local.control import LocalQuery
from zswarm.ss.slots import events
from zswarm.ss.workers.remote import FullPipe, Unheard
from zswarm.system import log
from zswarm.system.sending import Sender, Threads
from zswarm.system.text import clean

ANSWER_S = 2.0  # for the optimizer to answer; zenoh keeps a kilobyte per query as long
MAX_SENDERS = 256  # runs to which answers wait
# Items of peers, and bytes of their queries, that wait; further ones are dropped unanswered. And
# how many of them may be one user's, or of no user: offers and malformed keys.
MAX_INBOX, MAX_INBOX_BYTES = 10_000, 256 << 20
SHARE, SHARE_BYTES = 2_500, 64 << 20


class PeerQuery:
    """A query that waits for its answer.

    Attributes:
        size: bytes of its payload.
        refusal: why it is refused before it is decoded; "": it is not.
    """

    def __init__(self, query: zenoh.Query) -> None:
        self._query = query
        self.key = str(query.key_expr)
        self.size = len(query.payload) if query.payload is not None else 0
        self.user, self.refusal = "", ""
        self.run = "malformed"  # user and run, whose thread answers
        try:
            key = keys.parse_server_key(self.key)
            self.user, self.run = key.user, f"{key.user}/{key.run}"
            codec.check_size(key.verb, self.size)
        except RemoteProtocolError as error:
            self.refusal = str(error)
        self.version = keys.CURRENT  # of the peer's protocol

    def body(self) -> bytes:
        """Return a copy of the payload."""
        payload = self._query.payload
        return payload.to_bytes() if payload is not None else b""

    def answer(self, body: bytes) -> None:
        """Answer, in a thread that may block; the peer may be gone."""
        try:
            self._query.reply(self._query.key_expr, body)
        except zenoh.ZError as error:
            log.debug("answer_failed", reason=str(error)[:MAX_TEXT])
        finally:
            self._query.drop()

    def drop(self) -> None:
        """Leave it unanswered."""
        self._query.drop()


# An int is the number of a signal.
Item = PeerQuery | LocalQuery | Unheard | FullPipe | events.Event | int


class Inbox:
    """Queues from other threads and signals to the server's loop; readable when it has items.

    Each user has a queue of limited size, and users take turns: one who sends much delays the
    others by one item each.
    """

    def __init__(self) -> None:
        self._items: deque[Item] = deque()  # of this machine
        self._users: dict[
            str, deque[tuple[Item, int]]
        ] = {}  # items and bytes; the next is first
        self._waiting: Counter[str] = Counter()  # bytes by user
        self._count = self._bytes = 0  # of all users
        self._lock = threading.Lock()
        self._wake, self.woken = os.pipe()
        os.set_blocking(self._wake, False)
        os.set_blocking(self.woken, False)

    def fileno(self) -> int:
        """Return the descriptor to wait for."""
        return self._wake

    def __len__(self) -> int:
        return len(self._items) + self._count

    def put(self, item: Item) -> None:
        """Append an item, and wake the loop."""
        self._items.append(item)
        self._wake_loop()

    def put_of(self, user: str, item: Item, size: int = 0) -> bool:
        """Append an item of a peer, and wake the loop; return False if there is no room for it.

        Args:
            user: whose share it takes; "": that of all others.
            size: in bytes.
        """
        with self._lock:
            queue = self._users.get(user, deque())
            if (
                self._count >= MAX_INBOX
                or len(queue) >= SHARE
                or self._bytes + size > MAX_INBOX_BYTES
                or self._waiting[user] + size > SHARE_BYTES
            ):
                return False
            queue.append((item, size))
            self._users[user] = queue
            self._waiting[user] += size
            self._bytes += size
            self._count += 1
        self._wake_loop()
        return True

    def _wake_loop(self) -> None:
        with contextlib.suppress(BlockingIOError):
            os.write(self.woken, b"!")

    def clear_wake(self) -> None:
        """Read the descriptor until the next item comes."""
        with contextlib.suppress(BlockingIOError):
            os.read(self._wake, 4096)

    def take(self) -> Iterator[Item]:
        """Remove and yield waiting items: first those of this machine, then of users in turn."""
        while True:
            if self._items:
                yield self._items.popleft()
            elif self._count:
                yield self._take_of_user()
            else:
                return

    def _take_of_user(self) -> Item:
        with self._lock:
            user = next(iter(self._users))
            queue = self._users.pop(user)
            item, size = queue.popleft()
            self._waiting[user] -= size
            self._bytes -= size
            self._count -= 1
            if queue:
                self._users[user] = queue  # behind the others
            else:
                del self._waiting[user]
        return item


class Presence(msgspec.Struct, eq=False):
    """A server on the network."""

    realm: str
    server: str
    inbox: Inbox
    private: bool  # it is reached only by the program that started it
    endpoints: list[str] = []  # that it listens on
    malformed: int = 0  # number of messages
    _session: zenoh.Session | None = None
    _tokens: list[zenoh.LivelinessToken] = []  # one for each version of the protocol
    _older: dict[str, str] = {}  # runs that speak an older version, and which
    _senders: dict[str, Sender] = {}
    _threads: Threads = msgspec.field(default_factory=Threads)

    def open(self, listen: list[str], reach: Reach, *, visible: bool) -> None:
        """Open the session; declare the liveliness token if the server is to be visible."""
        self._session, self.endpoints = session.open_server(listen, reach)
        if not self.private:
            daemon.watch(self._session, self.endpoints, reach, "server")
        refusals.watch_routers(reach.connect, reach.keyring)
        on_query = zenoh.handlers.Callback(self._on_query, indirect=False)
        on_run = zenoh.handlers.Callback(self._on_run, indirect=False)
        liveliness = self._session.liveliness()
        here = self.realm, self.server
        for version in (keys.CURRENT, *versions.OLDER):
            self._session.declare_queryable(keys.offer(*here, version), on_query)
            self._session.declare_queryable(keys.requests(*here, version), on_query)
            runs = keys.run_alive(self.realm, "*", "*", version)
            liveliness.declare_subscriber(runs, on_run, history=True)
            if visible:
                token = liveliness.declare_token(keys.alive(*here, version))
                self._tokens.append(token)

    def leave(self) -> None:
        """Undeclare the liveliness tokens; queries are still answered."""
        while self._tokens:
            self._tokens.pop().undeclare()

    def close(self) -> None:
        """Close the session."""
        if self._session is not None:
            session.close(self._session)
        self._threads.close()
        self._session = None
        self._tokens.clear()

    def _on_query(self, query: zenoh.Query) -> None:
        waiting = PeerQuery(query)
        if not self.inbox.put_of(waiting.user, waiting, waiting.size):
            waiting.drop()

    def _on_run(self, sample: zenoh.Sample) -> None:
        try:
            user, run = keys.parse_run_key(str(sample.key_expr))
        except RemoteProtocolError:
            return
        alive = sample.kind == zenoh.SampleKind.PUT
        self.inbox.put_of(user, events.HolderAlive(user, run, alive))

    # ---- queries and their answers

    def decode(self, query: PeerQuery) -> events.Asked | None:
        """Return the event of a query; answer one that is malformed."""
        try:
            if query.refusal:
                raise RemoteProtocolError(query.refusal)
            key, message = codec.decode_query(query.key, query.body())
        except RemoteProtocolError as error:
            self.malformed += 1
            if self.malformed & (self.malformed - 1) == 0:
                # A flood must not fill the disk.
                fields = {"key": clean(query.key), "reason": str(error)}
                log.warning("malformed", **fields, count=self.malformed)
            unknown = isinstance(error, UnknownMessageError)
            code: Refusal = "unsupported" if unknown else "malformed"
            refused = Refused(code=code, reason=str(error)[:MAX_TEXT])
            self.answer(query, codec.encode(refused))
            return None
        query.version = key.version
        if key.version in versions.OLDER:
            self._older[query.run] = key.version
        return events.Asked(id(query), key.user, key.run, message)

    def answer(self, query: PeerQuery, body: bytes) -> None:
        """Answer in another thread: a send into a dying link blocks."""
        body = versions.sent(query.version, body)
        if not self._sender(query.run).send(lambda: query.answer(body)):
            log.warning("answer_dropped", run=query.run)
            query.drop()

    def _sender(self, run: str) -> Sender:
        if run not in self._senders:
            if len(self._senders) >= MAX_SENDERS:
                del self._senders[next(iter(self._senders))]
            self._senders[run] = Sender(self._threads, partial(self._not_sent, run))
        return self._senders[run]

    def _not_sent(self, run: str, error: BaseException) -> None:
        log.error("sending_failed", run=run, reason=clean(repr(error)))

    def forget(self, run: str) -> None:
        """Forget a run that is gone."""
        self._older.pop(run, None)
        self._senders.pop(run, None)

    def finish(self, timeout_s: float) -> None:
        """Give the answers that are on their way so long."""
        for sender in self._senders.values():
            sender.wait(timeout_s)

    # ---- questions

    def ask(
        self,
        run: tuple[str, str],
        number: int,
        body: bytes,
        take: Callable[[int, bytes], None],
        at_once: bool,
    ) -> None:
        """Ask a run's optimizer; put ``Unheard`` into the inbox if no answer comes.

        Args:
            run: user and run.
            take: called with the number and the answer, in zenoh's threads.
            at_once: send in this thread, because it does not block.
        """
        version = self._older.get("/".join(run), keys.CURRENT)

        def on_answer(answer: bytes | None, _replier: str = "") -> None:
            if answer is None:
                self.inbox.put(Unheard(number))
            else:
                take(number, versions.taken(version, answer))

        def send() -> None:
            if (opened := self._session) is None:  # during a reload
                on_answer(None)
                return
            session.ask(
                opened,
                keys.control(self.realm, *run, self.server, version),
                versions.sent(version, body),
                on_answer,
                timeout_s=ANSWER_S,
                priority=zenoh.Priority.INTERACTIVE_LOW,
                express=True,
            )

        if not self._sender("/".join(run)).send(send, at_once=at_once):
            on_answer(None)
