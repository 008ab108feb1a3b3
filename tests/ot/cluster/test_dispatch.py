"""Dispatch: events and plain times in, commands out."""

from collections import deque

import msgspec
import numpy as np
import pytest
from msgspec import structs

from tests.instruction_count import instructions
from tests.ot.cluster.dispatching import (
    NAN,
    PROBE,
    Optimizer,
    batch,
    fault,
    lease,
    offer,
    outcomes,
    trials,
    verbs,
)
from zswarm.errors import LocalProtocolError
from zswarm.ot.cluster.allotment import ALLOT_AFTER_S
from zswarm.ot.cluster.batches import ATTEMPTS
from zswarm.ot.cluster.events import (
    MARGIN_S,
    QUERY_S,
    Ask,
    Complete,
    Counted,
    Failed,
    Gone,
    Leave,
    Seen,
    Superseded,
    TimePassed,
    Work,
)
from zswarm.ot.cluster.matching import Choice
from zswarm.ot.cluster.remote_server import AGAIN_S
from zswarm.ot.cluster.servers import BACK_OFF_S, PAUSE_S, RENEW_S, RETRY_S
from zswarm.ot.notes import Note
from zswarm.ot.workload import Workload
from zswarm.protocol import codec, labels
from zswarm.protocol.messages import (
    MAX_MESSAGE,
    Done,
    Evaluate,
    Fault,
    Outcomes,
    Refused,
    Reply,
    Reserve,
    Running,
    verb,
)

# ---- servers that come


def test_a_server_is_asked_for_its_offer_then_reserved_then_given_work() -> None:
    optimizer = Optimizer()
    optimizer.work(10)
    (ask,) = optimizer.feed(Seen("a"))
    assert (ask.server, verb(ask.message)) == ("a", "offer")
    (ask,) = optimizer.answer(ask, offer())
    assert (ask.server, verb(ask.message)) == ("a", "reserve")
    asks = optimizer.answer(ask, lease("a", 1))
    assert verbs(asks) == [("a", "evaluate")] * 2
    assert asks[0].message.lease == lease("a", 1).lease
    assert sorted(optimizer.dispatch.servers.roster.ready) == ["a"]


def test_a_server_is_asked_once_even_if_seen_repeatedly() -> None:
    optimizer = Optimizer()
    optimizer.feed(Seen("a"))
    assert optimizer.feed(Seen("a")) == []
    optimizer.answer(optimizer.asked["a", "offer"], offer())
    assert optimizer.feed(Seen("a")) == []
    optimizer.answer(optimizer.asked["a", "reserve"], lease("a", 1))
    assert optimizer.feed(Seen("a")) == []


def test_a_server_that_prepares_is_renewed_until_all_slots_are_ready() -> None:
    optimizer = Optimizer()
    optimizer.work(10)
    (ask,) = optimizer.feed(Seen("a"))
    (ask,) = optimizer.answer(ask, offer(2))
    (ask,) = optimizer.answer(ask, lease("a", 0, state="preparing", slots=2))
    assert optimizer.notes("lease_preparing")
    assert (verb(ask.message), ask.message.known_ready) == ("renew", 0)
    assert (
        optimizer.dispatch.servers.standing().leased,
        optimizer.dispatch.servers.standing().preparing,
        optimizer.dispatch.servers.standing().slots,
    ) == (1, ["a"], 0)
    asks = optimizer.answer(ask, lease("a", 1, slots=2))
    assert verbs(asks) == [("a", "renew"), ("a", "evaluate"), ("a", "evaluate")]
    assert asks[0].message.known_ready == 1
    assert optimizer.notes("server_joined") == [Note("server_joined", "a", "", 1, "a")]
    assert verbs(optimizer.answer(asks[0], lease("a", 2))) == [("a", "evaluate")], (
        "two trials more"
    )
    assert len(optimizer.asked["a", "evaluate"].trials) == 2  # type: ignore[arg-type]
    others = [command for command in optimizer.commands if not isinstance(command, Ask)]
    assert others == [Note("server_slots", "a", "", 2)], "it joins once"
    assert (
        optimizer.dispatch.servers.standing().preparing,
        optimizer.dispatch.servers.standing().slots,
    ) == ([], 2)


def test_a_run_waits_for_no_more_slots_than_it_wants() -> None:
    optimizer = Optimizer(slots=1)
    (ask,) = optimizer.feed(Seen("a"))
    (ask,) = optimizer.answer(ask, offer(8))
    assert optimizer.answer(ask, lease("a", 1)) == []


def test_a_server_that_does_not_match_is_looked_at_again_when_it_is_seen_again() -> None:
    optimizer = Optimizer()
    (ask,) = optimizer.feed(Seen("a"))
    assert optimizer.answer(ask, offer(mismatch="no such simulator")) == []
    assert optimizer.notes("server_mismatch")[0].text == "no such simulator"
    assert optimizer.wait(1000.0) == []
    assert verbs(optimizer.feed(Seen("a"))) == [("a", "offer")]


# ---- servers that are chosen


def choosing(
    require: tuple[str, ...] = (), rank: tuple[str, ...] = (), max_slots: int = 0
) -> Optimizer:
    return Optimizer(
        choice=Choice(
            labels.requirements(require, ""), labels.preferences(rank, ""), max_slots
        )
    )


def offers(optimizer: Optimizer, capacity: int, **cores: int) -> None:
    """Let servers appear and offer this many slots each."""
    for server, count in cores.items():
        (ask,) = optimizer.feed(Seen(server))
        assert optimizer.answer(ask, offer(capacity, cores=str(count))) == []


def reserved(asks: list[Ask]) -> list[tuple[str, int]]:
    return [
        (ask.server, ask.message.slots)
        for ask in asks
        if isinstance(ask.message, Reserve)
    ]


def test_a_server_that_does_not_meet_the_requirements_is_named_once_and_not_reserved() -> (
    None
):
    """However often it is seen; again when it says something else."""
    optimizer = choosing(require=("gpu=yes", "cores>=8"))
    told = []
    for labels_of_server in (
        {"cores": "8"},
        {"cores": "8"},
        {"gpu": "yes", "cores": "4"},
    ):
        (ask,) = optimizer.feed(Seen("a"))
        assert optimizer.answer(ask, offer(**labels_of_server)) == []  # type: ignore[arg-type]
        told.append([note.text for note in optimizer.notes("server_mismatch")])
    missing = ["the experiment requires gpu=yes (it has no gpu)"]
    assert told == [missing, [], ["the experiment requires cores>=8 (it has cores=4)"]]
    (ask,) = optimizer.feed(Seen("a"))
    assert verbs(optimizer.answer(ask, offer(gpu="yes", cores="8"))) == [("a", "reserve")]


def test_slots_are_reserved_from_the_best_servers_up_to_the_limit() -> None:
    """They are reserved after a moment, when all are seen; the last one gives only the rest."""
    optimizer = choosing(rank=("cores",), max_slots=6)
    offers(optimizer, 4, small=4, large=64, middle=16)
    assert (
        optimizer.dispatch.servers.standing().spare,
        optimizer.dispatch.servers.standing().leased,
    ) == (3, 0)
    assert reserved(optimizer.wait(ALLOT_AFTER_S)) == [("large", 4), ("middle", 2)]
    for server, slots in (("large", 4), ("middle", 2)):
        assert (
            optimizer.answer(optimizer.asked[server, "reserve"], lease(server, slots))
            == []
        )
    assert (
        optimizer.dispatch.servers.standing().spare,
        optimizer.dispatch.servers.standing().leased,
        optimizer.dispatch.servers.standing().slots,
    ) == (1, 2, 6)


def test_a_better_server_that_joins_later_is_used_once_slots_are_missing() -> None:
    optimizer = choosing(rank=("cores",), max_slots=4)
    offers(optimizer, 4, small=4)
    optimizer.wait(ALLOT_AFTER_S)
    optimizer.answer(optimizer.asked["small", "reserve"], lease("small", 4))
    offers(optimizer, 4, large=64, middle=16)
    assert optimizer.wait(ALLOT_AFTER_S) == []
    assert reserved(optimizer.feed(Gone("small"))) == [("large", 4)]


@pytest.mark.parametrize("answer", [None, Refused(code="draining", reason="")])
def test_the_next_server_is_asked_when_one_grants_no_slots(answer: Reply | None) -> None:
    optimizer = choosing(rank=("cores",), max_slots=2)
    offers(optimizer, 2, small=4, large=64)
    optimizer.wait(ALLOT_AFTER_S)
    asks = optimizer.answer(optimizer.asked["large", "reserve"], answer)
    for pause in RETRY_S if answer is None else ():
        (again,) = optimizer.wait(pause)
        assert verbs([again]) == [("large", "reserve")]
        asks = optimizer.answer(again, answer)
    assert reserved(asks) == [("small", 2)]


def test_slots_granted_late_replace_those_of_worse_servers() -> None:
    """Superfluous slots that are held meanwhile are given back, and not one slot more."""
    optimizer = choosing(rank=("cores",), max_slots=4)
    offers(optimizer, 4, small=4, large=64)
    optimizer.wait(ALLOT_AFTER_S)
    asks = optimizer.answer(
        optimizer.asked["large", "reserve"], lease("large", 0, state="waiting")
    )
    assert reserved(asks) == [("small", 4)], "nobody waits for the busy one alone"
    optimizer.answer(optimizer.asked["small", "reserve"], lease("small", 4))
    asks = optimizer.answer(optimizer.asked["large", "renew"], lease("large", 1))
    assert [
        (*verbs([ask])[0], getattr(ask.message, "slots", 0))
        for ask in asks
        if verbs([ask]) != [("large", "renew")]
    ] == [("small", "release", 0), ("small", "reserve", 3)]
    optimizer.answer(optimizer.asked["small", "reserve"], lease("small", 3, number=1))
    assert optimizer.dispatch.servers.standing().slots == 4


def test_little_work_goes_to_the_best_servers() -> None:
    """A trial for each of their slots before a worse one has any."""
    optimizer = choosing(rank=("cores",))
    for server, cores in (("small", "4"), ("large", "64"), ("middle", "16")):
        (ask,) = optimizer.feed(Seen(server))
        (ask,) = optimizer.answer(ask, offer(2, cores=cores))
        optimizer.answer(ask, lease(server, 2))
    asks = optimizer.work(3)
    assert [(ask.server, trials([ask])) for ask in asks] == [
        ("large", [0, 1]),
        ("middle", [2]),
    ]


def test_nothing_is_reserved_after_leaving() -> None:
    optimizer = choosing(max_slots=1)
    offers(optimizer, 1, a=1, b=1)
    optimizer.wait(ALLOT_AFTER_S)
    optimizer.answer(optimizer.asked["a", "reserve"], lease("a", 1))
    assert verbs(optimizer.feed(Leave())) == [("a", "release")]
    assert optimizer.wait(1000.0) == []


# ---- servers that refuse


@pytest.mark.parametrize("code", ["malformed", "mismatch", "draining"])
def test_a_server_that_refuses_to_be_reserved_is_not_used(code: str) -> None:
    optimizer = Optimizer()
    (ask,) = optimizer.feed(Seen("a"))
    (ask,) = optimizer.answer(ask, offer())
    assert optimizer.answer(ask, Refused(code=code, reason="no")) == []  # type: ignore[arg-type]
    assert optimizer.notes("server_refused")[0].text == "no"
    assert optimizer.wait(1000.0) == []
    assert verbs(optimizer.feed(Seen("a"))) == [("a", "offer")]


def test_a_server_with_as_many_leases_as_it_may_have_is_asked_again_later() -> None:
    optimizer = Optimizer()
    (ask,) = optimizer.feed(Seen("a"))
    full = Refused(code="busy", reason="there are 1024 leases here")
    for noted in (1, 0):
        (ask,) = optimizer.answer(ask, offer())
        assert optimizer.answer(ask, full) == []
        assert len(optimizer.notes("server_refused")) == noted
        (ask,) = optimizer.wait(BACK_OFF_S)
        assert verbs([ask]) == [("a", "offer")]
    (ask,) = optimizer.answer(ask, offer())
    optimizer.answer(ask, lease("a", 1))
    assert sorted(optimizer.dispatch.servers.roster.ready) == ["a"]


def test_a_lease_that_cannot_be_prepared_is_given_back() -> None:
    optimizer = Optimizer()
    (ask,) = optimizer.feed(Seen("a"))
    (ask,) = optimizer.answer(ask, offer())
    (renewal,) = optimizer.answer(ask, lease("a", 0, state="preparing", slots=1))
    (release,) = optimizer.answer(
        renewal, lease("a", 0, state="failed", reason="no such map")
    )
    assert (verb(release.message), release.message.lease) == (
        "release",
        lease("a", 0).lease,
    )
    assert optimizer.notes("server_refused")[0].text == "no such map"
    assert optimizer.answer(release, Done()) == []
    assert optimizer.wait(1000.0) == []


def test_a_server_whose_probe_differs_is_released_and_not_used() -> None:
    optimizer = Optimizer()
    optimizer.work(10)
    optimizer.join("a")
    assert optimizer.dispatch.servers.probe == PROBE
    (ask,) = optimizer.feed(Seen("b"))
    (ask,) = optimizer.answer(ask, offer())
    assert verbs(optimizer.answer(ask, lease("b", 1, probe=b"another"))) == [
        ("b", "release")
    ]
    assert [note.server for note in optimizer.notes("server_differs")] == ["b"]
    assert sorted(optimizer.dispatch.servers.roster.ready) == ["a"]


def test_the_probe_of_the_record_holds_for_the_first_server_too() -> None:
    optimizer = Optimizer(probe=b"recorded")
    optimizer.join("a")
    assert sorted(optimizer.dispatch.servers.roster.ready) == []
    assert optimizer.dispatch.servers.probe == b"recorded"


def superseded(*, own: bool) -> Optimizer:
    optimizer = Optimizer()
    optimizer.join("a")
    optimizer.work(5)
    (ask,) = optimizer.feed(Seen("local-b", own))
    (ask,) = optimizer.answer(ask, offer())
    optimizer.answer(ask, Refused(code="superseded", reason="taken over"))
    return optimizer


def test_a_run_fails_that_its_own_slots_report_as_taken_over() -> None:
    optimizer = superseded(own=True)
    assert Failed("local-b: taken over") in optimizer.commands
    assert ("a", "cancel") in optimizer.asked


def test_another_server_that_reports_so_refuses_and_the_record_is_asked() -> None:
    """Whatever its name is: anybody may call a server ``local-...``."""
    optimizer = superseded(own=False)
    assert Superseded("local-b", "taken over") in optimizer.commands
    assert [note.text for note in optimizer.notes("server_refused")] == ["taken over"]
    assert not any(isinstance(command, Failed) for command in optimizer.commands)
    optimizer.answer(optimizer.asked["a", "evaluate"], None)
    assert verbs(optimizer.wait(1.0)) == [("a", "evaluate")], "the run goes on"


# ---- leases that last and end


def test_a_lease_is_renewed_after_a_while() -> None:
    optimizer = Optimizer()
    optimizer.join("a")
    assert optimizer.dispatch.next_time() == optimizer.now + RENEW_S
    assert verbs(optimizer.wait(RENEW_S)) == [("a", "renew")]
    deadline = optimizer.now + QUERY_S["renew"] + MARGIN_S
    assert optimizer.dispatch.next_time() == deadline
    optimizer.answer(optimizer.asked["a", "renew"], lease("a", 1))
    assert verbs(optimizer.wait(RENEW_S)) == [("a", "renew")]


def test_other_answers_do_not_repeat_a_renewal() -> None:
    optimizer = Optimizer()
    optimizer.join("a")
    optimizer.work(1)
    optimizer.wait(RENEW_S)
    (cancel, _) = optimizer.work(1)
    optimizer.answer(cancel, Done())
    optimizer.now += 2 * RENEW_S
    assert optimizer.feed(TimePassed()) == []
    optimizer.answer(optimizer.asked["a", "renew"], None)
    assert verbs(optimizer.wait(RETRY_S[0])) == [("a", "renew")]
    optimizer.now += 2 * RENEW_S
    assert optimizer.feed(TimePassed()) == []


def test_a_run_without_pauses_learns_that_it_lost_slots() -> None:
    optimizer = Optimizer()
    optimizer.join("a", slots=4)
    optimizer.wait(RENEW_S - 1.0)
    asks = optimizer.work(100)
    assert verbs(optimizer.wait(1.0)) == [("a", "renew")]
    optimizer.answer(optimizer.asked["a", "renew"], lease("a", 2))
    assert optimizer.dispatch.servers.standing().slots == 2
    optimizer.wait(AGAIN_S)
    assert optimizer.asked["a", "renew"].message.known_ready == 2, (
        "the server is to say when they come back"
    )
    assert [len(ask.trials) for ask in asks] == [4, 4]  # type: ignore[arg-type]
    (ask,) = optimizer.answer(asks[0], outcomes(asks[0]))
    assert len(ask.trials) == 2  # type: ignore[arg-type]


@pytest.mark.parametrize("sent", ["renew", "evaluate"])
def test_a_lost_lease_is_reserved_again_after_a_pause_and_its_trials_move(
    sent: str,
) -> None:
    optimizer = Optimizer()
    optimizer.join("a", "b")
    asks = optimizer.work(5)
    lost = next(ask for ask in asks if ask.server == "a")
    optimizer.wait(RENEW_S)
    if sent == "renew":
        lost = optimizer.asked["a", "renew"]
    optimizer.answer(lost, Refused(code="lease-lost", reason="expired"))
    assert optimizer.notes("lease_lost")
    assert sorted(optimizer.dispatch.servers.roster.ready) == ["b"]
    assert verbs(optimizer.wait(PAUSE_S)) == [("a", "offer")]
    (ask,) = optimizer.answer(optimizer.asked["a", "offer"], offer())
    asks = optimizer.answer(ask, lease("a", 1, number=1))
    assert [ask.message.lease for ask in asks if verb(ask.message) == "evaluate"] == [
        lease("a", 1, number=1).lease
    ] * 2
    assert trials(asks) == trials([ask for ask in asks if ask.server == "a"])


def test_an_answer_to_a_lost_lease_does_not_affect_the_next_one() -> None:
    """The first lease's renewal is refused late, and does not prevent that of the second lease."""
    optimizer = Optimizer()
    optimizer.work(10)
    optimizer.join("a")
    optimizer.wait(RENEW_S)
    renewal, sent = optimizer.asked["a", "renew"], optimizer.asked["a", "evaluate"]
    optimizer.answer(sent, Refused(code="lease-lost", reason="expired"))
    optimizer.wait(PAUSE_S)
    (ask,) = optimizer.answer(optimizer.asked["a", "offer"], offer(2))
    asks = optimizer.answer(ask, lease("a", 1, number=1))
    assert ("a", "renew") in verbs(asks)
    assert optimizer.answer(renewal, Refused(code="lease-lost", reason="expired")) == []
    assert sorted(optimizer.dispatch.servers.roster.ready) == ["a"]


def test_a_renewal_refused_for_another_reason_ends_the_use_of_the_server() -> None:
    optimizer = Optimizer()
    optimizer.join("a")
    optimizer.wait(RENEW_S)
    asks = optimizer.answer(
        optimizer.asked["a", "renew"], Refused(code="malformed", reason="?")
    )
    assert verbs(asks) == [("a", "release")]
    assert optimizer.wait(1000.0) == []


def test_a_lease_that_ends_while_its_server_leaves_is_not_asked_for_again() -> None:
    optimizer = Optimizer()
    optimizer.join("a")
    (ask,) = optimizer.work(1)
    optimizer.feed(Gone("a"))
    assert optimizer.answer(ask, Refused(code="lease-lost", reason="expired")) == []
    assert optimizer.wait(1000.0) == []


def test_leaving_releases_all_leases_and_asks_nothing_more() -> None:
    optimizer = Optimizer()
    optimizer.join("a", "b")
    (out,) = optimizer.work(1)
    optimizer.feed(Seen("c"))
    asks = optimizer.feed(Leave())
    assert sorted(verbs(asks)) == [("a", "cancel"), ("a", "release"), ("b", "release")]
    assert [ask.message.lease for ask in asks if verb(ask.message) == "release"] == [
        lease("a", 1).lease,
        lease("b", 1).lease,
    ]
    assert optimizer.answer(out, Refused(code="lease-lost", reason="released")) == []
    assert optimizer.wait(1000.0) == []


# ---- silence


@pytest.mark.parametrize("verb", ["offer", "reserve", "renew"])
def test_an_unanswered_request_is_repeated_then_the_server_is_backed_off(
    verb: str,
) -> None:
    optimizer = Optimizer()
    optimizer.feed(Seen("a"))
    if verb != "offer":
        optimizer.answer(optimizer.asked["a", "offer"], offer())
    if verb == "renew":
        optimizer.answer(optimizer.asked["a", "reserve"], lease("a", 0, state="waiting"))
    for pause in RETRY_S:
        assert optimizer.answer(optimizer.asked["a", verb], None) == []
        assert optimizer.wait(pause - 0.01) == []
        assert verbs(optimizer.wait(0.01)) == [("a", verb)]
    assert optimizer.answer(optimizer.asked["a", verb], None) == []
    assert optimizer.notes("server_silent")[0].text == f"no answer to {verb}"
    assert optimizer.dispatch.servers.standing().leased == 0
    assert verbs(optimizer.wait(BACK_OFF_S)) == [("a", "offer")]


def test_an_answer_restores_all_attempts_of_a_server() -> None:
    optimizer = Optimizer()
    optimizer.feed(Seen("a"))
    for kind, reply in (("offer", offer()), ("reserve", lease("a", 0, state="waiting"))):
        for pause in RETRY_S:
            optimizer.answer(optimizer.asked["a", kind], None)
            assert verbs(optimizer.wait(pause)) == [("a", kind)]
        optimizer.answer(optimizer.asked["a", kind], reply)
    assert optimizer.dispatch.servers.standing().leased == 1


def test_a_silent_server_is_reported_once_and_retried() -> None:
    optimizer = Optimizer()
    optimizer.feed(Seen("a"))
    told = 0
    for _ in range(3 * (len(RETRY_S) + 1)):
        optimizer.answer(optimizer.asked["a", "offer"], None)
        told += len(optimizer.notes("server_silent"))
        while not optimizer.wait(1.0):
            pass
    assert told == 1
    assert verbs(optimizer.answer(optimizer.asked["a", "offer"], offer())) == [
        ("a", "reserve")
    ]


def test_a_backed_off_server_is_retried_only_while_its_token_exists() -> None:
    for event, asked in ((Seen("a"), [("a", "offer")]), (Gone("a"), [])):
        optimizer = Optimizer()
        optimizer.feed(Seen("a"))
        for _ in range(len(RETRY_S) + 1):
            optimizer.answer(optimizer.asked["a", "offer"], None)
            optimizer.wait(1.0)
        assert verbs(optimizer.feed(event)) == asked
        if isinstance(event, Gone):
            assert optimizer.wait(1000.0) == []


def test_an_invalid_reply_counts_as_no_answer() -> None:
    optimizer = Optimizer()
    (ask,) = optimizer.feed(Seen("a"))
    optimizer.answer(ask, "not a message")
    assert optimizer.notes("malformed")[0].text == "not a message"
    assert verbs(optimizer.wait(RETRY_S[0])) == [("a", "offer")]


def test_an_answer_of_another_kind_counts_as_no_answer() -> None:
    optimizer = Optimizer()
    (ask,) = optimizer.feed(Seen("a"))
    assert optimizer.answer(ask, Done()) == []
    assert optimizer.notes("malformed")
    assert verbs(optimizer.wait(RETRY_S[0])) == [("a", "offer")]


@pytest.mark.parametrize("answer", [Done(), "not a message"])
def test_a_server_that_only_answers_nonsense_is_backed_off(answer: Done | str) -> None:
    optimizer = Optimizer()
    optimizer.feed(Seen("a"))
    for pause in RETRY_S:
        optimizer.answer(optimizer.asked["a", "offer"], answer)
        optimizer.wait(pause)
    assert optimizer.answer(optimizer.asked["a", "offer"], answer) == []
    assert optimizer.notes("server_silent")
    assert optimizer.wait(BACK_OFF_S - 0.01) == []


@pytest.mark.parametrize("answer", [None, "not a message"])
def test_an_unanswered_batch_is_sent_again_with_the_same_id(answer: str | None) -> None:
    optimizer = Optimizer()
    optimizer.join("a")
    (ask,) = optimizer.work(1)
    for pause in RETRY_S:
        assert optimizer.answer(ask, answer) == []
        (again,) = optimizer.wait(pause)
        assert (batch(again), again.question != ask.question) == (batch(ask), True)
        ask = again
    optimizer.answer(ask, outcomes(ask))
    assert optimizer.counted == [0]
    assert optimizer.requeued == 0


def test_a_batch_of_an_earlier_workload_is_not_asked_again() -> None:
    optimizer = Optimizer()
    optimizer.join("a")
    (ask,) = optimizer.work(1)
    optimizer.answer(ask, None)
    optimizer.work(1)
    assert optimizer.wait(RETRY_S[0]) == []


def test_a_repeatedly_unanswered_batch_moves_to_another_server() -> None:
    optimizer = Optimizer(second_starts=False)
    optimizer.join("a")
    first, second = optimizer.work(2)
    optimizer.join("b")
    for _ in RETRY_S:
        optimizer.answer(first, None)
        (first,) = optimizer.wait(1.0)
    asks = optimizer.answer(first, None)
    assert verbs(asks) == [("b", "evaluate")] * 2
    assert trials(asks) == [0, 1]
    assert optimizer.notes("server_silent")
    optimizer.answer(second, outcomes(second))
    assert optimizer.counted == []


def test_a_batch_without_outcomes_is_asked_again_and_its_missing_answers_forgotten() -> (
    None
):
    """After a second, at the earliest: an honest server holds the query for 30."""
    optimizer = Optimizer()
    optimizer.join("a")
    (ask,) = optimizer.work(1)
    number = batch(ask)
    for _ in range(3 * len(RETRY_S)):
        optimizer.answer(ask, None)
        (ask,) = optimizer.wait(RETRY_S[0])
        optimizer.now += 0.5
        assert optimizer.answer(ask, Running(batch=number, done=0)) == []
        (ask,) = optimizer.wait(AGAIN_S - 0.5)
        assert batch(ask) == number
    optimizer.now += 30.0
    (ask,) = optimizer.answer(ask, Running(batch=number, done=0))
    assert batch(ask) == number


def bodies(asks: list[Ask]) -> list[int]:
    """Return how many genomes are sent with each batch."""
    messages = [ask.message for ask in asks if isinstance(ask.message, Evaluate)]
    return [len(message.genomes) for message in messages]


def test_a_batch_is_asked_for_again_by_its_id_alone_until_the_server_lacks_it() -> None:
    optimizer = Optimizer()
    optimizer.join("a")
    asks = [*optimizer.work(1)]
    optimizer.answer(asks[-1], Running(batch=batch(asks[0]), done=0))
    asks += optimizer.wait(AGAIN_S)
    optimizer.answer(asks[-1], None)
    asks += optimizer.wait(1.0)
    missing = Refused(code="unknown-batch", reason="there is no such batch")
    asks += optimizer.answer(asks[-1], missing)
    assert bodies(asks) == [1, 0, 0, 1]
    assert {batch(ask) for ask in asks} == {batch(asks[0])}
    assert optimizer.answer(asks[-1], missing) == []
    asks = optimizer.wait(PAUSE_S)
    assert bodies(asks) == [1], "sent whole it cannot be missing: as another refusal"
    optimizer.answer(asks[-1], outcomes(asks[-1]))
    assert optimizer.counted == [0]


def test_a_server_without_that_feature_gets_the_whole_batch_again() -> None:
    optimizer = Optimizer()
    (ask,) = optimizer.feed(Seen("a"))
    (ask,) = optimizer.answer(ask, structs.replace(offer(), features=[]))
    optimizer.answer(ask, lease("a", 1))
    asks = optimizer.work(1)
    optimizer.answer(asks[-1], Running(batch=batch(asks[0]), done=0))
    asks += optimizer.wait(AGAIN_S)
    assert bodies(asks) == [1, 1]


def test_early_outcomes_are_counted_once_and_a_batch_follows() -> None:
    """Slots of the server have nothing to do, as one trial of its batch takes long."""
    optimizer = Optimizer()
    optimizer.join("a", slots=2)
    first, second = optimizer.work(8)
    again, more = optimizer.answer(first, told(first, 1, given=True))
    assert (batch(again), trials([again])) == (batch(first), trials([first]))
    assert batch(more) not in (batch(first), batch(second))
    assert optimizer.counted == [trials([first])[1]]
    assert optimizer.answer(again, outcomes(again)) == []
    assert optimizer.counted == [trials([first])[1], trials([first])[0]]
    assert optimizer.workload.fitness[trials([first]), 0].tolist() == trials([first])


def test_a_fault_without_new_outcomes_counts_nothing() -> None:
    optimizer = Optimizer()
    optimizer.join("a", slots=2)
    (ask,) = optimizer.work(2)
    (again,) = optimizer.answer(ask, told(ask, 0))
    some = told(ask, 0)
    fault = Fault(
        batch=batch(ask),
        kind="timeout",
        trial=1,
        reason="late",
        trials=some.trials,
        fitness=some.fitness,
        seconds=some.seconds,
    )
    assert trials(optimizer.answer(again, fault)) == [1]
    assert not any(isinstance(command, Counted) for command in optimizer.commands)


def test_early_outcomes_stay_counted_when_the_rest_moves() -> None:
    optimizer = Optimizer()
    optimizer.join("a", slots=2)
    (ask,) = optimizer.work(2)
    (again,) = optimizer.answer(ask, told(ask, 0))
    optimizer.join("b")
    optimizer.feed(Gone("a"))
    (moved,) = optimizer.answer(again, None)
    assert (moved.server, trials([moved])) == ("b", [1])
    assert optimizer.requeued == 1


def test_a_partly_answered_batch_is_requested_whole_after_a_reconnect() -> None:
    """Under its number a server knows it by all of its trials."""
    optimizer = Optimizer()
    optimizer.join("a", slots=2)
    (ask,) = optimizer.work(2)
    (again,) = optimizer.answer(ask, told(ask, 0))
    optimizer.feed(Gone("a"))
    optimizer.answer(again, None)
    (question,) = optimizer.feed(Seen("a"))
    (question,) = optimizer.answer(question, offer(2))
    (once_more,) = optimizer.answer(question, lease("a", 2))
    assert (batch(once_more), trials([once_more])) == (batch(ask), [0, 1])
    optimizer.answer(once_more, outcomes(once_more))
    assert sorted(optimizer.counted) == [0, 1]
    assert Complete() in optimizer.commands


def test_unstarted_trials_of_a_draining_server_move_and_the_rest_is_counted() -> None:
    optimizer = Optimizer()
    optimizer.join("a", slots=2)
    (ask,) = optimizer.work(2)
    optimizer.feed(Gone("a"))
    optimizer.join("b")
    some = Outcomes(
        batch=batch(ask),
        fitness=bytes(8),
        metrics=b"",
        seconds=1.0,
        trials=codec.indices([1]),
    )
    assert trials(optimizer.answer(ask, some)) == [0]
    assert optimizer.counted == [1]


def told(ask: Ask, *rows: int, given: bool = False) -> Running:
    """Return the reply that some trials of a batch are done."""
    assert ask.trials is not None
    fitness = ask.trials[list(rows)].astype("<f8").tobytes()
    return Running(
        batch=batch(ask),
        done=len(rows),
        given=given,
        trials=codec.indices(rows),
        fitness=fitness,
        seconds=float(len(rows)),
    )


# ---- servers that go


def test_batches_of_a_vanished_server_move_when_their_queries_end() -> None:
    optimizer = Optimizer()
    optimizer.join("a")
    first, second = optimizer.work(2)
    optimizer.join("b")
    assert optimizer.feed(Gone("a")) == []
    assert optimizer.notes("server_left")[0].text == "2 unanswered trials"
    assert trials(optimizer.answer(first, None)) == [0]
    assert optimizer.notes("requeued") == [Note("requeued", count=1)]
    assert trials(optimizer.answer(second, None)) == [1]
    assert optimizer.notes("server_lost")
    assert optimizer.requeued == 2


def test_empty_queries_move_their_batches_when_the_token_vanishes() -> None:
    optimizer = Optimizer()
    optimizer.join("a")
    (ask,) = optimizer.work(1)
    optimizer.join("b")
    optimizer.answer(ask, None)
    (again,) = optimizer.feed(Gone("a"))
    assert (again.server, batch(again) != batch(ask)) == ("b", True)
    assert optimizer.notes("server_lost")
    assert optimizer.wait(5.0) == []


def test_a_draining_server_still_answers_running_batches() -> None:
    optimizer = Optimizer()
    optimizer.join("a")
    first, second = optimizer.work(4)[:2]
    assert optimizer.answer(second, Refused(code="draining", reason="")) == []
    assert sorted(optimizer.dispatch.servers.roster.ready) == [], (
        "or it would be asked and refuse in a loop until its token vanishes"
    )
    optimizer.feed(Gone("a"))
    optimizer.answer(first, outcomes(first))
    assert optimizer.counted == [0]
    assert optimizer.notes("server_lost")
    optimizer.join("b", slots=2)
    assert optimizer.asked["b", "evaluate"]
    assert optimizer.requeued == 1


def test_an_idle_server_that_leaves_is_dropped_and_asked_again_on_return() -> None:
    optimizer = Optimizer()
    optimizer.join("a")
    optimizer.feed(Gone("a"))
    assert optimizer.notes("server_lost")
    assert optimizer.dispatch.servers.standing().leased == 0
    assert verbs(optimizer.feed(Seen("a"))) == [("a", "offer")]


def test_a_server_that_returns_before_its_queries_end_continues() -> None:
    """The server's unfinished batch is requested again under its old number."""
    optimizer = Optimizer()
    optimizer.join("a")
    first, second = optimizer.work(2)
    optimizer.feed(Gone("a"))
    optimizer.answer(first, None)
    renew, evaluate = optimizer.feed(Seen("a"))
    assert (verb(evaluate.message), batch(evaluate), trials([evaluate])) == (
        "evaluate",
        batch(first),
        [0],
    )
    assert (verb(renew.message), renew.message.lease) == ("renew", first.message.lease)
    assert optimizer.notes("server_back")
    optimizer.answer(second, None)
    (again,) = optimizer.wait(RETRY_S[0])
    assert batch(again) == batch(second)


def left_alone(*, elsewhere: bool) -> tuple[Optimizer, list[Ask]]:
    """Cut the link to server a, which has two batches; server b may take them meanwhile."""
    optimizer = Optimizer()
    optimizer.join("a")
    left = optimizer.work(2)
    optimizer.feed(Gone("a"))
    for ask in left:
        optimizer.answer(ask, None)
    if elsewhere:
        optimizer.join("b")
    optimizer.asked.clear()
    return optimizer, left


def test_stranded_batches_are_requested_again_when_the_lease_is_restored() -> None:
    """They run once: with the same number, a server attaches to what runs, or uses its cache."""
    optimizer, left = left_alone(elsewhere=False)
    (ask,) = optimizer.feed(Seen("a"))
    (ask,) = optimizer.answer(ask, offer())
    asks = optimizer.answer(ask, lease("a", 1))
    assert sorted(
        (verb(ask.message), batch(ask), trials([ask])) for ask in asks
    ) == sorted(("evaluate", batch(ask), trials([ask])) for ask in left)
    for ask in asks:
        optimizer.answer(ask, outcomes(ask))
    assert sorted(optimizer.counted) == trials(left)
    assert Complete() in optimizer.commands


def test_stranded_batches_that_other_servers_took_are_cancelled() -> None:
    optimizer, left = left_alone(elsewhere=True)
    optimizer.join("a")
    assert sorted(optimizer.asked["a", "cancel"].message.batches) == sorted(
        batch(ask) for ask in left
    )
    optimizer.asked.clear()
    optimizer.feed(Gone("a"))
    assert verbs(optimizer.feed(Seen("a"))) == [("a", "offer")]
    assert ("a", "cancel") not in optimizer.asked, "once is enough"


def test_stranded_batches_are_sent_again_when_the_lease_ends() -> None:
    optimizer, left = left_alone(elsewhere=False)
    (ask,) = optimizer.feed(Seen("a"))
    (ask,) = optimizer.answer(ask, offer())
    asks = optimizer.answer(ask, lease("a", 1, number=1))
    assert verbs(asks) == [("a", "evaluate")] * 2
    assert trials(asks) == [0, 1]
    assert not {batch(ask) for ask in asks} & {batch(ask) for ask in left}


def test_stranded_batches_of_an_ended_workload_are_cancelled() -> None:
    optimizer, left = left_alone(elsewhere=False)
    optimizer.work(1)
    optimizer.join("a")
    assert sorted(optimizer.asked["a", "cancel"].message.batches) == sorted(
        batch(ask) for ask in left
    )


@pytest.mark.parametrize("phase", ["offer", "reserve"])
def test_an_answer_from_before_a_disconnect_is_not_mistaken_for_a_new_one(
    phase: str,
) -> None:
    optimizer = Optimizer()
    (ask,) = optimizer.feed(Seen("a"))
    reply: Reply = offer()
    if phase == "reserve":
        (ask,) = optimizer.answer(ask, offer())
        reply = lease("a", 1)
    optimizer.feed(Gone("a"))
    assert optimizer.commands == []
    assert optimizer.answer(ask, reply) == []
    assert optimizer.dispatch.servers.standing().leased == 0
    assert verbs(optimizer.feed(Seen("a"))) == [("a", "offer")]


def test_the_end_of_an_unknown_server_is_ignored() -> None:
    optimizer = Optimizer()
    assert optimizer.feed(Gone("a")) == []
    assert optimizer.commands == []


# ---- refusals of batches


def test_a_busy_server_is_asked_for_its_slots_after_a_pause() -> None:
    optimizer = Optimizer()
    optimizer.join("a")
    (ask,) = optimizer.work(1)
    for _ in range(3):
        assert optimizer.answer(ask, Refused(code="busy", reason="")) == []
        assert optimizer.wait(PAUSE_S - 0.01) == []
        asks = optimizer.wait(0.02)
        assert sorted(verbs(asks)) == [("a", "evaluate"), ("a", "renew")]
        assert optimizer.answer(optimizer.asked["a", "renew"], lease("a", 1)) == []
        assert not optimizer.notes("server_joined")
        ask = optimizer.asked["a", "evaluate"]


def test_a_batch_that_a_busy_server_refused_moves_at_once() -> None:
    optimizer = Optimizer()
    optimizer.join("a")
    (ask,) = optimizer.work(1)
    optimizer.join("b")
    assert verbs(optimizer.answer(ask, Refused(code="busy", reason=""))) == [
        ("b", "evaluate")
    ]


def test_a_batch_that_every_server_refuses_ends_the_run_with_the_reason() -> None:
    optimizer = Optimizer()
    optimizer.join("a", "b", "c")
    (ask,) = optimizer.work(1)
    for _ in range(2):
        (ask,) = optimizer.answer(
            ask, Refused(code="malformed", reason="a genome has 3 bytes")
        )
    assert (
        optimizer.answer(ask, Refused(code="malformed", reason="a genome has 3 bytes"))
        == []
    )
    (failed,) = [command for command in optimizer.commands if isinstance(command, Failed)]
    assert failed.reason.endswith(
        "on c: refused: a genome has 3 bytes (trial 0, its seed 0)"
    )


def test_a_server_that_cannot_hold_our_batches_is_released_and_not_used() -> None:
    optimizer = Optimizer()
    optimizer.join("a")
    first, _ = optimizer.work(2)
    optimizer.join("b")
    asks = optimizer.answer(first, Refused(code="mismatch", reason="no"))
    assert verbs(asks) == [("a", "release"), ("b", "evaluate"), ("b", "evaluate")]
    assert trials(asks) == [0, 1]
    assert optimizer.notes("server_refused")[0].text == "no"


def wrong_batch(ask: Ask) -> Reply:
    return Outcomes(batch=batch(ask) + 1, fitness=b"\0" * 8, metrics=b"", seconds=1.0)


def wrong_size(ask: Ask) -> Reply:
    return outcomes(ask, 1.0, 2.0)


def wrong_kind(ask: Ask) -> Reply:
    return Done()


def infinite(ask: Ask) -> Reply:
    return outcomes(ask, float("inf"))


def early_nonsense(ask: Ask) -> Reply:
    return told(ask, 0, 0)


def no_trial_of_it(ask: Ask) -> Reply:
    return Fault(
        batch=batch(ask),
        kind="crashed",
        trial=0,
        reason="",
        trials=codec.indices([9]),
        fitness=bytes(8),
    )


@pytest.mark.parametrize(
    "reply",
    [wrong_batch, wrong_size, wrong_kind, infinite, early_nonsense, no_trial_of_it],
)
def test_a_server_that_answers_a_batch_with_nonsense_is_released_and_not_used(
    reply: object,
) -> None:
    optimizer = Optimizer()
    optimizer.join("a", "b")
    (ask,) = optimizer.work(1)
    asks = optimizer.answer(ask, reply(ask))  # type: ignore[operator]
    assert verbs(asks) == [("a", "release"), ("b", "evaluate")]
    assert optimizer.notes("malformed")
    assert optimizer.counted == []


# ---- batches


def test_every_server_gets_a_batch_before_any_gets_a_second() -> None:
    """A batch of long trials has one for each slot, which the server hands out."""
    optimizer = Optimizer()
    optimizer.join("a", "b", slots=2)
    asks = optimizer.work(8)
    assert [(ask.server, trials([ask])) for ask in asks] == [
        ("a", [0, 1]),
        ("b", [2, 3]),
        ("a", [4, 5]),
    ]
    assert optimizer.dispatch.batches.queue.count == 2, "less than one for each slot"


def test_each_server_has_two_batches_in_flight_and_an_answer_brings_the_next() -> None:
    optimizer = Optimizer()
    optimizer.join("a", "b")
    asks = optimizer.work(20)
    assert verbs(asks) == [("a", "evaluate"), ("b", "evaluate")] * 2
    assert verbs(optimizer.answer(asks[1], outcomes(asks[1]))) == [("b", "evaluate")]


def sizes(optimizer: Optimizer, count: int, *, trial_s: float) -> list[int]:
    """Return the sizes of a workload's batches in the order in which they are sent."""
    asks, found = optimizer.work(count), []
    while asks:
        ask = asks.pop(0)
        found.append(len(ask.trials))  # type: ignore[arg-type]
        asks += optimizer.answer(ask, outcomes(ask, seconds=trial_s))
    assert sum(found) == count
    return found


def test_batches_are_of_75_ms_for_each_slot_and_shrink_towards_the_end_but_not_below_3_ms() -> (
    None
):
    optimizer = Optimizer()
    optimizer.join("a", "b", slots=2, trial_s=0.001)
    found = sizes(optimizer, 2000, trial_s=0.001)
    assert found[0] == 150
    assert found == sorted(found[:-1], reverse=True) + found[-1:]
    assert found[-2] == 6


def test_a_single_server_gets_all_trials_in_few_batches() -> None:
    optimizer = Optimizer()
    optimizer.join("a", slots=2, trial_s=0.001)
    assert sizes(optimizer, 400, trial_s=0.001) == [150, 150, 100]
    assert sizes(optimizer, 37, trial_s=0.001) == [37]


def test_the_number_of_messages_depends_on_the_work_and_not_on_slots() -> None:
    """Servers of four slots take no more messages than servers of one."""
    counts = []
    for slots in (1, 4):
        optimizer = Optimizer(slots=256)
        optimizer.join(*[f"s{number}" for number in range(64)], slots=slots)
        counts.append(len(sizes(optimizer, 64 * slots * 4, trial_s=1.0)))
    assert counts[0] == counts[1] == 64 * 4


@pytest.mark.parametrize("verify", [0.0, 1.0])
def test_the_work_of_a_workload_grows_with_its_trials_and_not_with_their_square(
    verify: float,
) -> None:
    """Counted in Python's instructions, with a message for every trial."""

    def of(count: int) -> int:
        optimizer = Optimizer(verify=verify)
        optimizer.join("a", "b", "c")
        return instructions(lambda: play(optimizer, count))

    def play(optimizer: Optimizer, count: int) -> None:
        asks = deque(optimizer.work(count))
        while asks:
            ask = asks.popleft()
            asks += optimizer.answer(ask, outcomes(ask))
        assert optimizer.dispatch.batches.checks.verified == verify * count

    assert of(160) < 5 * of(40)


def test_the_time_of_a_trial_is_measured_instead_of_taken_from_the_probe() -> None:
    optimizer = Optimizer()
    optimizer.join("a", trial_s=0.0075)
    asks = optimizer.work(1000)
    assert len(asks[0].trials) == 10  # type: ignore[arg-type]
    for _ in range(30):
        asks += optimizer.answer(asks[0], outcomes(asks.pop(0), seconds=0.015))
    assert len(asks[0].trials) == 5  # type: ignore[arg-type]
    optimizer.wait(RENEW_S)
    optimizer.answer(optimizer.asked["a", "renew"], lease("a", 1, trial_s=0.0075))
    (ask,) = optimizer.answer(asks[0], outcomes(asks[0], seconds=0.015))
    assert len(ask.trials) == 5  # type: ignore[arg-type]


def test_trials_of_unknown_length_go_one_by_one() -> None:
    optimizer = Optimizer()
    optimizer.join("a", trial_s=0.0)
    assert [len(ask.trials) for ask in optimizer.work(1000)] == [1, 1]  # type: ignore[arg-type]


def test_a_batch_fits_into_a_message_even_with_large_genomes() -> None:
    optimizer = Optimizer()
    optimizer.join("a", trial_s=1e-6)
    genomes = [b"small", *[b"x" * 1_000_000] * 99]
    (first, _) = optimizer.feed(
        Work(
            Workload(genomes, np.arange(100).reshape(-1, 1), np.zeros(100, np.uint64), 0)
        )
    )
    sent, _, _ = optimizer.workload.batch(first.trials)  # type: ignore[arg-type]
    assert sum(map(len, sent)) < 8 << 20


def test_outcomes_with_many_metrics_fit_into_a_message() -> None:
    """A message that is too large is dropped at every request: the run would not continue."""
    optimizer = Optimizer(metrics=1000)
    optimizer.join("a", slots=64, trial_s=1e-4)
    count = 1500
    asks = optimizer.feed(
        Work(
            Workload([b"g"], np.zeros((count, 1), int), np.zeros(count, np.uint64), 1000)
        )
    )
    told = len(asks[0].trials)  # type: ignore[arg-type]
    assert told > 64
    answer = Outcomes(
        batch=batch(asks[0]),
        fitness=bytes(8 * told),
        metrics=bytes(8000 * told),
        seconds=1.0,
    )
    assert len(codec.encode(answer)) <= MAX_MESSAGE


def test_a_batch_holds_the_genomes_its_trials_need_and_indices_into_these() -> None:
    workload = Workload(
        [b"a", b"b", b"c", b"d"],
        np.array([[0, 3], [3, 2], [2, 2]]),
        np.array([7, 8, 9], np.uint64),
        0,
    )
    genomes, participants, seeds = workload.batch(np.array([1, 2]))
    assert (genomes, participants.tolist(), seeds.tolist()) == (
        [b"c", b"d"],
        [[1, 0], [0, 0]],
        [8, 9],
    )


# ---- counting


def test_outcomes_are_stored_by_trial_in_any_order_of_arrival() -> None:
    optimizer = Optimizer()
    optimizer.join("a", "b", "c", "d")
    asks = optimizer.work(4)
    workload = optimizer.workload
    for ask, fitness in zip(reversed(asks), (1.5, NAN, 3.5, 4.5), strict=True):
        assert Complete() not in optimizer.commands
        optimizer.answer(ask, outcomes(ask, fitness))
    assert Complete() in optimizer.commands
    assert not optimizer.notes("simulator_raised")
    placed = [ask.trials[0] for ask in reversed(asks)]  # type: ignore[index]
    assert np.array_equal(
        workload.fitness[placed, 0], [1.5, NAN, 3.5, 4.5], equal_nan=True
    )
    assert workload.counted.all()
    assert not workload.faulted.any()


def test_every_nan_is_the_same_nan() -> None:
    optimizer = Optimizer()
    optimizer.join("a")
    (ask,) = optimizer.work(1)
    workload = optimizer.workload
    negative = Outcomes(
        batch=batch(ask), fitness=b"\1\0\0\0\0\0\xff\xff", metrics=b"", seconds=1.0
    )
    optimizer.answer(ask, negative)
    assert workload.fitness.tobytes() == np.array(NAN).tobytes()


def test_metrics_are_stored_by_index_and_simulator_errors_are_reported() -> None:
    optimizer = Optimizer(slots=1, metrics=2)
    optimizer.join("a")
    workload = Workload([b"g"], np.zeros((1, 1), int), np.zeros(1, np.uint64), 2)
    (ask,) = optimizer.feed(Work(workload))
    numbers = np.array([NAN, 4.0, NAN], "<f8").tobytes()
    optimizer.answer(
        ask,
        Outcomes(
            batch=batch(ask),
            fitness=numbers[:8],
            metrics=numbers[8:],
            seconds=1.0,
            error="ValueError: x",
        ),
    )
    assert np.array_equal(workload.metrics, [[4.0, NAN]], equal_nan=True)
    assert optimizer.notes("simulator_raised") == [
        Note("simulator_raised", "a", "ValueError: x", 1)
    ]
    assert optimizer.counted == [0]


def test_what_trials_leave_behind_is_reported_once() -> None:
    optimizer = Optimizer(slots=1)
    optimizer.join("a")
    asks = optimizer.work(3)
    texts = ["a file open (x)", "a file open (y); 1 thread running", "1 thread running"]
    notes: list[Note] = []
    for text in texts:
        ask = asks.pop(0)
        reply = msgspec.structs.replace(outcomes(ask, 1.0), left=text)
        asks += optimizer.answer(ask, reply)
        notes += optimizer.notes("simulator_left")
    assert notes == [
        Note("simulator_left", "a", "a file open (x)"),
        Note("simulator_left", "a", "1 thread running"),
    ]


def test_counting_a_trial_twice_is_a_bug() -> None:
    optimizer = Optimizer()
    optimizer.join("a")
    (ask,) = optimizer.work(1)
    optimizer.workload.counted[0] = True
    with pytest.raises(LocalProtocolError):
        optimizer.answer(ask, outcomes(ask))


def test_an_answer_that_comes_twice_counts_once() -> None:
    optimizer = Optimizer()
    optimizer.join("a")
    first = optimizer.work(3)[0]
    optimizer.answer(first, outcomes(first))
    assert optimizer.answer(first, outcomes(first)) == []
    assert optimizer.counted == [0]


def test_counted_trials_are_not_evaluated() -> None:
    optimizer = Optimizer()
    optimizer.join("a", slots=4)
    workload = Workload([b"g"], np.zeros((4, 1), int), np.zeros(4, np.uint64), 0)
    workload.counted[[0, 2]] = True
    assert trials(optimizer.feed(Work(workload))) == [1, 3]


def test_a_workload_with_nothing_to_evaluate_is_complete() -> None:
    optimizer = Optimizer()
    optimizer.work(0)
    assert optimizer.commands == [Complete()]


def test_a_generation_without_new_evaluations_is_complete() -> None:
    """A population of two has no new candidate, for example."""
    optimizer = Optimizer()
    optimizer.join("a")
    assert (
        optimizer.feed(
            Work(Workload([], np.zeros((0, 1), int), np.zeros(0, np.uint64), 0))
        )
        == []
    )
    assert optimizer.commands == [Complete()]


def test_outcomes_of_an_earlier_workload_are_late() -> None:
    optimizer = Optimizer()
    optimizer.join("a")
    old = optimizer.work(4)
    cancel, *new = optimizer.work(4)
    assert (verb(cancel.message), cancel.message.batches) == (
        "cancel",
        [batch(ask) for ask in old],
    )
    for ask in old:
        assert optimizer.answer(ask, outcomes(ask, 99.0)) == []
    assert optimizer.counted == []
    optimizer.answer(new[0], outcomes(new[0]))
    assert optimizer.counted == [0]


def test_the_second_workload_starts_right_after_the_first() -> None:
    optimizer = Optimizer()
    optimizer.join("a")
    for _ in range(3):
        (ask,) = optimizer.work(1)
        assert optimizer.answer(ask, outcomes(ask)) == []
        assert optimizer.commands[-1] == Complete()
    assert optimizer.requeued == 0


# ---- faults


def test_a_fault_blames_one_trial_and_the_others_are_sent_again() -> None:
    optimizer = Optimizer(quarantine=True)
    optimizer.join("a", trial_s=0.01)
    asks = optimizer.work(40)
    workload = optimizer.workload
    poison = 5
    while asks:
        ask = asks.pop(0)
        assert ask.trials is not None
        if poison in ask.trials:
            asks += optimizer.answer(ask, fault(ask, ask.trials.tolist().index(poison)))
        else:
            asks += optimizer.answer(ask, outcomes(ask, seconds=0.01))
    assert sorted(optimizer.counted) == list(range(40))
    assert np.flatnonzero(workload.faulted).tolist() == [poison]
    assert np.flatnonzero(np.isnan(workload.fitness)).tolist() == [poison]


def test_finished_trials_of_a_batch_that_ends_in_a_fault_are_counted() -> None:
    optimizer = Optimizer()
    optimizer.join("a", trial_s=0.01)
    (ask,) = optimizer.work(4)
    done = {
        "trials": codec.indices([0, 3]),
        "fitness": np.array([1.0, 4.0]).tobytes(),
        "seconds": 0.02,
    }
    asks = optimizer.answer(
        ask, Fault(batch=batch(ask), kind="crashed", trial=1, reason="killed", **done)
    )  # type: ignore[arg-type]
    assert optimizer.counted == [0, 3]
    assert trials(asks) == [1, 2]
    assert optimizer.requeued == 2


def test_a_fault_of_a_finished_trial_is_attributed_to_another() -> None:
    """No server sends this; it must not leave a trial without a server."""
    optimizer = Optimizer()
    optimizer.join("a", trial_s=0.01)
    (ask,) = optimizer.work(2)
    done = {"trials": codec.indices([0]), "fitness": bytes(8), "seconds": 0.01}
    asks = optimizer.answer(
        ask, Fault(batch=batch(ask), kind="crashed", trial=0, reason="", **done)
    )  # type: ignore[arg-type]
    assert (optimizer.counted, trials(asks)) == ([0], [1])


def test_a_fault_with_all_outcomes_blames_no_trial() -> None:
    """Which no server says, either; the workload is complete."""
    optimizer = Optimizer()
    optimizer.join("a")
    (ask,) = optimizer.work(1)
    done = {"trials": codec.indices([0]), "fitness": bytes(8), "seconds": 1.0}
    assert (
        optimizer.answer(
            ask, Fault(batch=batch(ask), kind="crashed", trial=0, reason="", **done)
        )
        == []
    )  # type: ignore[arg-type]
    assert optimizer.commands[-1] == Complete()


def test_a_fault_is_tried_on_servers_where_it_did_not_happen() -> None:
    optimizer = Optimizer()
    optimizer.join("a", "b", "c")
    asks, where = optimizer.work(1), []
    while asks:
        where.append(asks[0].server)
        asks = optimizer.answer(asks[0], fault(asks[0]))
    assert sorted(where) == ["a", "b", "c"]
    assert any(isinstance(command, Failed) for command in optimizer.commands)


def test_a_fault_is_retried_on_the_same_server_if_it_is_the_only_one() -> None:
    optimizer = Optimizer()
    optimizer.join("a")
    (ask,) = optimizer.work(1)
    for attempt in range(1, ATTEMPTS):
        (ask,) = optimizer.answer(ask, fault(ask))
        assert ask.server == "a"
        assert (
            optimizer.notes("fault")[0].text
            == f"crashed: killed (trial 0, its seed 0, attempt {attempt})"
        )
    assert optimizer.answer(ask, fault(ask)) == []
    (failed,) = [command for command in optimizer.commands if isinstance(command, Failed)]
    assert "3 times, last on a: crashed: killed" in failed.reason


def test_a_trial_that_waits_for_another_server_does_not_delay_others() -> None:
    """It waits for a place on the other server; what comes after it in the line does not."""
    optimizer = Optimizer()
    optimizer.join("a", "b")
    asks = optimizer.work(50)
    on_a = [ask for ask in asks if ask.server == "a"]
    (next_on_a,) = optimizer.answer(on_a[0], fault(on_a[0]))
    assert next_on_a.server == "a"
    assert trials([next_on_a]) != trials([on_a[0]])
    on_b = next(ask for ask in asks if ask.server == "b")
    assert trials(optimizer.answer(on_b, outcomes(on_b))) == trials([on_a[0]])


def test_a_failing_run_cancels_its_batches() -> None:
    optimizer = Optimizer()
    optimizer.join("a")
    first, second = optimizer.work(2)
    for _ in range(ATTEMPTS):
        asks = optimizer.answer(first, fault(first))
        first = asks[0]
    assert verbs(asks) == [("a", "cancel")]
    assert asks[0].message.batches == [batch(second)]
    assert optimizer.answer(second, outcomes(second)) == []


def test_a_failing_run_forgets_servers_that_left() -> None:
    optimizer = Optimizer()
    optimizer.join("a", "b")
    asks = optimizer.work(2)
    gone, failing = sorted(asks, key=lambda ask: ask.server)
    optimizer.feed(Gone("a"))
    for _ in range(ATTEMPTS):
        failing = (optimizer.answer(failing, fault(failing)) or [failing])[0]
    assert optimizer.notes("server_lost")
    assert optimizer.answer(gone, None) == []
    assert verbs(optimizer.feed(Seen("a"))) == [("a", "offer")]


def test_every_workload_has_its_own_attempts() -> None:
    optimizer = Optimizer()
    optimizer.join("a")
    for _ in range(ATTEMPTS):
        (ask,) = optimizer.work(1)
        (ask,) = optimizer.answer(ask, fault(ask))
        optimizer.answer(ask, outcomes(ask))
        assert Complete() in optimizer.commands


def test_a_fault_of_a_moved_batch_blames_no_trial() -> None:
    optimizer = Optimizer()
    optimizer.join("a")
    first, second = optimizer.work(2)
    optimizer.answer(first, Refused(code="lease-lost", reason="expired"))
    assert optimizer.answer(second, fault(second)) == []
    assert optimizer.commands == []
