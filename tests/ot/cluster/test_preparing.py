"""What a user knows of servers that prepare their first slot."""

import re
import threading

import pytest

from tests.ot.cluster.dispatching import Optimizer, lease, offer
from zswarm.config.sections import ClusterConfig
from zswarm.ot.cluster import watch
from zswarm.ot.cluster.events import Seen, TimePassed
from zswarm.ot.cluster.remote_server import AGAIN_S, PROGRESS_S
from zswarm.ot.cluster.watch import Watch


class User:
    """A user who reads what is said about a run."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(watch, "PREPARING_S", -1.0)
        self.lines: list[str] = []
        self.optimizer = Optimizer()
        options, hinted = ClusterConfig(), threading.Event()
        self._watch = Watch(
            *(options, "stage", None, hinted),
            say=self.lines.append,
            wait=lambda line: self.lines.append(re.sub(r" \([0-9]+ s\)$", "", line)),
            check=lambda: None,
        )
        (ask,) = self.optimizer.feed(Seen("a"))
        (self._ask,) = self.optimizer.answer(ask, offer(4))

    def reads(self, ready: int = 0, **progress: int) -> list[str]:
        """Let the server report something; return what is said then."""
        self.lines.clear()
        state = "ready" if ready else "preparing"
        reply = lease("a", ready, state=state, slots=4, **progress)
        asks = self.optimizer.answer(self._ask, reply)
        if not asks and not ready:
            self.optimizer.now += AGAIN_S
            asks = self.optimizer.feed(TimePassed())
        self._ask = asks[-1] if asks else self._ask
        for _ in range(3):
            self._watch.report(None, self.optimizer.dispatch.servers.standing())
        return self.lines


def test_a_server_that_prepares_is_asked_again_at_most_twice_a_second() -> None:
    """Also one that says at once that it got on; the first time tells how long to wait."""
    optimizer = Optimizer()
    (ask,) = optimizer.feed(Seen("a"))
    (ask,) = optimizer.answer(ask, offer(4))

    def reports(**progress: int) -> float:
        """Return after how long the server is asked again."""
        nonlocal ask
        begun = optimizer.now
        reply = lease("a", 0, state="preparing", slots=4, **progress)
        asks = optimizer.answer(ask, reply)
        while not asks:
            optimizer.now = optimizer.dispatch.next_time()
            asks = optimizer.feed(TimePassed())
        (ask,) = asks
        return optimizer.now - begun

    assert reports() == 0.0, "it answered to reserve"
    assert reports(compiling=14, kernels=14) == 0.0
    assert reports(compiling=13, kernels=14) == PROGRESS_S
    assert reports(compiling=13, kernels=14) == AGAIN_S


def test_a_user_knows_what_servers_do_that_prepare(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    user = User(monkeypatch)
    assert user.reads() == ["a: getting stage ready"]
    for missing, number in ((14, 1), (13, 2), (1, 14)):
        said = user.reads(compiling=missing, kernels=14)
        assert said == [f"a: compiling kernel {number} of 14, once"]
    assert user.reads(probe_begun=3, probe_trials=8) == ["a: plays trial 3 of 8 of stage"]
    assert user.reads(probe_begun=3, probe_trials=8) == [], "it is said already"
    assert user.reads(probe_begun=1, probe_trials=1) == ["a: plays one trial of stage"]
    assert user.reads() == [], "nothing is known any more"
    assert user.reads(ready=4) == []


def test_a_user_knows_that_servers_compute_without_an_outcome(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    user = User(monkeypatch)
    assert user.reads(ready=4) == []
    monkeypatch.setattr(watch, "QUIET_S", -1.0)
    assert user.reads(ready=4) == ["no outcome from 4 slots yet"]
