"""The optimizer's shell around its state machine, against sessions on loopback."""

import threading
import time
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any, NoReturn

import numpy as np
import pytest
import zenoh

from tests.integration.programs import free_port
from tests.ot.cluster.dispatching import terms
from zswarm import session
from zswarm.config.sections import ClusterConfig
from zswarm.errors import EvaluationError
from zswarm.ot.cluster import links
from zswarm.ot.cluster.announced import SAME_NAME
from zswarm.ot.cluster.events import Answered, Ask, Event, Gone, Seen, Work
from zswarm.ot.cluster.remote_server import Standing
from zswarm.ot.cluster.shell import Cluster, Item
from zswarm.ot.cluster.watch import Watch
from zswarm.ot.notes import Note
from zswarm.ot.workload import Workload
from zswarm.protocol import codec, keys
from zswarm.protocol.keys import RunKey
from zswarm.protocol.messages import Cancel, Lease, Offer, Refused, Reply, Verb
from zswarm.session import Reach

KEY = RunKey("default", "ada", "run-1")


OFFER = Offer(
    server="",
    program="",
    machine="",
    capacity=1,
    free=1,
    leases=0,
    simulators=[],
    representations=[],
)
LEASE = Lease(
    lease=bytes(16), state="ready", slots=1, ready=1, probe=b"digest", trial_s=1.0
)


def no_dispute(dispute: object, _: object) -> NoReturn:
    raise AssertionError(f"one server cannot differ: {dispute}")


def wait_until(condition: Callable[[], bool], what: str) -> None:
    end = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < end, f"not within 60 s: {what}"
        time.sleep(0.01)


def test_the_sender_to_a_server_ends_with_it() -> None:
    """A restarted server is a new one: without this, a long run would accumulate senders."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    listening, _ = session.open_server([endpoint], Reach([], multicast=False))
    with Cluster(
        KEY,
        terms(slots=1),
        reach=Reach([endpoint], multicast=False),
        arbitrate=no_dispute,
    ) as cluster:
        senders = cluster._links.senders
        token = listening.liveliness().declare_token(keys.alive("default", "lab-1"))
        wait_until(lambda: "lab-1" in senders, "a server is asked")
        token.undeclare()
        wait_until(lambda: "lab-1" not in senders, "its sender ends")
    session.close(listening)


def test_an_answer_counts_when_it_comes_not_when_the_query_ends(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Zenoh also asks links that are not quite up; a stuck one must not delay other answers."""
    monkeypatch.setitem(links.QUERY_S, "offer", 3600.0)
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    listening, _ = session.open_server([endpoint], Reach([], multicast=False))
    offer = Offer(
        server="lab-1",
        program="",
        machine="",
        capacity=1,
        free=1,
        leases=0,
        simulators=["none"],
        representations=["none"],
    )
    asked: list[zenoh.Query] = []  # and never dropped: no query ends

    def on_query(query: zenoh.Query) -> None:
        asked.append(query)
        if len(asked) == 1:
            query.reply(query.key_expr, codec.encode(offer))

    callback = zenoh.handlers.Callback(on_query, indirect=False)
    listening.declare_queryable(keys.offer("default", "lab-1"), callback)
    listening.declare_queryable(keys.requests("default", "lab-1"), callback)
    token = listening.liveliness().declare_token(keys.alive("default", "lab-1"))
    with Cluster(
        KEY,
        terms(slots=1),
        reach=Reach([endpoint], multicast=False),
        arbitrate=no_dispute,
    ):
        wait_until(
            lambda: any(str(query.key_expr).endswith("/reserve") for query in asked),
            "the server is reserved",
        )
        for query in asked:
            query.drop()
    token.undeclare()
    session.close(listening)


# ---- batches that go in the thread that decides


def interrupted(*_: object, **__: object) -> None:
    raise KeyboardInterrupt


class Asking:
    """A cluster whose sessions send nothing, and who was asked by which thread."""

    def __init__(self, *, through_router: bool = False, taken_over: bool = False) -> None:
        self.cluster = Cluster(
            KEY,
            terms(slots=2),
            reach=Reach(
                ["tcp/127.0.0.1:1"], multicast=False, through_router=through_router
            ),
            arbitrate=no_dispute,
            taken_over=lambda: taken_over,
        )
        self.batches: list[tuple[str, str]] = []  # server and thread
        self._here = threading.current_thread()

    def get(self, key: str, *_: object, **__: object) -> None:
        """Record the thread that sends a batch, in place of a session's ``get``."""
        server, verb = key.split("/")[4], key.split("/")[-1]
        if verb == "evaluate":
            thread = threading.current_thread()
            self.batches.append(
                (server, "this one" if thread is self._here else thread.name)
            )

    def feed(self, event: Event) -> None:
        self.cluster._happened(event, may_block=True)

    def join(self, server: str) -> None:
        self.cluster._links.home[server] = self  # type: ignore[assignment]
        self.feed(Seen(server))
        self.answer(server, "offer", OFFER)
        self.answer(server, "reserve", LEASE)

    def answer(self, server: str, verb: Verb, reply: Reply | None) -> None:
        queries = self.cluster._dispatch.out.queries.items()
        (number,) = [
            number
            for number, query in queries
            if (query.server, query.verb) == (server, verb)
        ]
        self.feed(Answered(number, reply))

    def idle(self) -> None:
        senders = self.cluster._links.senders.values()
        wait_until(
            lambda: not any(sender.busy for sender in senders),
            "nothing is on the way",
        )

    def work(self, trials: int) -> None:
        """Until its batches, one for each trial, are on the way."""
        self.idle()
        already = len(self.batches)
        self.feed(
            Work(
                Workload(
                    [b"g"], np.zeros((trials, 1), int), np.zeros(trials, np.uint64), 0
                )
            )
        )
        wait_until(lambda: len(self.batches) == already + trials, "batches are sent")

    def ctrl_c(self) -> Iterator[Item | None]:
        """Asked for work, but for Ctrl-C while it is sent."""
        self.get = interrupted  # type: ignore[method-assign]
        return self.cluster.evaluate(
            Workload([b"g"], np.zeros((1, 1), int), np.zeros(1, np.uint64), 0)
        )

    def close(self) -> None:
        for sender in self.cluster._links.senders.values():
            sender.wait(60.0)


@pytest.mark.parametrize(
    ("through_router", "second"), [(False, "this one"), (True, "send")]
)
def test_a_batch_is_sent_at_once_if_its_link_has_no_unanswered_batch(
    through_router: bool, second: str
) -> None:
    """Behind a router, all servers share a link, on which a large batch may wait."""
    asking = Asking(through_router=through_router)
    asking.join("lab-1")
    asking.join("lab-2")
    asking.work(2)
    assert sorted(asking.batches) == [("lab-1", "this one"), ("lab-2", second)]
    asking.close()


def test_a_batch_waits_for_another_thread_while_one_is_unanswered() -> None:
    asking = Asking()
    asking.join("lab-1")
    asking.work(2)
    assert asking.batches == [("lab-1", "this one"), ("lab-1", "send")]
    asking.close()


def test_a_server_that_returned_owes_no_answers_and_has_no_batches() -> None:
    asking = Asking()
    asking.join("lab-1")
    asking.work(1)
    asking.work(0)  # what is out is cancelled
    asking.feed(Gone("lab-1"))
    asking.answer("lab-1", "evaluate", None)
    asking.join("lab-1")
    asking.batches.clear()
    asking.work(2)
    assert asking.batches == [("lab-1", "this one"), ("lab-1", "send")]
    asking.close()


def test_ctrl_c_during_a_submission_is_raised_at_once_and_releases_the_lock() -> None:
    asking = Asking()
    asking.join("lab-1")
    asking.idle()
    with pytest.raises(KeyboardInterrupt):
        asking.ctrl_c()
    assert not asking.cluster._owner.locked()
    asking.close()


def test_a_query_that_zenoh_panics_at_is_noted_and_asked_again() -> None:
    asking = Asking()
    asking.join("lab-1")
    asking.idle()
    get = asking.get

    def panic(*_: object, **__: object) -> None:
        asking.get = get  # type: ignore[method-assign]
        raise SystemError("a panic")

    asking.get = panic  # type: ignore[method-assign]
    asking.cluster._links.ask(
        Ask(99, "lab-1", Cancel(lease=bytes(16), batches=[])), may_block=False
    )
    asking.idle()
    assert asking.cluster._inbox.get(timeout=60) == Answered(99, None)
    assert "sending to lab-1 failed: SystemError('a panic')" in [
        item.text for item in asking.cluster.rest() if isinstance(item, Note)
    ]
    asking.work(1)
    assert asking.batches
    asking.close()


def test_a_batch_that_cannot_be_sent_at_once_is_noted_and_asked_for_again() -> None:
    """This is the caller's thread: it would raise there, and end the run."""
    asking = Asking()
    asking.join("lab-1")
    asking.idle()
    get, panics = asking.get, [True]

    def panic(*arguments: object, **options: object) -> None:
        asking.get = get  # type: ignore[method-assign]
        panics.pop()
        raise SystemError("a panic")

    asking.get = panic  # type: ignore[method-assign]
    work = Workload([b"g"], np.zeros((1, 1), int), np.zeros(1, np.uint64), 0)
    asking.feed(Work(work))
    answer = asking.cluster._inbox.get(timeout=60)
    assert isinstance(answer, Answered)
    assert answer.reply is None
    texts = [item.text for item in asking.cluster.rest() if isinstance(item, Note)]
    assert "sending to lab-1 failed: SystemError('a panic')" in texts
    assert not panics
    asking.close()


def test_a_query_to_a_server_without_a_session_ends_and_is_noted() -> None:
    asking = Asking()
    asking.join("lab-1")
    asking.idle()
    del asking.cluster._links.home["lab-1"]
    cancel = Cancel(lease=bytes(16), batches=[])
    asking.cluster._links.ask(Ask(99, "lab-1", cancel), may_block=False)
    asking.idle()
    assert asking.cluster._inbox.get(timeout=60) == Answered(99, None)
    texts = [item.text for item in asking.cluster.rest() if isinstance(item, Note)]
    assert "sending to lab-1 failed: KeyError('lab-1')" in texts
    asking.close()


def test_a_server_for_which_no_thread_can_be_started_is_noted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asking = Asking()
    asking.cluster._links.home["lab-1"] = asking  # type: ignore[assignment]

    def fails(*_: object) -> None:
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(links, "Sender", fails)
    asking.feed(Seen("lab-1"))
    answer = asking.cluster._inbox.get(timeout=60)
    assert isinstance(answer, Answered)
    assert answer.reply is None
    (note,) = [item for item in asking.cluster.rest() if isinstance(item, Note)]
    assert note.text.startswith("sending to lab-1 failed: RuntimeError")


# ---- whom to believe


@pytest.mark.parametrize("taken_over", [True, False])
def test_a_run_ends_as_taken_over_only_if_its_record_shows_it(taken_over: bool) -> None:
    asking = Asking(taken_over=taken_over)
    asking.cluster._links.home["lab-1"] = asking  # type: ignore[assignment]
    asking.feed(Seen("lab-1"))
    asking.answer("lab-1", "offer", OFFER)
    asking.answer("lab-1", "reserve", Refused(code="superseded", reason="taken over"))
    if taken_over:
        with pytest.raises(EvaluationError, match="lab-1: taken over"):
            list(asking.cluster.rest())
    else:
        notes = list(asking.cluster.rest())
        assert Note("server_refused", "lab-1", "taken over", machine="lab-1") in notes
    asking.close()


def test_a_stranger_cannot_take_the_name_of_this_machines_server() -> None:
    """Its token comes on another session than the one to the child."""
    run, strangers = Asking(), Asking()
    posted: list[object] = []
    run.cluster._links.post = posted.append
    key = keys.alive("default", "local-01234567")
    put = SimpleNamespace(kind=zenoh.SampleKind.PUT, key_expr=key)
    gone = SimpleNamespace(kind=zenoh.SampleKind.DELETE, key_expr=key)
    tokens = run.cluster._links._on_token
    tokens(run, True, put)  # type: ignore[arg-type]
    tokens(strangers, False, put)  # type: ignore[arg-type]
    tokens(strangers, False, gone)  # type: ignore[arg-type]
    assert posted == [Seen("local-01234567", own=True)]
    assert run.cluster._links.home == {"local-01234567": run}
    tokens(
        strangers, False, SimpleNamespace(kind=put.kind, key_expr=key[:-7] + "8/alive")
    )  # type: ignore[arg-type]
    assert posted[1:] == [Seen("local-01234568")]


def test_this_machines_server_is_used_however_many_take_a_name_like_its_own() -> None:
    run, strangers = Asking(), Asking()
    posted: list[object] = []
    run.cluster._links.post = posted.append
    put = zenoh.SampleKind.PUT
    for number in range(SAME_NAME + 1):
        key = keys.alive("default", f"local-{number:08x}")
        sample: Any = SimpleNamespace(kind=put, key_expr=key)
        run.cluster._links._on_token(strangers, False, sample)  # type: ignore[arg-type]
    key = keys.alive("default", "local-01234567")
    sample = SimpleNamespace(kind=put, key_expr=key)
    run.cluster._links._on_token(run, True, sample)  # type: ignore[arg-type]
    assert posted[-1] == Seen("local-01234567", own=True)


def test_this_machines_server_is_known_as_such_and_not_held_back() -> None:
    asking, seen = Asking(), Seen("local-01234567", own=True)
    asking.cluster._post(seen)
    assert asking.cluster._take() == [seen]


def test_only_this_machines_own_slots_end_a_run_by_their_refusal() -> None:
    def watch() -> Watch:
        options, none = ClusterConfig(), threading.Event()
        local: Any = SimpleNamespace(ended=lambda: "", start_again=lambda: "")
        said = {"say": lambda _: None, "wait": lambda _: None, "check": lambda: None}
        return Watch(options, "xor", local, none, **said)

    standing = Standing(own=frozenset({"local-01234567"}))
    for event in ("refused", "mismatch", "banned", "unprepared"):
        event = f"server_{event}"
        watch().report(Note(event, "local-00000000", "you lose"), standing)
        with pytest.raises(EvaluationError, match="it does not fit"):
            watch().report(Note(event, "local-01234567", "it does not fit"), standing)
    served = watch()
    served.report(None, Standing(serving=1, own=frozenset({"local-01234567"})))
    served.report(Note("server_unprepared", "local-01234567", "disk full"), standing)


def test_this_machines_server_is_known_as_such_when_it_is_started_again() -> None:
    asking, put, delete = Asking(), zenoh.SampleKind.PUT, zenoh.SampleKind.DELETE
    own, strangers = object(), object()
    links_ = asking.cluster._links
    tokens = [(put, 1), (put, 2), (delete, 1)]  # in any order
    for kind, number in tokens:
        key = keys.alive("default", f"local-{number:08x}")
        sample: Any = SimpleNamespace(kind=kind, key_expr=key)
        links_._on_token(own, True, sample)  # type: ignore[arg-type]
        links_._on_token(strangers, False, sample)  # type: ignore[arg-type]
    assert links_.own == {"local-00000001", "local-00000002"}
    assert set(links_.home.values()) == {own}
    servers = asking.cluster._dispatch.servers
    for number in (1, 2):
        servers.seen(f"local-{number:08x}", own=True)
    assert servers.standing().own == links_.own
    links_.forget("local-00000001")
    assert list(links_.home) == ["local-00000002"]


def test_300_tokens_of_a_name_make_sixteen_servers_and_one_note() -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    opened, _ = session.open_server([endpoint], Reach((), multicast=False))
    posted: list[Event | Note] = []
    watching = links.Links(
        KEY,
        Reach([endpoint], multicast=False),
        None,
        post=posted.append,
        answered=posted.append,
        failed=posted.append,
        slots=lambda _: 1,
    )
    try:
        tokens = [
            opened.liveliness().declare_token(keys.alive("default", f"lab-02-{at:08x}"))
            for at in range(300)
        ]
        last = opened.liveliness().declare_token(keys.alive("default", "lab-99-0"))
        watching.open("")
        # Tokens that were there before come in any order.
        wait_until(
            lambda: (
                Seen("lab-99-0") in posted
                and any(isinstance(item, Note) for item in posted)
            ),
            "all tokens are seen",
        )
        seen = [item for item in posted if isinstance(item, Seen)]
        (note,) = [item for item in posted if isinstance(item, Note)]
        assert len(seen) == 16 + 1
        assert len(watching.home) == 16 + 1
        assert "16 servers named lab-02 are used already" in note.text
        for token in (*tokens, last):
            token.undeclare()
        wait_until(lambda: not watching._announced._by_name, "no token is left")
    finally:
        watching.close()
        session.close(opened)


@pytest.mark.parametrize("host", ["127.0.0.1", "127.0.0.2"])
def test_a_server_that_answers_is_known_by_the_address_of_its_link(host: str) -> None:
    endpoint = f"tcp/{host}:{free_port()}"
    opened, _ = session.open_server([endpoint], Reach((), multicast=False))
    posted: list[Event | Note] = []
    watching = links.Links(
        KEY,
        Reach([endpoint], multicast=False),
        None,
        post=posted.append,
        answered=posted.append,
        failed=posted.append,
        slots=lambda _: 1,
    )

    def answer(query: zenoh.Query) -> None:
        with query:
            query.reply(query.key_expr, codec.encode(OFFER))

    try:
        key = keys.offer("default", "lab-02-0123abcd")
        opened.declare_queryable(key, zenoh.handlers.Callback(answer, indirect=False))
        token = opened.liveliness().declare_token(
            keys.alive("default", "lab-02-0123abcd")
        )
        watching.open("")
        wait_until(lambda: Seen("lab-02-0123abcd") in posted, "the server is seen")

        def machines() -> list[str]:
            answers = [item for item in posted if isinstance(item, Answered)]
            return [item.machine for item in answers if item.reply is not None]

        def asked() -> bool:
            ask = Ask(len(posted), "lab-02-0123abcd", terms().requirements)
            watching.ask(ask, may_block=True)
            return bool(machines())

        wait_until(asked, "it answered")
        assert machines()[0] == host
        token.undeclare()
    finally:
        watching.close()
        session.close(opened)
