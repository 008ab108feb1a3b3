"""A server as the network sees it: a session, what can be asked there, and a liveliness token, declared last.

It can be opened anew, with other keys or endpoints: the server stays the same one, and runs that lost their link come back to
what they had. Zenoh's callbacks only enqueue.
"""

from collections.abc import Callable

import structlog
import zenoh

from zswarm import session
from zswarm.errors import RemoteProtocolError
from zswarm.protocol import keys
from zswarm.protocol.messages import MAX_TEXT
from zswarm.security import refusals
from zswarm.session import Reach
from zswarm.ss import slots
from zswarm.ss.asking import Unheard

CONTROL_S = 2.0  # an answer is waited for; zenoh keeps a kilobyte per query as long
SENDERS = 256  # runs that are answered at once

log = structlog.get_logger()


class Question:
    """A request that waits for its answer."""

    def __init__(self, query: zenoh.Query) -> None:
        self._query = query
        self.key = str(query.key_expr)
        self.body = query.payload.to_bytes() if query.payload is not None else b""

    def answer(self, body: bytes) -> None:
        """Answer it; whoever asked may be gone. To be called on a thread of its own, for it may block."""
        try:
            self._query.reply(self._query.key_expr, body)
        except zenoh.ZError as error:
            log.debug("answer_failed", reason=str(error)[:MAX_TEXT])
        finally:
            self._query.drop()

    def drop(self) -> None:
        """Leave it unanswered."""
        self._query.drop()


class Presence:
    """One server's.

    Args:
        private: nobody but the program that started it can reach it.
        put: takes what comes, on zenoh's threads; False when there is too much of it.
    """

    def __init__(
        self, realm: str, server: str, put: Callable[[Question | Unheard | slots.Event], bool], *, private: bool
    ) -> None:
        self._realm, self._server, self._put, self._private = realm, server, put, private
        self._session: zenoh.Session | None = None
        self._token: zenoh.LivelinessToken | None = None
        self._senders: dict[str, session.Sender] = {}
        self.endpoints: list[str] = []

    def open(self, listen: list[str], reach: Reach, *, seen: bool = True) -> None:
        """Be there.

        Args:
            seen: declare the token; a server that drains is asked for what it has only.

        Raises:
            ConfigError: an endpoint cannot be listened on, is none, or does not go with the keys.
        """
        self._session, self.endpoints = session.open_server(listen, reach)
        if reach.multicast and (fault := session.multicast_fault()):
            log.warning("multicast_unavailable", reason=fault, listen=self.endpoints)  # optimizers need --connect then
        if reach.keyring is None and not self._private:
            log.warning("in_the_clear", reason="whoever reaches the port can use this server; zswarm-keys lets in members only")
        if reach.keyring is not None:
            refusals.watch_members(self._session, reach.keyring)
        refusals.watch_routers(reach.connect, reach.keyring)
        on_query = zenoh.handlers.Callback(self._on_query, indirect=False)
        self._session.declare_queryable(keys.offer(self._realm, self._server), on_query)
        self._session.declare_queryable(keys.requests(self._realm, self._server), on_query)
        self._session.liveliness().declare_subscriber(
            keys.run_alive(self._realm, "*", "*"), zenoh.handlers.Callback(self._on_run, indirect=False), history=True
        )
        if seen:
            self._token = self._session.liveliness().declare_token(keys.alive(self._realm, self._server))

    def leave(self) -> None:
        """Be seen no more; what was asked is answered."""
        if self._token is not None:
            self._token.undeclare()
            self._token = None

    def close(self, *, or_exit: bool = True) -> None:
        """Be gone."""
        if self._session is not None:
            session.close(self._session, or_exit=or_exit)
        self._session = self._token = None

    def _on_query(self, query: zenoh.Query) -> None:
        if not self._put(Question(query)):
            query.drop()

    def _on_run(self, sample: zenoh.Sample) -> None:
        try:
            user, run = keys.parse_run_key(str(sample.key_expr))
        except RemoteProtocolError:
            return
        seen = sample.kind == zenoh.SampleKind.PUT
        self._put(slots.HolderSeen(user, run) if seen else slots.HolderGone(user, run))

    # ---- answers

    def answer(self, question: Question, run: str, body: bytes) -> None:
        """Answer on the run's own thread: a send into a dying link blocks."""
        if not self._sender(run).send(lambda: question.answer(body)):
            log.warning("answer_dropped", run=run)
            question.drop()

    def _sender(self, run: str) -> session.Sender:
        if run not in self._senders:
            if len(self._senders) >= SENDERS:
                oldest = next(iter(self._senders))
                self._senders.pop(oldest).close()
            self._senders[run] = session.Sender(run)
        return self._senders[run]

    def forget(self, run: str) -> None:
        """End a run's thread, or a server would gather one for every run."""
        if (sender := self._senders.pop(run, None)) is not None:
            sender.close()

    # ---- questions

    def ask(self, run: tuple[str, str], number: int, body: bytes, take: Callable[[int, bytes], None], *, at_once: bool) -> None:
        """Ask a run's optimizer.

        Args:
            run: its user and its id.
            take: takes the number and an answer, on zenoh's threads; without one ``Unheard`` is put.
            at_once: it does not block.
        """
        answered = False

        def on_reply(reply: zenoh.Reply) -> None:
            nonlocal answered
            if reply.ok is not None and not answered:
                answered = True
                take(number, reply.ok.payload.to_bytes())

        def on_end() -> None:
            if not answered:
                self._put(Unheard(number))

        def send() -> None:
            opened = self._session
            try:
                if opened is None:  # off the network for a moment
                    raise zenoh.ZError
                opened.get(
                    keys.control(self._realm, *run, self._server),
                    zenoh.handlers.Callback(on_reply, on_end, indirect=False),
                    target=zenoh.QueryTarget.ALL,
                    consolidation=zenoh.ConsolidationMode.NONE,
                    timeout=CONTROL_S,
                    congestion_control=zenoh.CongestionControl.BLOCK,
                    priority=zenoh.Priority.INTERACTIVE_LOW,
                    express=True,
                    payload=body,
                )
            except zenoh.ZError:
                self._put(Unheard(number))

        if not self._sender("/".join(run)).send(send, at_once=at_once):
            self._put(Unheard(number))

    def finish(self, timeout_s: float) -> None:
        """Give the answers that are on their way so long."""
        for sender in self._senders.values():
            sender.close(timeout_s)
