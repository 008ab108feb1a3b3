"""Servers that answer nothing, nonsense, or "running" for ever: no run hangs or ends by them."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from tests.ot.cluster.dispatching import (
    Optimizer,
    batch,
    lease,
    offer,
    outcomes,
    trials,
    verbs,
)
from zswarm.errors import LocalProtocolError
from zswarm.ot.cluster.batches import Batches
from zswarm.ot.cluster.events import MARGIN_S, QUERY_S, Ask, Complete, Failed, Seen
from zswarm.ot.cluster.recovery import PATIENCE_S, PATIENCE_TRIALS
from zswarm.ot.cluster.remote_server import AGAIN_S, SETBACKS_S
from zswarm.ot.cluster.schedule import Schedule
from zswarm.ot.cluster.servers import PAUSE_S, RETRY_S, Servers
from zswarm.protocol.messages import Evaluate, Lease, Refused, Reply, Running, verb

TIMEOUT_S = 60.0  # of a trial, in these terms


def evaluates(asks: list[Ask]) -> list[Ask]:
    return [ask for ask in asks if isinstance(ask.message, Evaluate)]


# ---- questions that never end


@pytest.mark.parametrize("query", ["offer", "reserve", "renew"])
def test_a_question_that_never_ends_is_asked_again(query: str) -> None:
    optimizer = Optimizer()
    (ask,) = optimizer.feed(Seen("a"))
    if query != "offer":
        (ask,) = optimizer.answer(ask, offer(4))
    if query == "renew":
        (ask,) = optimizer.answer(ask, lease("a", 1, state="ready", slots=4))
    assert verb(ask.message) == query
    assert optimizer.dispatch.next_time() <= optimizer.now + QUERY_S[query] + MARGIN_S
    again = optimizer.wait(QUERY_S[query] + MARGIN_S + RETRY_S[0])
    assert verbs(again)[-1] == ("a", query)


def renewing(optimizer: Optimizer, seconds: float) -> list[Ask]:
    """Let time pass while all leases are renewed; return the batches that were asked for."""
    asks: list[Ask] = []
    for _ in range(int(seconds)):
        for ask in optimizer.wait(1.0):
            if verb(ask.message) == "renew":
                slots = optimizer.dispatch.servers.by_id[ask.server].slots
                asks += optimizer.answer(ask, lease(ask.server, slots))
            asks.append(ask)
    return evaluates(asks)


def test_a_batch_whose_question_never_ends_is_asked_for_again_then_moves() -> None:
    optimizer = Optimizer()
    optimizer.join("a")
    (ask,) = optimizer.work(1)
    limit_s = QUERY_S["evaluate"] + MARGIN_S
    late = [ask, *renewing(optimizer, len(RETRY_S) * (limit_s + 1.0))]
    assert {batch(one) for one in late} == {batch(ask)}
    assert len(late) == len(RETRY_S) + 1
    optimizer.join("b")
    moved = renewing(optimizer, limit_s)
    assert [(one.server, trials([one])) for one in moved] == [("b", [0])]
    optimizer.answer(moved[0], outcomes(moved[0]))
    for one in late:
        optimizer.answer(one, outcomes(one))
    assert optimizer.counted == [0], "late answers count nothing"


def test_a_late_answer_to_a_question_that_was_asked_again_is_harmless() -> None:
    optimizer = Optimizer()
    optimizer.join("a")
    (ask,) = optimizer.work(1)
    again = evaluates(optimizer.wait(QUERY_S["evaluate"] + MARGIN_S + RETRY_S[0]))[-1]
    assert optimizer.answer(ask, outcomes(ask)) == []
    optimizer.answer(again, outcomes(again))
    assert optimizer.counted == [0]


def test_answered_questions_leave_nothing_behind() -> None:
    optimizer = Optimizer()
    optimizer.join("a")
    for _ in range(50):
        for ask in evaluates(optimizer.work(1)):
            optimizer.answer(ask, outcomes(ask))
    optimizer.dispatch.next_time()
    assert len(optimizer.dispatch.out.queries) <= 1
    assert len(optimizer.dispatch.out._deadlines) <= 1


# ---- running for ever


def runs(optimizer: Optimizer, until: Callable[[], bool], server: str = "liar") -> int:
    """Answer that server's batches with "running" at once; return how often it was asked."""
    asked, slots = 0, optimizer.dispatch.servers.by_id[server].slots
    asks = [optimizer.asked[server, "evaluate"]]
    for _ in range(10_000):
        for ask in asks:
            if isinstance(ask.message, Evaluate):
                asked += 1
                running = Running(batch=batch(ask), done=0, given=True)
                optimizer.answer(ask, running)
            elif verb(ask.message) == "renew":
                optimizer.answer(ask, lease(server, slots))
            if until():
                return asked
        asks = optimizer.wait(AGAIN_S)
    raise AssertionError("it never ends")


def put_aside(optimizer: Optimizer) -> bool:
    return bool(optimizer.notes("server_stalled"))


def test_a_batch_that_runs_without_outcomes_for_too_long_is_given_to_others() -> None:
    """A liar is asked about once a second, and is not used for a while."""
    optimizer = Optimizer()
    optimizer.join("liar", slots=2)
    optimizer.work(2)
    begun = optimizer.now
    asked = runs(optimizer, lambda: put_aside(optimizer))
    assert ("liar", "release") in optimizer.asked
    patience_s = (2 + PATIENCE_TRIALS) * TIMEOUT_S + PATIENCE_S
    assert patience_s <= optimizer.now - begun <= patience_s + 2 * AGAIN_S
    assert asked <= 2 * (patience_s / AGAIN_S + 2)
    optimizer.join("honest", slots=2)
    moved = [optimizer.asked["honest", "evaluate"]]
    assert trials(moved) == [0, 1]
    optimizer.answer(moved[0], outcomes(moved[0]))
    assert any(isinstance(command, Complete) for command in optimizer.commands)


def test_outcomes_that_are_new_give_a_server_more_time() -> None:
    optimizer = Optimizer()
    optimizer.join("a", slots=2)
    (ask,) = evaluates(optimizer.work(2))
    sent = optimizer.dispatch.servers.by_id["a"].batches[batch(ask)]
    optimizer.now += 30.0
    first, fitness = np.array([0], "<u4").tobytes(), np.array([0.0]).tobytes()
    told = Running(batch=batch(ask), done=1, trials=first, fitness=fitness)
    optimizer.answer(ask, told)
    patience_s = (1 + PATIENCE_TRIALS) * TIMEOUT_S + PATIENCE_S
    assert sent.give_up_at == optimizer.now + patience_s


def test_the_same_outcomes_again_are_no_progress() -> None:
    optimizer = Optimizer()
    optimizer.join("a", slots=2)
    (ask,) = evaluates(optimizer.work(2))
    first = np.array([0], "<u4").tobytes()
    fitness = np.array([0.0]).tobytes()
    told = Running(batch=batch(ask), done=1, trials=first, fitness=fitness, seconds=1.0)
    asks = evaluates(optimizer.answer(ask, told))
    assert [one.server for one in asks] == ["a"], "at once: there may be more"
    assert evaluates(optimizer.answer(asks[0], told)) == []
    assert len(evaluates(optimizer.wait(AGAIN_S))) == 1


def test_an_honest_server_is_asked_at_once_when_it_held_the_question() -> None:
    optimizer = Optimizer()
    optimizer.join("a")
    (ask,) = optimizer.work(1)
    optimizer.now += 30.0
    (again,) = optimizer.answer(ask, Running(batch=batch(ask), done=0))
    assert batch(again) == batch(ask)


def test_what_is_behind_other_batches_is_waited_for_longer() -> None:
    """An honest server may need the whole time for each of the trials that it got before."""
    optimizer = Optimizer()
    optimizer.join("a", slots=2)
    asks = evaluates(optimizer.work(40))
    batches = [optimizer.dispatch.servers.by_id["a"].batches[batch(ask)] for ask in asks]
    times = [one.give_up_at - optimizer.now for one in batches]
    sizes = [len(one.trials) for one in batches]
    assert times == [
        (sum(sizes[: at + 1]) + PATIENCE_TRIALS) * TIMEOUT_S + PATIENCE_S
        for at in range(len(sizes))
    ]


def test_pauses_of_a_server_that_computes_nothing_grow_until_it_does() -> None:
    optimizer = Optimizer()
    optimizer.join("liar")
    optimizer.work(1)
    pauses = []
    for _ in range(3):
        runs(optimizer, lambda: put_aside(optimizer))
        pauses += [note.count for note in optimizer.notes("server_stalled")]
        optimizer.commands = []
        optimizer.asked.clear()
        optimizer.wait(pauses[-1] + 1.0)
        ask = optimizer.asked["liar", "offer"]
        (ask,) = optimizer.answer(ask, offer())
        optimizer.answer(ask, lease("liar", 1))
    assert pauses == list(SETBACKS_S[:3])
    ask = optimizer.asked["liar", "evaluate"]
    optimizer.answer(ask, outcomes(ask))
    assert optimizer.dispatch.servers.by_id["liar"].setbacks == 0


# ---- loops without delay


@pytest.mark.parametrize("code", ["cancelled", "no-such-code", "busy"])
def test_a_server_that_refuses_all_batches_is_asked_once_a_second(code: str) -> None:
    optimizer = Optimizer()
    optimizer.join("a")
    asks, asked, begun = evaluates(optimizer.work(1)), 0, optimizer.now
    for _ in range(20):
        while not asks:
            asks = evaluates(optimizer.wait(0.5))
        asked += len(asks)
        for ask in asks:
            asks = evaluates(optimizer.answer(ask, Refused(code=code, reason="")))
    assert asked <= (optimizer.now - begun) / PAUSE_S + 2


def test_a_server_that_answers_renewals_at_once_is_asked_once_a_second() -> None:
    """One that has fewer slots ready than are wanted is to hold the question."""
    optimizer = Optimizer()
    optimizer.feed(Seen("a"))
    optimizer.answer(optimizer.asked["a", "offer"], offer(4))
    asks = optimizer.answer(optimizer.asked["a", "reserve"], lease("a", 1, slots=4))
    asked, begun = 0, optimizer.now
    for flip in range(40):
        while not asks:
            asks = optimizer.wait(0.5)
        asked += len(asks)
        asks = optimizer.answer(asks[0], lease("a", 1 + flip % 2, slots=4))
    assert asked <= 2 * (optimizer.now - begun) / AGAIN_S + 3


def test_slots_that_become_ready_are_known_at_once() -> None:
    optimizer = Optimizer()
    optimizer.feed(Seen("a"))
    optimizer.answer(optimizer.asked["a", "offer"], offer(4))
    (ask,) = optimizer.answer(optimizer.asked["a", "reserve"], lease("a", 0, slots=4))
    for ready in (1, 2, 3):
        (ask,) = optimizer.answer(ask, lease("a", ready, slots=4))
        assert ask.message.known_ready == ready  # type: ignore[union-attr]


# ---- numbers


@pytest.mark.parametrize("seconds", [0.0, 1e-9, 1.0, 1e9])
@pytest.mark.parametrize("trial_s", [0.0, 1e-9, 1e9])
def test_no_time_that_a_server_may_report_ends_a_run(
    trial_s: float, seconds: float
) -> None:
    optimizer = Optimizer(65_535)
    optimizer.join("a", slots=65_000, trial_s=trial_s)
    optimizer.join("b", slots=1)
    asks = evaluates(optimizer.work(300))
    for _ in range(1000):
        if len(optimizer.counted) == 300:
            break
        asks = asks or renewing(optimizer, 1.0)
        for one in asks[:1]:
            asks += evaluates(optimizer.answer(one, outcomes(one, seconds=seconds)))
            assert not optimizer.notes("answer_failed")
        del asks[:1]
    assert sorted(optimizer.counted) == list(range(300))


def test_a_time_of_nothing_reported_thousands_of_times_is_not_divided_by() -> None:
    optimizer = Optimizer()
    optimizer.join("a")
    pace = optimizer.dispatch.servers.by_id["a"].pace
    for _ in range(10_000):
        pace.computed(0.0, 1)
    assert pace.trial_s > 0.0
    assert math.isfinite(1.0 / pace.trial_s)
    assert evaluates(optimizer.work(10))


def test_a_server_does_not_give_more_slots_than_it_was_asked_for() -> None:
    """Others would be released for it."""
    optimizer = Optimizer(slots=4)
    optimizer.join("honest", slots=2)
    optimizer.feed(Seen("liar"))
    optimizer.answer(optimizer.asked["liar", "offer"], offer(65_535))
    optimizer.answer(optimizer.asked["liar", "reserve"], lease("liar", 65_535))
    held = optimizer.dispatch.servers.roster.ready
    assert {name: server.slots for name, server in held.items()} == {
        "honest": 2,
        "liar": 2,
    }


# ---- preparations that fail


def failed(server: str, reason: str, *, passing: bool) -> Lease:
    return lease(server, 0, state="failed", reason=reason, passing=passing)


def test_a_preparation_that_failed_for_a_passing_reason_is_tried_again() -> None:
    optimizer = Optimizer()
    optimizer.work(1)
    optimizer.feed(Seen("a"))
    pauses = []
    for _ in range(len(SETBACKS_S) + 1):
        optimizer.answer(optimizer.asked["a", "offer"], offer())
        reply = failed("a", "No space left on device", passing=True)
        asks = optimizer.answer(optimizer.asked["a", "reserve"], reply)
        assert verbs(asks) == [("a", "release")]
        pauses += [note.count for note in optimizer.notes("server_unprepared")]
        assert ("a", "offer") not in verbs(optimizer.wait(pauses[-1] - 0.1))
        assert ("a", "offer") in verbs(optimizer.wait(0.2))
    assert pauses == [*SETBACKS_S, SETBACKS_S[-1]]
    optimizer.answer(optimizer.asked["a", "offer"], offer())
    (ask,) = evaluates(optimizer.answer(optimizer.asked["a", "reserve"], lease("a", 1)))
    optimizer.answer(ask, outcomes(ask))
    assert optimizer.counted == [0]


def test_a_preparation_that_cannot_succeed_is_not_tried_again() -> None:
    optimizer = Optimizer()
    optimizer.feed(Seen("a"))
    optimizer.answer(optimizer.asked["a", "offer"], offer())
    reply = failed("a", "problem.settings: unknown key", passing=False)
    optimizer.answer(optimizer.asked["a", "reserve"], reply)
    assert optimizer.notes("server_refused")
    assert ("a", "offer") not in verbs(optimizer.wait(10_000.0))


# ---- answers that cannot be handled


PLACES: list[tuple[type, str]] = [
    (Batches, "count"),
    (Batches, "fill"),
    (Schedule, "answered"),
    (Schedule, "size"),
    (Servers, "answered"),
    (Servers, "allot"),
]


@pytest.mark.parametrize(("part", "name"), PLACES)
def test_an_answer_that_cannot_be_handled_puts_its_server_aside_and_loses_nothing(
    part: type, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Wherever it fails, and what it did before: every trial is counted once in the end."""
    optimizer = Optimizer()
    optimizer.join("liar", "b", slots=2)
    asks = evaluates(optimizer.work(20))
    (mine, *_) = [ask for ask in asks if ask.server == "liar"]
    original = getattr(part, name)
    broken = [True]

    def fails(*arguments: object, **options: object) -> object:
        found = original(*arguments, **options)
        if broken:
            broken.pop()
            raise OverflowError("cannot convert float infinity to integer")
        return found

    monkeypatch.setattr(part, name, fails)
    reply: Reply = outcomes(mine)
    if part is Servers and name == "answered":
        optimizer.wait(20.0)
        mine, reply = optimizer.asked["liar", "renew"], lease("liar", 2)
    asks = [ask for ask in asks if ask is not mine]
    asks += evaluates(optimizer.answer(mine, reply))
    (note,) = optimizer.notes("answer_failed")
    assert note.server == "liar"
    assert note.text.startswith("OverflowError: cannot convert")
    asks = [ask for ask in asks if ask.server != "liar"]
    while asks:
        one = asks.pop()
        asks += evaluates(optimizer.answer(one, outcomes(one)))
    assert sorted(optimizer.counted) == list(range(20))
    assert any(isinstance(command, Complete) for command in optimizer.commands)
    assert not any(isinstance(command, Failed) for command in optimizer.commands)


def test_a_bug_of_this_program_is_not_a_servers_fault(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    optimizer = Optimizer()
    optimizer.join("a")
    (ask,) = optimizer.work(1)

    def fails(*_: object) -> None:
        raise LocalProtocolError("a trial was counted twice")

    monkeypatch.setattr(Batches, "count", fails)
    with pytest.raises(LocalProtocolError):
        optimizer.answer(ask, outcomes(ask))
