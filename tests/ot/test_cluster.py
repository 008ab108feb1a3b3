"""The optimizer's shell around its state machine, against sessions on loopback."""

import socket
import threading
import time
from collections.abc import Callable

import pytest
import zenoh

from zswarm import session
from zswarm.ot import cluster
from zswarm.ot.cluster import Cluster
from zswarm.ot.requests import Wanted, Who
from zswarm.protocol import codec, keys
from zswarm.protocol.messages import Offer, Part
from zswarm.session import Reach

WANTED = Wanted(
    Part("none", {}), Part("none", {}), "", 1, 0, 60.0, trial_memory_mb=0, slots=1, quarantine=False, verify=0.0, probe=b""
)
WHO = Who("default", "ada", "run-1", 0, bytes(16))


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def wait_until(condition: Callable[[], bool], what: str) -> None:
    end = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < end, f"not within 60 s: {what}"
        time.sleep(0.01)


def sending_to(server: str) -> bool:
    return any(thread.name == f"send-{server}" for thread in threading.enumerate())


def test_the_sender_to_a_server_ends_with_it() -> None:
    """A server that starts anew is another one: without this, a long run would gather threads."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    listening, _ = session.open_server([endpoint], Reach([], multicast=False))
    with Cluster(WHO, WANTED, reach=Reach([endpoint], multicast=False)):
        token = listening.liveliness().declare_token(keys.alive("default", "lab-1"))
        wait_until(lambda: sending_to("lab-1"), "a server is asked")
        token.undeclare()
        wait_until(lambda: not sending_to("lab-1"), "its sender ends")
    session.close(listening)


def test_an_answer_counts_when_it_comes_not_when_the_query_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    """Zenoh asks links too whose declarations it does not know yet; one that is stuck must not hold up the answers of others."""
    monkeypatch.setitem(cluster.QUERY_S, "offer", 3600.0)
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    listening, _ = session.open_server([endpoint], Reach([], multicast=False))
    offer = Offer(
        server="lab-1", program="", machine="", capacity=1, free=1, leases=0, simulators=["none"], representations=["none"]
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
    with Cluster(WHO, WANTED, reach=Reach([endpoint], multicast=False)):
        wait_until(lambda: any(str(query.key_expr).endswith("/reserve") for query in asked), "the server is reserved")
        for query in asked:
            query.drop()
    token.undeclare()
    session.close(listening)
