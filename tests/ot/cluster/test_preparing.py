"""What a user knows of servers that prepare their first slot."""

import threading

import pytest

from tests.ot.cluster.dispatching import Optimizer, lease, offer
from zswarm.config.sections import ClusterConfig
from zswarm.ot.cluster import watch
from zswarm.ot.cluster.events import Seen
from zswarm.ot.cluster.watch import Watch


class User:
    """A user who reads what is said about a run."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(watch, "PREPARING_S", -1.0)
        self.lines: list[str] = []
        self.optimizer = Optimizer()
        options, hinted = ClusterConfig(), threading.Event()
        self._watch = Watch(
            *(options, "stage", None, hinted), self.lines.append, lambda: None
        )
        (ask,) = self.optimizer.feed(Seen("a"))
        (self._ask,) = self.optimizer.answer(ask, offer(4))

    def reads(self, ready: int = 0, **progress: int) -> list[str]:
        """Let the server report something; return what is said then."""
        self.lines.clear()
        state = "ready" if ready else "preparing"
        reply = lease("a", ready, state=state, slots=4, **progress)
        asks = self.optimizer.answer(self._ask, reply)
        self._ask = asks[-1] if asks else self._ask
        for _ in range(3):
            self._watch.report(None, self.optimizer.dispatch.servers.standing())
        return self.lines


def test_a_user_knows_what_servers_do_that_prepare(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    user = User(monkeypatch)
    assert user.reads() == ["a: getting stage ready"]
    once = "once for each version of zswarm"
    assert user.reads(compiling=14) == [f"a: compiling 14 kernels, {once}"]
    assert user.reads(compiling=1) == [f"a: compiling 1 kernel, {once}"]
    assert user.reads(probe_begun=3, probe_trials=8) == ["a: plays trial 3 of 8 of stage"]
    assert user.reads(probe_begun=3, probe_trials=8) == [], "it is said already"
    assert user.reads(probe_begun=1, probe_trials=1) == ["a: plays one trial of stage"]
    assert user.reads() == [], "nothing is known any more"
    assert user.reads(ready=4) == []
