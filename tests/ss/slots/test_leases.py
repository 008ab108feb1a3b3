"""Leases: who gets which slots, and for how long."""

from typing import Any

import pytest

from tests.ss.slots.table_server import (
    PROBE,
    Server,
    code,
    evaluate,
    outcomes,
    reserve,
    run,
    running_one,
)
from zswarm.protocol import messages
from zswarm.protocol.messages import (
    PROBE_TRIALS,
    Cancel,
    Done,
    FaultKind,
    Lease,
    Offer,
    Refused,
    Release,
    Renew,
    Requirements,
)
from zswarm.ss.slots import leases, table
from zswarm.ss.slots.events import (
    Asked,
    Died,
    Event,
    HolderAlive,
    KillSlot,
    Prepared,
    PrepareSlot,
    StopSlot,
    Unprepared,
)
from zswarm.ss.slots.table import PREPARE_ATTEMPTS

# ---- leases and their slots -------------------------------------------------------------


def test_an_offer_reports_the_free_slots() -> None:
    server = Server()
    server.reserve(slots=1)
    offer = server.answer(server.ask(Requirements(), "b"), Offer)
    assert (offer.capacity, offer.free, offer.leases, offer.mismatch) == (2, 1, 1, "")


def test_a_mismatch_is_reported_in_the_offer_and_refuses_the_reserve() -> None:
    server = Server(mismatch="another version")
    offer = server.answer(server.ask(Requirements()), Offer)
    assert offer.mismatch == "another version"
    assert code(server.asked(reserve())) == "mismatch"
    assert not server.slots.busy()


def test_the_first_slot_plays_the_probe_and_the_others_are_prepared_after_it() -> None:
    """One slot compiles, and the others find the compiled code."""
    server = Server(3)
    assert server.reserve().state == "preparing"
    assert server.commands == [PrepareSlot(0, reserve(), most=PROBE_TRIALS)]
    assert server.feed(Prepared(0, PROBE, 0.5)) == [
        PrepareSlot(1, reserve()),
        PrepareSlot(2, reserve()),
    ]
    server.feed(Prepared(2, PROBE[:8], 0.0))
    lease = server.reserve()
    assert (lease.state, lease.slots, lease.ready, lease.probe, lease.trial_s) == (
        "ready",
        3,
        2,
        PROBE,
        0.5,
    )


def test_a_lease_gets_no_more_slots_than_it_wants() -> None:
    server = Server(3)
    assert server.reserve(slots=2).slots == 2
    assert server.reserve("b", slots=2).slots == 1


def test_the_same_nonce_gets_the_same_lease() -> None:
    server = Server()
    first = server.reserve(nonce=7)
    assert server.reserve(nonce=7) == first
    assert len(server.slots.leases) == 1


def test_a_run_waits_for_slots_until_another_releases_them() -> None:
    server = Server(1)
    first = server.ready("a")
    waiting = server.reserve("b")
    assert (waiting.state, waiting.slots) == ("waiting", 0)
    assert server.asked(Release(lease=first), "a") == Done()
    assert server.commands == []
    assert server.reserve("b").ready == 1


def test_a_new_run_gets_idle_slots_at_once_and_others_after_their_chunk() -> None:
    """No chunk is stopped; the open renewal of the run that gives slots back is answered."""
    server = Server(4)
    first = server.ready("a")
    queries = server.evaluate(first, 1, 2, 3)
    renewal = server.ask(Renew(lease=first, known_ready=4), "a")
    lease = server.reserve("b")
    assert (lease.state, lease.slots) == ("ready", 1), "the idle one"
    assert server.answer(renewal, Lease).ready == 3
    server.evaluate(first, 4)
    assert server.finish(0, 1) == [], (
        "it is assigned, and waits for the first one of its lease"
    )
    assert server.answers[queries[0]] == outcomes(1)
    assert server.finish(1, 2) == [run(1, first, 4)], "and no more than the share"
    assert [server.reserve(name).slots for name in "ab"] == [2, 2]


def test_slots_are_shared_evenly_and_the_remainder_goes_to_earlier_runs() -> None:
    server = Server(8)
    wanted = {"a": 100, "b": 1, "c": 100, "d": 100}
    for name, slots in wanted.items():
        server.ready(name, slots=slots)
    assert [
        server.reserve(name, slots=slots).slots for name, slots in wanted.items()
    ] == [
        3,
        1,
        2,
        2,
    ]


def test_the_holder_of_a_lease_may_want_more_slots() -> None:
    """It keeps the lease."""
    server = Server(4)
    first = server.reserve(slots=1)
    grown = server.reserve(slots=3)
    assert (first.slots, grown.slots, grown.lease) == (1, 3, first.lease)


def test_a_run_gets_slots_back_when_other_runs_end() -> None:
    server = Server(2)
    server.ready("a")
    second = server.ready("b")
    assert [server.reserve(name).slots for name in "ab"] == [1, 1]
    server.ask(Release(lease=second), "b")
    assert server.reserve("a").slots == 2


def test_more_runs_than_slots_do_not_take_them_from_each_other() -> None:
    server = Server(2)
    for name in "abc":
        server.ready(name)
    assert [server.reserve(name).slots for name in "abc"] == [1, 1, 0]


def test_a_slot_prepared_for_a_run_beyond_its_share_is_given_back() -> None:
    server = Server(2)
    server.reserve("a", simulator="other")
    server.feed(Prepared(0, PROBE, 0.5))
    server.reserve("b")
    assert server.states() == ["preparing", "preparing"], "the idle one is prepared anew"
    server.feed(Prepared(0, PROBE, 0.5))
    assert [
        server.reserve(name, simulator=kind).slots
        for name, kind in (("a", "other"), ("b", "minisim"))
    ] == [1, 1]


def test_free_slots_go_to_leases_in_the_order_the_leases_were_made() -> None:
    server = Server(2)
    first = server.ready("a")
    server.reserve("b", slots=1)
    server.reserve("c")
    server.reserve("d")
    server.ask(Release(lease=first), "a")
    assert [server.reserve(run).slots for run in "bcd"] == [1, 1, 0]


def test_a_slot_prepared_for_the_same_problem_is_ready_at_once() -> None:
    server = Server(3)
    first = server.ready("a", slots=2)
    server.ready("b", slots=1)
    server.ask(reserve(slots=3), "c")
    assert server.commands == []
    server.ask(Release(lease=first), "a")
    assert server.commands == []
    assert server.reserve("c").ready == 2


def test_a_lease_gets_the_slots_that_are_prepared_for_its_problem_first() -> None:
    server = Server(3)
    first = server.ready("a", slots=1, simulator="other")
    second = server.ready("b", slots=1)
    third = server.ready("c", slots=1, simulator="other")
    for lease, name in ((first, "a"), (second, "b"), (third, "c")):
        server.ask(Release(lease=lease), name)
    server.ask(reserve(slots=1), "d")
    assert (server.commands, server.states()) == ([], ["free", "ready", "free"])


def test_a_slot_that_is_ready_at_once_is_reported_and_takes_waiting_work() -> None:
    server = Server(2)
    first = server.ready("a", slots=1)
    second = server.ready("b", slots=2)
    server.evaluate(second, 1, 2, run="b")
    renewal = server.ask(Renew(lease=second, known_ready=1), "b")
    server.ask(Release(lease=first), "a")
    assert server.commands == [run(0, second, 2)]
    answer = server.answer(renewal, Lease)
    assert answer.ready == 2


def test_a_slot_that_could_not_be_prepared_is_prepared_again() -> None:
    server = Server(2)
    server.reserve("a", slots=1)
    server.reserve("b", slots=2)
    server.feed(Prepared(1, PROBE, 0.5))
    assert server.feed(Unprepared(0, "no memory")) == [PrepareSlot(0, reserve(slots=2))]


def failing(event: Event, times: int = 1) -> Lease:
    """Return the lease of a server whose slot could not be prepared."""
    server = Server(1)
    server.reserve()
    for _ in range(times):
        server.feed(event)
    lease = server.answer(server.ask(reserve()), Lease)
    assert lease.state == "failed"
    return lease


@pytest.mark.parametrize("passing", [True, False])
def test_a_failure_that_may_pass_is_reported_as_one(passing: bool) -> None:
    lease = failing(Unprepared(0, "No space left on device", passing))
    assert (lease.passing, lease.reason) == (passing, "No space left on device")


@pytest.mark.parametrize(("passing", "code"), [(True, "busy"), (False, "mismatch")])
def test_batches_of_a_lease_whose_failure_may_pass_are_not_refused_for_good(
    passing: bool, code: str
) -> None:
    """Its slot worked, died, and could not be prepared again: those that wait, and later ones."""
    server = Server(1)
    lease = server.ready(slots=1)
    _, waiting = server.evaluate(lease, 1, 2)
    server.feed(Died(0, 0, "the simulation ended", "crashed"))
    server.feed(Unprepared(0, "no ROS master answers", passing))
    (later,) = server.evaluate(lease, 3)
    for query in (waiting, later):
        refused = server.answer(query, Refused)
        assert (refused.code, refused.reason) == (code, "no ROS master answers")


@pytest.mark.parametrize(("kind", "passing"), [("crashed", True), ("memory", False)])
def test_a_process_that_dies_may_be_prepared_later_unless_it_needs_too_much(
    kind: FaultKind, passing: bool
) -> None:
    assert failing(Died(0, 0, "it ended", kind), PREPARE_ATTEMPTS).passing == passing


def test_a_run_that_reserves_again_after_a_failure_is_prepared_again() -> None:
    server = Server(1)
    lease = server.reserve()
    server.feed(Unprepared(0, "No space left on device", passing=True))
    server.ask(Release(lease=lease.lease))
    query = server.ask(reserve())
    assert server.commands == [PrepareSlot(0, reserve(), most=8)]
    assert server.answer(query, Lease).state == "preparing"


def test_a_server_needs_ticks_while_a_lease_is_held_or_a_slot_stops() -> None:
    server = Server(1)
    assert not server.slots.busy()
    lease = server.ready()
    assert server.slots.busy()
    server.evaluate(lease, 1)
    server.ask(Release(lease=lease))
    assert server.slots.busy()
    server.finish(0, 1)
    assert not server.slots.busy()


def test_a_slot_prepared_with_another_memory_limit_is_prepared_again() -> None:
    server = Server(1)
    server.ask(Release(lease=server.ready("a", memory_mb=512)), "a")
    server.ready("b", memory_mb=512)
    server.ask(reserve(memory_mb=1024, slots=1), "c")
    server.ask(Release(lease=server.slots.leases["user", "b"].token), "b")
    assert server.commands == [
        PrepareSlot(0, reserve(memory_mb=1024, slots=1), most=PROBE_TRIALS)
    ]


def test_a_slot_prepared_for_another_problem_is_prepared_again() -> None:
    server = Server(2)
    first = server.ready("a", simulator="other")
    server.ask(reserve(), "b")
    server.ask(Release(lease=first), "a")
    assert server.feed(Prepared(0, PROBE, 0.5)) == [PrepareSlot(1, reserve())]


def test_a_slot_released_while_preparing_becomes_free_afterwards() -> None:
    server = Server(1)
    lease = server.reserve("a").lease
    server.ask(reserve(simulator="other"), "b")
    server.ask(Release(lease=lease), "a")
    assert (server.commands, server.states()) == ([], ["stopping"])
    assert server.feed(Prepared(0, PROBE, 0.5)) == [
        PrepareSlot(0, reserve(simulator="other"), most=PROBE_TRIALS)
    ]


@pytest.mark.parametrize(
    "event", [Unprepared(0, "no"), Died(0, 0, "killed"), Prepared(0, PROBE, 0.5)]
)
def test_a_released_slot_becomes_free_after_any_end_of_its_preparation(
    event: Event,
) -> None:
    server = Server(1)
    server.ask(Release(lease=server.reserve().lease))
    server.feed(event)
    assert server.states() == ["free"]
    assert not server.slots.busy()


def test_a_slot_released_while_busy_is_stopped_and_killed_after_two_seconds() -> None:
    server, lease, query = running_one()
    server.ask(Release(lease=lease))
    assert server.commands == [StopSlot(0)]
    assert code(server.answers[query]) == "lease-lost"
    assert server.wait(2.0) == []
    assert server.wait(0.25) == [KillSlot(0)]
    assert server.states() == ["free"]


def test_a_slot_that_stops_in_time_is_not_killed_and_stays_prepared() -> None:
    server = Server(2)
    lease = server.ready("a", slots=1)
    server.ready("b", slots=2)
    server.evaluate(lease, 1)
    server.ask(Release(lease=lease))
    assert server.finish(0, 1) == []
    assert server.reserve("b").ready == 2
    assert server.wait(5.0) == []


def test_a_lease_ends_a_minute_after_the_last_message() -> None:
    server = Server()
    lease = server.ready()
    server.wait(59.0)
    server.asked(Renew(lease=lease))
    server.wait(59.0)
    server.reserve()
    server.wait(60.0)
    assert server.slots.leases
    server.wait(0.25)
    assert not server.slots.leases
    assert not server.slots.busy()
    assert code(server.asked(Renew(lease=lease))) == "lease-lost"


def test_an_expired_lease_answers_the_batches_that_run_and_wait() -> None:
    server = Server(1)
    queries = server.evaluate(server.ready(), 1, 2)
    server.feed(HolderAlive("user", "a", alive=False))
    for server.trials[0] in range(3):
        server.wait(10.0)
    assert not set(queries) & set(server.answers)
    assert server.wait(0.25) == [StopSlot(0)]
    assert [code(server.answers[query]) for query in queries] == [
        "lease-lost",
        "lease-lost",
    ]


def test_a_lease_ends_half_a_minute_after_its_holders_token_vanished() -> None:
    server = Server()
    server.reserve()
    server.feed(HolderAlive("user", "a", alive=False))
    server.wait(30.0)
    assert server.slots.leases
    server.wait(0.25)
    assert not server.slots.leases


@pytest.mark.parametrize("sign", ["token", "message"])
def test_the_token_or_a_message_of_the_holder_keeps_the_lease(sign: str) -> None:
    server = Server()
    lease = server.reserve().lease
    server.feed(HolderAlive("user", "a", alive=False))
    server.wait(29.0)
    if sign == "token":
        server.feed(HolderAlive("user", "a", alive=True))
    else:
        server.ask(Renew(lease=lease))
    server.wait(5.0)
    assert server.slots.leases


def test_the_token_of_another_run_does_not_end_a_lease() -> None:
    server = Server()
    server.reserve()
    server.feed(HolderAlive("user", "b", alive=False))
    server.feed(HolderAlive("somebody", "a", alive=False))
    server.wait(31.0)
    assert server.slots.leases


@pytest.mark.parametrize(
    "message",
    [
        Renew,
        Release,
        lambda lease: evaluate(lease, 1),
        lambda lease: Cancel(lease=lease, batches=[]),
    ],
)
def test_only_its_own_run_can_use_a_lease(message: object) -> None:
    server = Server()
    lease = server.ready("a")
    request = message(lease=lease)  # type: ignore[operator]
    assert code(server.asked(request, "b")) == "lease-lost"
    assert server.commands == []


# ---- the probe --------------------------------------------------------------------------


def test_a_problems_probe_is_played_once_while_the_server_runs() -> None:
    """Later leases have its digest and time, and all their slots are prepared at once."""
    server = Server(2)
    lease = server.ready("a")
    server.ask(Release(lease=lease), "a")
    server.ready("b", simulator="other")
    server.ask(Release(lease=server.slots.leases["user", "b"].token), "b")
    again = server.reserve("c")
    assert (again.state, again.probe, again.trial_s) == ("preparing", PROBE, 0.5)
    server.ask(Release(lease=again.lease), "c")
    server.feed(Prepared(0, PROBE[:8], 0.0))
    server.feed(Prepared(1, PROBE[:8], 0.0))
    server.ready("d", simulator="other")
    server.ask(Release(lease=server.slots.leases["user", "d"].token), "d")
    server.reserve("e")
    assert server.commands == [
        PrepareSlot(0, reserve()),
        PrepareSlot(1, reserve()),
    ]


def test_a_probe_without_a_digest_is_played_once_too() -> None:
    """The simulator is not repeatable."""
    server = Server(2)
    server.reserve("a")
    assert server.feed(Prepared(0, b"", 15.0)) == [PrepareSlot(1, reserve())]
    lease = server.reserve("a")
    assert (lease.state, lease.probe, lease.trial_s) == ("ready", b"", 15.0)


@pytest.mark.parametrize(
    "other", [{"simulator": "other"}, {"memory_mb": 512}], ids=["simulator", "memory"]
)
def test_the_probe_of_another_problem_is_played(other: dict[str, Any]) -> None:
    server = Server(1)
    server.ask(Release(lease=server.ready("a")), "a")
    server.ask(reserve(**other), "b")
    assert server.commands == [PrepareSlot(0, reserve(**other), most=PROBE_TRIALS)]


def test_the_oldest_probes_are_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(leases, "MAX_PROBES", 1)
    server = Server(1)
    for name in ("minisim", "other"):
        server.ask(Release(lease=server.ready(simulator=name)))
    server.ask(reserve())
    assert server.commands == [PrepareSlot(0, reserve(), most=PROBE_TRIALS)]


# ---- epochs -----------------------------------------------------------------------------


def test_a_higher_epoch_takes_the_slots_over() -> None:
    server = Server()
    old = server.ready(nonce=1, epoch=0)
    queries = [
        *server.evaluate(old, 1, 2, 3),
        server.ask(Renew(lease=old, known_ready=2)),
    ]
    lease = server.reserve(nonce=2, epoch=1)
    assert lease.lease != old
    assert server.commands == [StopSlot(0), StopSlot(1)]
    assert [code(server.answers[query]) for query in queries] == ["lease-lost"] * 4
    assert server.finish(0, 1) == []
    assert server.reserve(nonce=2, epoch=1).ready == 1
    assert code(server.asked(Renew(lease=old))) == "lease-lost"
    server.finish(1, 2)
    assert server.reserve(nonce=2, epoch=1).slots == 2


def test_a_lease_that_takes_over_keeps_its_place_in_the_queue() -> None:
    server = Server(1)
    server.ready("a", nonce=1, epoch=0)
    server.reserve("b")
    assert server.reserve("a", nonce=2, epoch=1).slots == 1
    assert server.reserve("b").slots == 0


@pytest.mark.parametrize("epoch", [2, 3])
def test_a_lower_or_equal_epoch_is_refused(epoch: int) -> None:
    server = Server()
    lease = server.reserve(nonce=1, epoch=3)
    assert code(server.asked(reserve(nonce=2, epoch=epoch))) == "superseded"
    assert server.reserve(nonce=1, epoch=3) == lease


def test_after_the_lease_ended_only_a_lower_epoch_is_refused() -> None:
    server = Server()
    server.ask(Release(lease=server.ready(nonce=1, epoch=3)))
    assert code(server.asked(reserve(nonce=2, epoch=2))) == "superseded"
    assert server.reserve(nonce=3, epoch=3).slots == 2


def test_epochs_of_different_runs_and_users_are_independent() -> None:
    server = Server()
    server.reserve("a", slots=1, epoch=5)
    assert server.reserve("b", epoch=0).slots == 1


def test_the_oldest_epochs_are_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(leases, "MAX_ENDED", 2)
    server = Server()
    for name in ("a", "b", "a", "c"):
        server.ask(Release(lease=server.reserve(name, epoch=9).lease), name)
    assert code(server.asked(reserve(epoch=8), "a")) == "superseded"
    server.reserve("d")
    assert code(server.asked(reserve(epoch=8), "c")) == "superseded"
    assert isinstance(server.asked(reserve(epoch=8), "b"), Lease)


def test_an_epoch_is_forgotten_a_while_after_the_last_lease_ended() -> None:
    server = Server()
    server.ask(Release(lease=server.reserve(epoch=9).lease))
    server.now += leases.REMEMBER_S
    assert code(server.asked(reserve(epoch=8))) == "superseded"
    server.now += 1.0
    assert isinstance(server.asked(reserve(epoch=8)), Lease)


def test_an_epoch_that_no_resumes_reach_is_refused() -> None:
    server = Server()
    lease = server.reserve(nonce=1, epoch=3)
    far = reserve(nonce=2, epoch=4 + leases.MAX_JUMP)
    assert code(server.asked(far)) == "malformed"
    assert server.reserve(nonce=1, epoch=3) == lease
    server.ask(Release(lease=lease.lease))
    assert code(server.asked(far)) == "malformed"
    server.reserve(nonce=3, epoch=3 + leases.MAX_JUMP)


# ---- proofs -----------------------------------------------------------------------------

OURS, THEIRS, NONE = b"ours", b"theirs", b""


@pytest.mark.parametrize("stranger", [THEIRS, NONE])
@pytest.mark.parametrize("epoch", [0, 1, 900, messages.MAX_EPOCH])
def test_a_lease_is_taken_over_only_with_its_proof(stranger: bytes, epoch: int) -> None:
    """And a program that holds one is ended by no other, whatever it did before or since."""
    server = Server()
    lease = server.reserve(nonce=1, epoch=1, proof=OURS)
    attack = reserve(nonce=9, epoch=epoch, proof=stranger)
    assert code(server.asked(attack)) == "busy"
    assert server.reserve(nonce=1, epoch=1, proof=OURS) == lease
    resumed = server.reserve(nonce=2, epoch=2, proof=OURS)
    assert resumed.lease != lease.lease
    server.ask(Release(lease=resumed.lease))
    taken = server.asked(attack)  # its name is free
    assert isinstance(taken, Lease)
    assert code(server.asked(reserve(nonce=3, epoch=2, proof=OURS))) != "superseded"
    server.ask(Release(lease=taken.lease))
    server.reserve(nonce=3, epoch=2, proof=OURS)


def test_a_stranger_who_has_the_name_first_ends_no_run() -> None:
    """``superseded`` would end it: it is told ``busy``, and uses other servers."""
    for stranger in (THEIRS, NONE):
        server = Server()
        server.reserve(nonce=9, epoch=900, proof=stranger)
        assert code(server.asked(reserve(nonce=1, epoch=1, proof=OURS))) == "busy"


def test_the_lease_of_an_older_program_is_taken_over_by_the_epoch() -> None:
    server = Server()
    server.reserve(nonce=1, epoch=1)
    assert isinstance(server.asked(reserve(nonce=2, epoch=2, proof=OURS)), Lease)
    assert code(server.asked(reserve(nonce=1, epoch=1))) == "busy"


def test_an_outdated_program_of_the_run_is_superseded() -> None:
    server = Server()
    server.reserve(nonce=2, epoch=2, proof=OURS)
    for epoch in (1, 2):
        old = reserve(nonce=1, epoch=epoch, proof=OURS)
        assert code(server.asked(old)) == "superseded"


# ---- limits -----------------------------------------------------------------------------


def test_a_user_has_a_limited_number_of_leases(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(leases, "MAX_LEASES_OF_USER", 3)
    server = Server()
    held = [server.reserve(name) for name in "abc"]
    assert code(server.asked(reserve(), "d")) == "busy"
    assert server.reserve("b") == held[1]
    assert server.reserve("a", nonce=2, epoch=1).lease != held[0].lease, "taken over"
    server.open.add(99)
    server.feed(Asked(99, "other", "run", reserve(slots=1)))
    assert isinstance(server.answers[99], Lease)
    server.ask(Release(lease=held[2].lease), "c")
    assert isinstance(server.asked(reserve(), "d"), Lease)


def test_a_server_has_a_limited_number_of_leases(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(leases, "MAX_LEASES", 2)
    server = Server()
    server.reserve("a")
    server.reserve("b")
    assert code(server.asked(reserve(), "c")) == "busy"


def test_the_oldest_of_too_many_renewals_is_answered_at_once() -> None:
    server = Server()
    lease = server.ready()
    renew = Renew(lease=lease, known_ready=2)
    queries = [server.ask(renew) for _ in range(table.MAX_RENEWALS + 2)]
    assert set(queries) & set(server.answers) == set(queries[:2])


def test_the_same_nonce_changes_the_slots_and_nothing_that_was_checked() -> None:
    """Else settings beyond a server's limits would reach its slots."""
    server = Server()
    server.reserve(nonce=1, slots=1)
    server.reserve(nonce=1, slots=2, simulator="unchecked")
    lease = server.slots.leases["user", "a"]
    assert lease.reserve == reserve(nonce=1, slots=2)


# ---- renewals ---------------------------------------------------------------------------


def test_a_renewal_is_answered_when_the_number_of_ready_slots_changes() -> None:
    server = Server()
    lease = server.reserve().lease
    query = server.ask(Renew(lease=lease, known_ready=0))
    server.wait(5.0)
    assert query not in server.answers
    server.feed(Prepared(0, PROBE, 0.5))
    answer = server.answer(query, Lease)
    assert (answer.state, answer.ready) == ("ready", 1)


def test_a_renewal_is_answered_when_a_slot_is_not_ready_any_more() -> None:
    server = Server(1)
    query = server.ask(Renew(lease=server.ready(), known_ready=1))
    server.feed(Died(0, 0, "killed"))
    answer = server.answer(query, Lease)
    assert (answer.state, answer.ready) == ("preparing", 0)


def test_a_renewal_is_held_for_at_most_ten_seconds() -> None:
    server = Server()
    lease = server.ready()
    query = server.ask(Renew(lease=lease, known_ready=2))
    server.wait(10.0)
    assert query not in server.answers
    server.wait(0.25)
    assert query in server.answers
    assert isinstance(server.asked(Renew(lease=lease)), Lease)
