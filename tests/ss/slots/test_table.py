"""The slot table: faults, draining, and what it counts."""

import pytest

from tests.ss.slots.table_server import (
    PROBE,
    TIMEOUT_S,
    Server,
    code,
    evaluate,
    outcomes,
    reserve,
    run,
    running_one,
)
from zswarm.protocol.messages import (
    PROBE_TRIALS,
    Cancel,
    Done,
    Fault,
    Lease,
    Offer,
    Refused,
    Release,
    Renew,
    Requirements,
)
from zswarm.ss.slots import table
from zswarm.ss.slots.events import (
    Died,
    Drain,
    Drained,
    Finished,
    KillSlot,
    Prepared,
    PrepareSlot,
    Unprepared,
)

# ---- faults -----------------------------------------------------------------------------


def test_a_process_that_dies_blames_one_trial_and_is_prepared_again() -> None:
    server = Server(1)
    lease = server.ready()
    queries = server.evaluate(lease, 1, 2)
    assert server.feed(Died(0, 3, "killed by signal 11")) == [PrepareSlot(0, reserve())]
    fault = Fault(
        batch=1, kind="crashed", trial=3, reason="simulator minisim: killed by signal 11"
    )
    assert server.answers[queries[0]] == fault
    assert server.asked(evaluate(lease, 1)) == fault
    assert server.feed(Prepared(0, PROBE[:8], 0.0)) == [run(0, lease, 2)]


def test_a_trial_that_takes_too_long_is_killed_and_blamed() -> None:
    server, _lease, query = running_one()
    for server.trials[0] in range(2):
        assert server.wait(TIMEOUT_S) == []
    assert server.wait(0.5) == [KillSlot(0), PrepareSlot(0, reserve())]
    answer = server.answer(query, Fault)
    assert (answer.batch, answer.kind, answer.trial) == (1, "timeout", 1)


def test_a_fault_of_a_batch_without_a_query_is_cached() -> None:
    server, lease, _ = running_one()
    for server.trials[0] in range(4):
        server.wait(8.0)
    server.feed(Died(0, 3, "crash"))
    assert isinstance(server.asked(evaluate(lease, 1)), Fault)


def test_an_idle_slot_whose_process_dies_is_prepared_again() -> None:
    server = Server(1)
    lease = server.ready()
    assert server.feed(Died(0, 0, "killed")) == [PrepareSlot(0, reserve())]
    server.evaluate(lease, 1)
    assert server.feed(Prepared(0, PROBE[:8], 0.0)) == [run(0, lease, 1)]


def test_a_free_slot_whose_process_died_is_prepared_again() -> None:
    server = Server(2)
    first = server.ready("a", slots=1)
    server.ready("b", slots=2)
    server.ask(Release(lease=first), "a")
    assert server.reserve("b").ready == 2
    server.feed(Died(0, 0, "killed"))
    assert server.reserve("b").ready == 1


def test_a_run_that_shares_loses_only_the_slot_that_could_not_be_prepared() -> None:
    """Slots that other runs have for now are not lost."""
    server = Server(6)
    server.ready("a")
    other = server.ready("b")
    assert [server.reserve(name).slots for name in "ab"] == [3, 3]
    broken = server.slots.leases["user", "a"].slots[0].index
    for _ in range(1 + table.PREPARE_ATTEMPTS):  # the first one while it is idle
        server.feed(Died(broken, 0, "killed"))
    server.ask(Release(lease=other), "b")
    assert server.reserve("a").slots == 5


def test_a_problem_that_cannot_be_prepared_fails_the_lease_and_frees_its_slots() -> None:
    server = Server(1)
    lease = server.reserve("a").lease
    server.ask(reserve(simulator="other"), "b")
    queries = [*server.evaluate(lease, 1), server.ask(Renew(lease=lease, known_ready=0))]
    assert server.feed(Unprepared(0, "no such map")) == [
        PrepareSlot(0, reserve(simulator="other"), most=PROBE_TRIALS)
    ]
    assert code(server.answers[queries[0]]) == "mismatch"
    renewed = server.answer(queries[1], Lease)
    assert (renewed.state, renewed.reason, renewed.slots) == ("failed", "no such map", 0)
    assert server.asked(evaluate(lease, 2)) == Refused(
        code="mismatch", reason="no such map"
    )
    assert isinstance(server.asked(Renew(lease=lease, known_ready=0)), Lease), (
        "a failed lease holds no renewal"
    )
    assert server.asked(Release(lease=lease)) == Done()


def test_a_process_that_dies_while_it_is_prepared_is_tried_three_times() -> None:
    server = Server()
    server.reserve()
    for _ in range(2):
        assert server.feed(Died(0, 0, "killed")) == [
            PrepareSlot(0, reserve(), most=PROBE_TRIALS)
        ]
    assert server.feed(Died(0, 0, "killed")) == []
    lease = server.reserve()
    assert lease.state == "failed"
    assert lease.reason == "while simulator minisim was prepared: killed"
    assert server.states() == ["free", "free"]


def test_a_slot_that_cannot_be_prepared_is_given_up_while_others_continue() -> None:
    server = Server()
    lease = server.reserve().lease
    server.feed(Prepared(0, PROBE, 0.5))
    (query,) = server.evaluate(lease, 1)
    for _ in range(2):
        assert server.feed(Died(1, 0, "no memory")) == [PrepareSlot(1, reserve())]
    assert server.feed(Died(1, 0, "no memory")) == []
    assert server.states() == ["busy", "free"]
    server.finish(0, 1)
    assert server.answers[query] == outcomes(1)
    assert server.reserve().slots == 1


def test_the_last_slot_of_a_lease_is_not_given_up() -> None:
    server = Server(1)
    server.ready()
    for _ in range(4):
        server.feed(Died(0, 0, "no memory"))
    assert server.reserve().state == "failed"


def test_deaths_of_a_slot_are_counted_from_its_last_preparation() -> None:
    server = Server(1)
    server.ready()
    for _ in range(5):
        assert server.feed(Died(0, 0, "killed")) == [PrepareSlot(0, reserve())]
        server.feed(Died(0, 0, "killed"))
        server.feed(Prepared(0, PROBE[:8], 0.0))
    assert server.reserve().state == "ready"


@pytest.mark.parametrize("released", [False, True])
def test_a_preparation_that_does_not_end_is_killed(released: bool) -> None:
    server = Server(1)
    lease = server.reserve().lease
    server.ask(Renew(lease=lease, known_ready=0))
    if released:
        server.ask(Release(lease=lease))
    limit_s = table.PREPARE_S + (
        0 if released else table.PROBE_TIMEOUTS * reserve().trial_timeout_s
    )
    for _ in range(20):
        server.ask(Renew(lease=lease, known_ready=0))
        assert server.wait(limit_s / 20) == []
    assert server.wait(0.25) == [KillSlot(0)]
    assert server.states() == ["free"]
    assert released or server.reserve().state == "failed"


# ---- draining ---------------------------------------------------------------------------


def test_a_server_with_nothing_to_do_drains_at_once() -> None:
    server = Server()
    lease = server.ready()
    assert server.feed(Drain()) == [Drained()]
    assert isinstance(server.asked(Renew(lease=lease, known_ready=1)), Lease)
    assert server.commands == [], "it is to exit once"


def test_draining_finishes_running_chunks_and_answers_all_queries() -> None:
    server = Server(1)
    lease = server.ready()
    running, waiting = server.evaluate(lease, 1, 2)
    renewal = server.ask(Renew(lease=lease, known_ready=1))
    assert server.feed(Drain()) == []
    assert code(server.answers[waiting]) == "draining"
    assert code(server.asked(evaluate(lease, 3))) == "draining"
    assert code(server.asked(reserve(), "b")) == "draining"
    offer = server.answer(server.ask(Requirements(), "b"), Offer)
    assert offer.mismatch == "draining"
    assert not {running, renewal} & set(server.answers)
    assert server.finish(0, 1) == [Drained()]
    assert server.answers[running] == outcomes(1)
    assert isinstance(server.answers[renewal], Lease)
    assert server.asked(evaluate(lease, 1)) == outcomes(1)
    assert isinstance(server.asked(Renew(lease=lease, known_ready=1)), Lease)


def test_a_running_batch_can_be_asked_again_while_the_server_drains() -> None:
    server, lease, _ = running_one()
    server.feed(Drain())
    (query,) = server.evaluate(lease, 1)
    server.finish(0, 1)
    assert server.answers[query] == outcomes(1)


def test_a_process_that_dies_ends_the_draining_too() -> None:
    server = Server(1)
    (query,) = server.evaluate(server.ready(), 1)
    server.feed(Drain())
    assert Drained() in server.feed(Died(0, 0, "crash"))
    assert isinstance(server.answers[query], Fault)


def test_slots_that_become_free_while_draining_stay_free() -> None:
    server = Server(2)
    first, second = server.ready("a", slots=1), server.ready("b", slots=1)
    server.reserve("c")
    server.evaluate(first, 1)
    server.feed(Drain())
    server.ask(Release(lease=second), "b")
    assert server.commands == []
    assert server.reserve("c").slots == 0


def test_a_server_that_was_suspended_blames_no_trial() -> None:
    """A laptop slept, or a process was stopped: its slots were, too, and get their time back."""
    server, lease, _ = running_one()
    server.wait(TIMEOUT_S - 1.0)
    server.now += 50.0
    server.ask(Renew(lease=lease, known_ready=0))
    assert server.wait(0.75) == []
    assert server.wait(0.75)[0] == KillSlot(0)


# ---- what is counted --------------------------------------------------------------------


def test_trials_are_counted_when_they_have_outcomes() -> None:
    """The lease and the server count them, with their time; refused and cancelled ones not."""
    server = Server(1)
    lease = server.ready()
    server.evaluate(lease, 1, 2)
    server.now += 0.5
    server.finish(0, 1)
    held = server.slots.leases["user", "a"]
    assert (server.slots.trials, held.jobs.trials, server.slots.seconds) == (1, 1, 0.5)
    server.now += 0.25
    server.feed(Finished(0, Refused(code="malformed", reason="it does not fit")))
    assert (server.slots.trials, held.jobs.trials, server.slots.seconds) == (1, 1, 0.75)
    server.evaluate(lease, 3)
    server.ask(Cancel(lease=lease, batches=[3]))
    server.finish(0, 3)
    assert (server.slots.trials, held.jobs.trials) == (1, 1)
    server.evaluate(lease, 1)
    assert server.slots.trials == 1, "asked again, it is not played again"


def test_processes_that_died_or_were_killed_are_counted_by_kind() -> None:
    server = Server(1)
    lease = server.ready()
    server.feed(Died(0, 0, "killed", "memory"))
    server.feed(Prepared(0, PROBE, 0.5))
    server.evaluate(lease, 1)
    server.wait(TIMEOUT_S + 1.0)
    assert server.slots.faults == {"memory": 1, "timeout": 1}
