"""What an event costs does not grow with the servers of a run: few of them are looked at."""

from collections import Counter
from collections.abc import Callable
from typing import Any

import pytest

from tests.ot.cluster.dispatching import Optimizer, lease, offer, outcomes
from zswarm.ot.cluster import servers as table
from zswarm.ot.cluster.events import Ask, Seen, TimePassed
from zswarm.ot.cluster.remote_server import RemoteServer
from zswarm.ot.cluster.servers import RENEW_S
from zswarm.protocol.messages import Evaluate, Renew

MANY, EVENTS, SLOTS, TRIALS = 150, 60, 4, 8


class Looked(RemoteServer):
    """A server that counts who looks at it."""

    def __getattribute__(self, name: str) -> Any:
        LOOKED[super().__getattribute__("id")] += 1
        return super().__getattribute__(name)


LOOKED: Counter[str] = Counter()


class Lab(Optimizer):
    """A run with many servers, each with batches, and more trials that wait."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, **options: Any) -> None:
        monkeypatch.setattr(table, "RemoteServer", Looked)
        super().__init__(slots=60_000, **options)
        for number in range(MANY):
            self.join(f"s{number}", slots=SLOTS)
            self.now += RENEW_S / MANY
        self.batches = [
            ask
            for ask in self.work(MANY * SLOTS * TRIALS)
            if isinstance(ask.message, Evaluate)
        ]
        self.joined = MANY

    def visits(self, event: Callable[["Lab"], None]) -> list[int]:
        """Let something happen repeatedly; return how many servers are looked at each time."""
        counts = []
        for _ in range(EVENTS):
            LOOKED.clear()
            event(self)
            counts.append(len(LOOKED))
        return counts

    def one_joins(self) -> None:
        self.joined += 1
        self.join(f"s{self.joined}", slots=SLOTS)

    def one_answers(self) -> None:
        ask = self.batches.pop(0)
        new = self.answer(ask, outcomes(ask))
        self.batches += [one for one in new if isinstance(one.message, Evaluate)]

    def one_renews(self) -> None:
        self.now = max(self.now, self.dispatch.servers.next_time())
        for ask in self.feed(TimePassed()):
            if isinstance(ask.message, Renew):
                self.answer(ask, lease(ask.server, SLOTS))

    def one_is_found(self) -> None:
        self.joined += 1
        (ask,) = self.feed(Seen(f"s{self.joined}"))
        self.answer(ask, offer(SLOTS, "another version"))

    def time_passes(self) -> None:
        self.feed(TimePassed())
        self.dispatch.next_time()
        self.dispatch.servers.standing()


@pytest.mark.parametrize("verify", [0.0, 0.1])
@pytest.mark.parametrize(
    "event",
    [Lab.one_joins, Lab.one_answers, Lab.one_renews, Lab.one_is_found, Lab.time_passes],
)
def test_an_event_looks_at_few_servers(
    event: Callable[[Lab], None], verify: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All of them are looked at now and then, when an estimate is outdated."""
    lab = Lab(monkeypatch, verify=verify)
    for _ in range(5):
        lab.one_answers()
    counts = sorted(lab.visits(event))
    assert counts[len(counts) // 2] <= 3
    assert sum(counts) <= 2 * MANY + 3 * EVENTS, counts


def test_servers_that_are_idle_while_checks_are_few_are_not_all_looked_at(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """At the end of a workload, where each answer brings a trial to verify."""
    lab = Lab(monkeypatch, verify=1.0)
    while lab.dispatch.batches.queue.count:
        lab.one_answers()
    for _ in range(MANY):
        lab.one_answers()
    counts = sorted(lab.visits(Lab.one_answers))
    assert counts[len(counts) // 2] <= 4, counts


def test_the_last_question_is_of_the_server_that_joined(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It does get work, though nobody else is looked at."""
    lab = Lab(monkeypatch)
    lab.one_joins()
    asks = [one for one in lab.commands if isinstance(one, Ask)]
    assert {ask.server for ask in asks} == {f"s{lab.joined}"}
    assert any(isinstance(ask.message, Evaluate) for ask in asks)
