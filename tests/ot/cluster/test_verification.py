"""Who computes wrong or fails too often is found out, and its results are evaluated again."""

import numpy as np
import pytest

from tests.ot.cluster.dispatching import (
    Optimizer,
    fault,
    lease,
    offer,
    outcomes,
    trials,
    verbs,
)
from zswarm.ot.cluster.bans import FAULTY_S
from zswarm.ot.cluster.events import (
    Arbitrated,
    Ask,
    Complete,
    Disputed,
    Gone,
    ProbeArbitrated,
    ProbeDisputed,
    Retracted,
    Seen,
    Work,
)
from zswarm.ot.cluster.machines import BLAMED
from zswarm.ot.cluster.remote_server import Phase
from zswarm.ot.cluster.servers import BACK_OFF_S, PAUSE_S, RETRY_S
from zswarm.ot.workload import Workload
from zswarm.protocol.messages import Refused, verb


def pending(asks: list[Ask], server: str) -> list[Ask]:
    return [
        ask for ask in asks if ask.server == server and verb(ask.message) == "evaluate"
    ]


def arbitrate(trial: int, fitness: float) -> Arbitrated:
    return Arbitrated(trial, np.array([fitness]), np.zeros(0))


def verified_once() -> tuple[Optimizer, Ask]:
    """Servers a and b; a has counted trial 0, and the question by which b verifies it."""
    optimizer = Optimizer(verify=1.0)
    optimizer.join("a")
    (ask,) = optimizer.work(1)
    optimizer.join("b")
    (check,) = optimizer.answer(ask, outcomes(ask, 7.0))
    assert (check.server, trials([check])) == ("b", [0])
    assert Complete() not in optimizer.commands
    return optimizer, check


# ---- verification


def test_a_workload_ends_when_another_server_has_verified_its_trials() -> None:
    optimizer, check = verified_once()
    assert optimizer.answer(check, outcomes(check, 7.0)) == []
    assert optimizer.commands == [Complete()]
    assert optimizer.dispatch.batches.checks.verified == 1
    assert optimizer.counted == [0], "what is verified is not counted again"


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 1.0])
def test_the_requested_share_is_verified_and_never_by_the_server_that_counted_it(
    share: float,
) -> None:
    optimizer = Optimizer(verify=share)
    optimizer.join("a", "b", slots=4)
    open_ = optimizer.work(1000)
    counted_by: dict[int, str] = {}
    checked: list[int] = []
    while open_:
        ask = open_.pop(0)
        assert ask.trials is not None
        for trial in ask.trials.tolist():
            if trial in counted_by:
                assert counted_by[trial] != ask.server
                checked.append(trial)
        counted_by |= {
            trial: ask.server for trial in ask.trials.tolist() if trial not in counted_by
        }
        open_ += optimizer.answer(ask, outcomes(ask, seconds=0.01))
    assert Complete() in optimizer.commands
    assert len(checked) == len(set(checked)) == optimizer.dispatch.batches.checks.verified
    assert abs(len(checked) - 1000 * share) <= 50
    assert sorted(optimizer.counted) == list(range(1000))


def test_without_a_second_server_a_workload_ends_unverified_with_one_note() -> None:
    optimizer = Optimizer(verify=1.0)
    optimizer.join("a")
    for said in (1, 0):
        (ask,) = optimizer.work(1)
        optimizer.answer(ask, outcomes(ask))
        assert Complete() in optimizer.commands
        assert len(optimizer.notes("unverified")) == said


@pytest.mark.parametrize("how", ["empty", "fault"])
def test_an_impossible_check_moves_to_another_server_or_is_dropped(how: str) -> None:
    optimizer, check = verified_once()
    if how == "empty":
        optimizer.feed(Gone("b"))
        optimizer.answer(check, None)
    else:
        optimizer.answer(check, fault(check))
    assert Complete() in optimizer.commands
    assert optimizer.dispatch.batches.checks.verified == 0
    assert optimizer.counted == [0]


def test_a_check_waits_for_the_only_second_server_if_that_has_no_room_now() -> None:
    optimizer, check = verified_once()
    optimizer.answer(check, Refused(code="busy", reason=""))
    assert Complete() not in optimizer.commands
    (again,) = pending(optimizer.wait(PAUSE_S), "b")
    optimizer.answer(again, outcomes(again, 7.0))
    assert Complete() in optimizer.commands
    assert optimizer.dispatch.batches.checks.verified == 1


def test_a_check_moves_to_the_third_server_when_the_second_is_gone() -> None:
    optimizer, check = verified_once()
    optimizer.join("c")
    optimizer.feed(Gone("b"))
    (again,) = optimizer.answer(check, None)
    assert (again.server, trials([again])) == ("c", [0])
    optimizer.answer(again, outcomes(again, 7.0))
    assert Complete() in optimizer.commands


def test_one_wrong_bit_causes_a_dispute() -> None:
    optimizer, check = verified_once()
    assert optimizer.answer(check, outcomes(check, float(np.nextafter(7.0, 8.0)))) == []
    assert optimizer.commands == [Disputed(0)]


def test_any_nan_is_the_same_nan() -> None:
    optimizer = Optimizer(verify=1.0)
    optimizer.join("a")
    (ask,) = optimizer.work(1)
    optimizer.join("b")
    (check,) = optimizer.answer(ask, outcomes(ask, float("nan")))
    optimizer.answer(check, outcomes(check, -float("nan")))
    assert optimizer.commands == [Complete()]


def test_a_second_server_that_was_wrong_is_banned() -> None:
    optimizer, check = verified_once()
    optimizer.answer(check, outcomes(check, 8.0))
    assert verbs(optimizer.feed(arbitrate(0, 7.0))) == [("b", "release")]
    assert [note.server for note in optimizer.notes("server_wrong")] == ["b"]
    assert Complete() in optimizer.commands
    optimizer.feed(Gone("b"))
    assert optimizer.feed(Seen("b")) == [], "never again"
    assert optimizer.dispatch.servers.by_id["b"].phase == Phase.BANNED


def test_outcomes_of_a_wrong_server_are_evaluated_again() -> None:
    optimizer = Optimizer(verify=0.0)
    optimizer.join("a")
    asks = optimizer.work(4)
    for ask in asks:
        optimizer.answer(ask, outcomes(ask, 8.0))  # trials 0 and 1 are wrong
    workload = optimizer.workload
    optimizer.dispatch.batches.checks.share = 1.0
    ask = optimizer.asked["a", "evaluate"]
    optimizer.join("b")
    optimizer.asked.clear()
    optimizer.answer(ask, outcomes(ask, 8.0))
    (check,) = [optimizer.asked["b", "evaluate"]]
    asks = optimizer.answer(check, outcomes(check, 3.0))
    assert Disputed(trials([check])[0]) in optimizer.commands
    asks = optimizer.feed(arbitrate(trials([check])[0], 3.0))
    assert Retracted("a") in optimizer.commands
    assert ("a", "release") in verbs(asks)
    assert not workload.counted.any()
    optimizer.dispatch.batches.checks.share = 0.0
    again = pending(asks, "b")
    while again:
        ask = again.pop()
        again += pending(
            optimizer.answer(ask, outcomes(ask, *[3.0] * len(trials([ask])))), "b"
        )
    assert Complete() in optimizer.commands
    assert workload.fitness[:, 0].tolist() == [3.0] * 4
    assert set(workload.source) == {"b"}


def test_a_check_of_retracted_trials_may_arrive_after_the_end() -> None:
    """Other servers evaluated the trials again; these checks do not verify them again."""
    optimizer = Optimizer(verify=0.3)
    optimizer.join("a", slots=3)
    (ask,) = optimizer.work(3)
    optimizer.join("b", "c", trial_s=0.01)
    late, check = optimizer.answer(ask, outcomes(ask))
    assert (late.server, trials([late]), check.server, trials([check])) == (
        "b",
        [0],
        "c",
        [2],
    )
    optimizer.answer(check, outcomes(check, 7.0, seconds=0.01))
    asks = [
        ask
        for ask in optimizer.feed(arbitrate(2, 7.0))
        if verb(ask.message) == "evaluate"
    ]
    while asks:
        asks += optimizer.answer(asks[0], outcomes(asks.pop(0), seconds=0.01))
    assert optimizer.commands[-1] == Complete()
    assert optimizer.answer(late, outcomes(late)) == []
    assert optimizer.commands == []


def test_two_servers_that_were_both_wrong_are_banned() -> None:
    optimizer, check = verified_once()
    optimizer.answer(check, outcomes(check, 8.0))
    optimizer.feed(arbitrate(0, 9.0))
    assert sorted(note.server for note in optimizer.notes("server_wrong")) == ["a", "b"]
    assert sorted(optimizer.dispatch.servers.roster.ready) == []
    assert Complete() not in optimizer.commands
    optimizer.join("c")
    ask = optimizer.asked["c", "evaluate"]
    optimizer.answer(ask, outcomes(ask, 9.0))
    assert Complete() in optimizer.commands
    assert optimizer.notes("unverified"), "c is alone"


def test_a_verdict_on_an_ended_workload_is_ignored() -> None:
    optimizer, check = verified_once()
    optimizer.answer(check, outcomes(check, 8.0))
    optimizer.work(1)
    optimizer.feed(arbitrate(0, 7.0))
    assert not optimizer.notes("server_wrong")


def test_restored_outcomes_are_verified_and_can_be_retracted() -> None:
    optimizer = Optimizer(verify=1.0)
    optimizer.join("b")
    workload = Workload([b"g"], np.zeros((3, 1), int), np.arange(3).astype(np.uint64), 0)
    workload.counted[:], workload.source[:], workload.fitness[:] = True, "a", 8.0
    (check, *_) = optimizer.feed(Work(workload))
    assert (check.server, trials([check])) == ("b", [0])
    optimizer.answer(check, outcomes(check, 3.0))
    optimizer.feed(arbitrate(0, 3.0))
    assert Retracted("a") in optimizer.commands
    assert workload.counted.tolist() == [False, False, False]


def test_a_completely_restored_workload_is_complete_without_verification() -> None:
    optimizer = Optimizer()
    workload = Workload([b"g"], np.zeros((1, 1), int), np.arange(1).astype(np.uint64), 0)
    workload.counted[:], workload.source[:] = True, "a"
    assert optimizer.feed(Work(workload)) == []
    assert optimizer.commands == [Complete()]


# ---- the probe


def join(optimizer: Optimizer, server: str, probe: bytes) -> list[Ask]:
    """Let a server appear and tell its digest of the probe."""
    (ask,) = optimizer.feed(Seen(server))
    (ask,) = optimizer.answer(ask, offer(1))
    return optimizer.answer(ask, lease(server, 1, probe=probe))


def test_on_different_probes_the_second_server_waits_until_this_machine_decides() -> None:
    optimizer = Optimizer()
    join(optimizer, "a", b"right")
    assert verbs(join(optimizer, "b", b"other")) == [("b", "release")]
    assert ProbeDisputed(1) in optimizer.commands
    assert optimizer.notes("server_differs")
    join(optimizer, "c", b"other")
    assert ProbeDisputed(1) not in optimizer.commands, "once is enough"
    optimizer.feed(ProbeArbitrated(b"right"))
    assert sorted(note.server for note in optimizer.notes("server_wrong")) == ["b", "c"]
    assert sorted(optimizer.dispatch.servers.roster.ready) == ["a"]


def test_a_first_server_with_a_wrong_probe_is_replaced_by_correct_ones() -> None:
    optimizer = Optimizer()
    join(optimizer, "a", b"wrong")
    (first, _) = optimizer.work(3)
    workload = optimizer.workload
    optimizer.answer(first, outcomes(first, 8.0))
    join(optimizer, "b", b"right")
    optimizer.feed(ProbeArbitrated(b"right"))
    assert Retracted("a") in optimizer.commands
    assert not workload.counted.any()
    optimizer.asked.clear()
    optimizer.wait(0.0)
    assert ("b", "offer") in optimizer.asked
    optimizer.feed(Gone("b"))
    join(optimizer, "b", b"right")
    assert sorted(optimizer.dispatch.servers.roster.ready) == ["b"]
    assert optimizer.dispatch.servers.probe == b"right"


def test_probes_are_compared_as_far_as_both_played_them() -> None:
    """A slow server plays fewer trials; this machine plays up to the one that differs."""
    optimizer = Optimizer()
    one, two, wrong = b"1" * 8, b"2" * 8, b"x" * 8
    join(optimizer, "a", one)
    join(optimizer, "b", one + two)
    assert optimizer.dispatch.servers.probe == one + two
    join(optimizer, "c", b"")
    assert verbs(join(optimizer, "d", one + wrong)) == [("d", "release")]
    assert ProbeDisputed(2) in optimizer.commands
    assert "plays 2 and decides" in optimizer.notes("server_differs")[0].text
    optimizer.feed(ProbeArbitrated(one + two))
    assert [note.server for note in optimizer.notes("server_wrong")] == ["d"]
    assert set(optimizer.dispatch.batches.schedule.serving) == {"a", "b", "c"}


def test_a_trial_that_was_not_arbitrated_is_disputed_anew() -> None:
    optimizer = Optimizer()
    one, two, wrong = b"1" * 8, b"2" * 8, b"x" * 8
    join(optimizer, "a", one)
    join(optimizer, "b", wrong)
    optimizer.feed(ProbeArbitrated(one))
    join(optimizer, "c", one + wrong)
    join(optimizer, "d", one + two)
    assert ProbeDisputed(2) in optimizer.commands
    optimizer.feed(ProbeArbitrated(one + two))
    assert [note.server for note in optimizer.notes("server_wrong")] == ["c"]


def test_after_arbitration_a_differing_server_is_wrong_at_once() -> None:
    optimizer = Optimizer()
    join(optimizer, "a", b"right")
    join(optimizer, "b", b"other")
    optimizer.feed(ProbeArbitrated(b"right"))
    join(optimizer, "c", b"third")
    assert optimizer.notes("server_wrong")
    assert ProbeDisputed(1) not in optimizer.commands


# ---- blame


def test_a_server_with_faults_that_others_do_not_have_is_banned() -> None:
    optimizer = Optimizer()
    optimizer.join("a", "b")
    for number in range(BLAMED):
        assert "a" in optimizer.dispatch.servers.roster.ready
        (first, *rest) = optimizer.work(1)
        assert first.server == "a"
        assert rest == []
        (again,) = optimizer.answer(first, fault(first))
        assert again.server == "b"
        optimizer.answer(again, outcomes(again))
        assert Complete() in optimizer.commands
        assert bool(optimizer.notes("server_faulty")) == (number == BLAMED - 1)
    assert sorted(optimizer.dispatch.servers.roster.ready) == ["b"]
    assert [ask for ask in optimizer.wait(FAULTY_S - 1.0) if ask.server == "a"] == []
    assert ("a", "offer") in verbs(optimizer.wait(2.0))


def test_a_trial_that_fails_everywhere_blames_no_server() -> None:
    optimizer = Optimizer(quarantine=True)
    optimizer.join("a", "b", "c")
    for _ in range(2 * BLAMED):
        asks = optimizer.work(1)
        for _ in range(3):
            (ask,) = asks
            asks = optimizer.answer(ask, fault(ask))
        assert Complete() in optimizer.commands
    assert sorted(optimizer.dispatch.servers.roster.ready) == ["a", "b", "c"]


def test_a_server_that_counted_many_trials_is_allowed_a_few_faults() -> None:
    optimizer = Optimizer()
    optimizer.join("a", "b")
    optimizer.dispatch.servers.machines.counted["a"] = 10_000
    for _ in range(2 * BLAMED):
        (first,) = optimizer.work(1)
        assert first.server == "a"
        (again,) = optimizer.answer(first, fault(first))
        optimizer.answer(again, outcomes(again))
    assert "a" in optimizer.dispatch.servers.roster.ready


def test_a_faulty_server_is_used_again_when_there_is_no_other() -> None:
    optimizer = Optimizer()
    optimizer.join("a", "b")
    for _ in range(BLAMED):
        (first,) = optimizer.work(1)
        (again,) = optimizer.answer(first, fault(first))
        optimizer.answer(again, outcomes(again))
    assert sorted(optimizer.dispatch.servers.roster.ready) == ["b"]
    optimizer.work(1)
    optimizer.feed(Gone("b"))
    optimizer.answer(optimizer.asked["b", "evaluate"], None)
    optimizer.asked.clear()
    optimizer.wait(PAUSE_S)
    assert ("a", "offer") in optimizer.asked


def fail(optimizer: Optimizer) -> None:
    """Server a fails trials that b can evaluate, until it is backed off."""
    for _ in range(BLAMED):
        (first,) = optimizer.work(1)
        assert first.server == "a"
        (again,) = optimizer.answer(first, fault(first))
        optimizer.answer(again, outcomes(again))
    assert optimizer.notes("server_faulty")


def fall_silent(optimizer: Optimizer, server: str) -> None:
    """Let a server answer no offer any more."""
    for _ in range(len(RETRY_S) + 1):
        optimizer.answer(optimizer.asked[server, "offer"], None)
        optimizer.wait(1.0)


def test_an_earlier_back_off_does_not_end_a_later_one() -> None:
    """A server is silent, comes back before its pause is over, and then is faulty."""
    optimizer = Optimizer()
    optimizer.feed(Seen("a"))
    fall_silent(optimizer, "a")
    optimizer.join("a", "b")
    fail(optimizer)
    asks = optimizer.wait(2 * BACK_OFF_S)
    assert [ask for ask in asks if ask.server == "a"] == []


def test_a_server_that_was_faulty_once_is_recalled_no_sooner_than_others() -> None:
    optimizer = Optimizer()
    optimizer.join("a", "b")
    fail(optimizer)
    optimizer.wait(FAULTY_S)
    fall_silent(optimizer, "a")
    optimizer.work(1)
    optimizer.feed(Gone("b"))
    optimizer.answer(optimizer.asked["b", "evaluate"], None)
    assert optimizer.wait(2 * PAUSE_S) == []
