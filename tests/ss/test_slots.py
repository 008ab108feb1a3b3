"""The slot table: events and plain times in, commands out."""

import itertools
from typing import TypeVar

import pytest
from counting import instructions

from zswarm.errors import LocalProtocolError
from zswarm.protocol import codec
from zswarm.protocol.messages import (
    Cancel,
    Done,
    Evaluate,
    Fault,
    Lease,
    Offer,
    Outcomes,
    Part,
    Refused,
    Release,
    Renew,
    Reply,
    Request,
    Requirements,
    Reserve,
    Running,
)
from zswarm.ss import slots
from zswarm.ss.slots import (
    Answer,
    Asked,
    Died,
    Drain,
    Drained,
    Event,
    Exhausted,
    Finished,
    HolderGone,
    HolderSeen,
    Kill,
    Prepare,
    Prepared,
    Run,
    Slots,
    Stop,
    Tick,
    Unprepared,
)

T = TypeVar("T")
OFFER = Offer(server="ss", program="0", machine="m", capacity=2, free=0, leases=0, simulators=[], representations=[])
PROBE = b"digest"
TIMEOUT_S = 10.0  # of a trial


class Server:
    """A slot table with a clock, that collects what happens to queries and slots."""

    def __init__(self, capacity: int = 2, mismatch: str = "") -> None:
        tokens = itertools.count(1)
        self.slots = Slots(capacity, OFFER, lambda _: mismatch, lambda: next(tokens).to_bytes(16, "big"))
        self.now = 100.0
        self.commands: list[object] = []  # of the last event, without answers and logs
        self.answers: dict[int, Reply] = {}
        self.queries = itertools.count(1)
        self.open: set[int] = set()
        self.trials = [0] * capacity

    def feed(self, event: Event) -> list[object]:
        """The commands for slots."""
        self.commands = []
        for command in self.slots.handle(event, self.now):
            if isinstance(command, Answer):
                assert command.query in self.open, "nobody waits for this answer"
                self.open.remove(command.query)
                self.answers[command.query] = codec.decode_reply(command.body)
            elif not isinstance(command, slots.Log):
                self.commands.append(command)
        return self.commands

    def ask(self, message: Request, run: str = "a") -> int:
        """The number of the query."""
        query = next(self.queries)
        self.open.add(query)
        self.feed(Asked(query, "user", run, message))
        return query

    def asked(self, message: Request, run: str = "a") -> Reply:
        """The answer that comes at once."""
        return self.answers[self.ask(message, run)]

    def answer(self, query: int, kind: type[T]) -> T:
        """The answer to a query, which is of this kind."""
        answer = self.answers[query]
        assert isinstance(answer, kind)
        return answer

    def reserve(self, run: str = "a", **fields: object) -> Lease:
        return self.answer(self.ask(reserve(**fields), run), Lease)

    def ready(self, run: str = "a", trial_s: float = 0.5, **fields: object) -> bytes:
        """The token of a lease whose slots are all prepared."""
        lease = self.reserve(run, **fields)
        for slot in self.slots.leases[lease.lease].slots:
            self.feed(Prepared(slot.index, PROBE, trial_s))
        return lease.lease

    def evaluate(self, lease: bytes, *batches: int, run: str = "a") -> list[int]:
        return [self.ask(evaluate(lease, batch), run) for batch in batches]

    def finish(self, slot: int, batch: int) -> list[object]:
        return self.feed(Finished(slot, codec.encode(outcomes(batch))))

    def wait(self, seconds: float, every: float = 0.25) -> list[object]:
        """Let time pass, with ticks; the commands of all of them."""
        commands: list[object] = []
        for _ in range(round(seconds / every)):
            self.now += every
            commands += self.feed(Tick(tuple(self.trials)))
        return commands

    def states(self) -> list[str]:
        return [slot.state.name for slot in self.slots.slots]


def running_one(trials: int = 1) -> tuple[Server, bytes, int]:
    """A server of one slot that runs batch 1 of a lease; the lease and the query."""
    server = Server(1)
    lease = server.ready()
    return server, lease, server.ask(evaluate(lease, 1, trials))


def reserve(nonce: int = 1, epoch: int = 0, slots: int = 100, simulator: str = "minisim", memory_mb: int = 0) -> Reserve:
    return Reserve(
        nonce=nonce.to_bytes(16, "big"), epoch=epoch, slots=slots, simulator=Part(simulator, {}),
        representation=Part("fully-meshed", {}), version_hash="", trial_timeout_s=TIMEOUT_S,
        trial_memory_mb=memory_mb,
    )  # fmt: skip


def evaluate(lease: bytes, batch: int, trials: int = 1) -> Evaluate:
    """Every trial has a genome of its own."""
    numbers = range(trials)
    return Evaluate(
        lease=lease, batch=batch, genomes=[b"%d" % number for number in numbers], participants=codec.indices(numbers),
        seeds=b"".join(number.to_bytes(8, "little") for number in numbers),
    )  # fmt: skip


def run(slot: int, lease: bytes, batch: int, first: int = 0, alone: int = -1, trials: int = 1) -> Run:
    return Run(slot, codec.encode(evaluate(lease, batch, trials)), first, alone)


def seeds(commands: list[object]) -> list[tuple[int, list[int]]]:
    """What slots are given: slot, and the seeds of the trials."""
    pieces = [(command.slot, codec.decode_request(command.body)) for command in commands if isinstance(command, Run)]
    return [(slot, codec.array(piece.seeds, "<u8").tolist()) for slot, piece in pieces if isinstance(piece, Evaluate)]


def outcomes(batch: int) -> Outcomes:
    return Outcomes(batch=batch, fitness=b"\0" * 8, metrics=b"", seconds=0.5)


def code(answer: object) -> str:
    return answer.code if isinstance(answer, Refused) else f"no refusal: {answer}"


# ---- leases and their slots ---------------------------------------------------------------------------------------


def test_an_offer_tells_what_is_free() -> None:
    server = Server()
    server.reserve(slots=1)
    offer = server.answer(server.ask(Requirements(), "b"), Offer)
    assert (offer.capacity, offer.free, offer.leases, offer.mismatch) == (2, 1, 1, "")


def test_a_mismatch_is_told_in_the_offer_and_refused_in_the_reserve() -> None:
    server = Server(mismatch="another version")
    offer = server.answer(server.ask(Requirements()), Offer)
    assert offer.mismatch == "another version"
    assert code(server.asked(reserve())) == "mismatch"
    assert not server.slots.busy()


def test_the_first_slot_plays_the_probe_and_the_others_are_prepared_after_it() -> None:
    """So one compiles, and the others find the compiled code."""
    server = Server(3)
    assert server.reserve().state == "preparing"
    assert server.commands == [Prepare(0, reserve(), probe=True)]
    assert server.feed(Prepared(0, PROBE, 0.5)) == [Prepare(1, reserve(), probe=False), Prepare(2, reserve(), probe=False)]
    server.feed(Prepared(2, b"", 0.0))
    lease = server.reserve()
    assert (lease.state, lease.slots, lease.ready, lease.probe, lease.trial_s) == ("ready", 3, 2, PROBE, 0.5)


def test_a_lease_gets_no_more_slots_than_it_wants() -> None:
    server = Server(3)
    assert server.reserve(slots=2).slots == 2
    assert server.reserve("b", slots=2).slots == 1


def test_the_same_nonce_gets_the_same_lease() -> None:
    server = Server()
    first = server.reserve(nonce=7)
    assert server.reserve(nonce=7) == first
    assert len(server.slots.leases) == 1


def test_a_run_waits_for_slots_until_another_one_releases_them() -> None:
    server = Server(1)
    first = server.ready("a")
    waiting = server.reserve("b")
    assert (waiting.state, waiting.slots) == ("waiting", 0)
    assert server.asked(Release(lease=first), "a") == Done()
    assert server.commands == [Prepare(0, reserve(), probe=True, known=True)]
    assert server.reserve("b").slots == 1


def test_a_run_that_comes_gets_its_share_of_idle_slots_at_once_and_of_others_piece_by_piece() -> None:
    """Nothing that runs is stopped; the run that gives slots back learns it from the renewal that it keeps open."""
    server = Server(4)
    first = server.ready("a")
    queries = server.evaluate(first, 1, 2, 3)
    renewal = server.ask(Renew(lease=first, known_ready=4), "a")
    lease = server.reserve("b")
    assert (lease.state, lease.slots) == ("preparing", 1), "the idle one"
    assert server.answer(renewal, Lease).ready == 3
    server.evaluate(first, 4)
    assert server.finish(0, 1) == [], "it is assigned, and waits for the first one of its lease"
    assert server.answers[queries[0]] == outcomes(1)
    assert server.finish(1, 2) == [run(1, first, 4)], "and no more than the share"
    assert [server.reserve(name).slots for name in "ab"] == [2, 2]


def test_shares_are_even_as_far_as_runs_want_slots_and_the_earlier_ones_get_what_is_left_over() -> None:
    server = Server(8)
    for name, wanted in (("a", 100), ("b", 1), ("c", 100), ("d", 100)):
        server.ready(name, slots=wanted)
    assert [server.reserve(name).slots for name in "abcd"] == [3, 1, 2, 2]


def test_what_a_run_gives_back_to_others_it_gets_again_when_these_end() -> None:
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


def test_a_slot_that_is_prepared_for_a_run_of_too_many_goes_to_another_when_that_is_done() -> None:
    server = Server(2)
    server.reserve("a", simulator="other")
    server.feed(Prepared(0, PROBE, 0.5))
    server.reserve("b")
    assert server.states() == ["PREPARING", "PREPARING"], "the idle one is prepared anew"
    server.feed(Prepared(0, PROBE, 0.5))
    assert [server.reserve(name, simulator=kind).slots for name, kind in (("a", "other"), ("b", "minisim"))] == [1, 1]


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
    assert server.commands == [Prepare(0, reserve(slots=3), probe=True, known=True)]  # its probe is not known yet
    server.ask(Release(lease=first), "a")
    assert server.feed(Prepared(0, PROBE, 0.5)) == []
    assert server.reserve("c").ready == 2


def test_a_lease_gets_the_slots_that_are_prepared_for_its_problem_first() -> None:
    server = Server(3)
    first = server.ready("a", slots=1, simulator="other")
    second = server.ready("b", slots=1)
    third = server.ready("c", slots=1, simulator="other")
    for lease, name in ((first, "a"), (second, "b"), (third, "c")):
        server.ask(Release(lease=lease), name)
    server.ask(reserve(slots=1), "d")
    assert server.commands == [Prepare(1, reserve(slots=1), probe=True, known=True)]


def test_a_slot_that_is_ready_at_once_is_told_and_takes_what_waits() -> None:
    server = Server(2)
    first = server.ready("a", slots=1)
    second = server.ready("b", slots=2)
    server.evaluate(second, 1, 2, run="b")
    renewal = server.ask(Renew(lease=second, known_ready=1), "b")
    server.ask(Release(lease=first), "a")
    assert server.commands == [run(0, second, 2)]
    answer = server.answer(renewal, Lease)
    assert answer.ready == 2


def test_a_slot_that_could_not_be_prepared_is_not_taken_for_prepared() -> None:
    server = Server(2)
    server.reserve("a", slots=1)
    server.reserve("b", slots=2)
    server.feed(Prepared(1, PROBE, 0.5))
    assert server.feed(Unprepared(0, "no memory")) == [Prepare(0, reserve(slots=2), probe=False)]


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


def test_a_slot_prepared_with_another_limit_of_memory_is_prepared_anew() -> None:
    server = Server(1)
    server.ask(Release(lease=server.ready("a", memory_mb=512)), "a")
    server.ready("b", memory_mb=512)
    server.ask(reserve(memory_mb=1024, slots=1), "c")
    server.ask(Release(lease=next(iter(server.slots.leases))), "b")
    assert server.commands == [Prepare(0, reserve(memory_mb=1024, slots=1), probe=True)]


def test_a_slot_prepared_for_another_problem_is_prepared_anew() -> None:
    server = Server(2)
    first = server.ready("a", simulator="other")
    server.ask(reserve(), "b")
    server.ask(Release(lease=first), "a")
    assert server.feed(Prepared(0, PROBE, 0.5)) == [Prepare(1, reserve(), probe=False)]


def test_a_slot_released_while_it_is_prepared_is_free_when_that_ended() -> None:
    server = Server(1)
    lease = server.reserve("a").lease
    server.ask(reserve(simulator="other"), "b")
    server.ask(Release(lease=lease), "a")
    assert (server.commands, server.states()) == ([], ["STOPPING"])
    assert server.feed(Prepared(0, PROBE, 0.5)) == [Prepare(0, reserve(simulator="other"), probe=True)]


@pytest.mark.parametrize("event", [Unprepared(0, "no"), Died(0, 0, "killed"), Prepared(0, PROBE, 0.5)])
def test_however_a_preparation_ends_after_the_release_the_slot_is_free(event: Event) -> None:
    server = Server(1)
    server.ask(Release(lease=server.reserve().lease))
    server.feed(event)
    assert server.states() == ["FREE"]
    assert not server.slots.busy()


def test_a_slot_released_while_it_computes_is_told_to_stop_and_killed_after_two_seconds() -> None:
    server, lease, query = running_one()
    server.ask(Release(lease=lease))
    assert server.commands == [Stop(0)]
    assert code(server.answers[query]) == "lease-lost"
    assert server.wait(2.0) == []
    assert server.wait(0.25) == [Kill(0)]
    assert server.states() == ["FREE"]


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
    server.feed(HolderGone("user", "a"))
    for server.trials[0] in range(3):
        server.wait(10.0)
    assert not set(queries) & set(server.answers)
    assert server.wait(0.25) == [Stop(0)]
    assert [code(server.answers[query]) for query in queries] == ["lease-lost", "lease-lost"]


def test_a_lease_ends_half_a_minute_after_its_holders_token_vanished() -> None:
    server = Server()
    server.reserve()
    server.feed(HolderGone("user", "a"))
    server.wait(30.0)
    assert server.slots.leases
    server.wait(0.25)
    assert not server.slots.leases


@pytest.mark.parametrize("sign", ["token", "message"])
def test_a_sign_of_the_holder_keeps_the_lease(sign: str) -> None:
    server = Server()
    lease = server.reserve().lease
    server.feed(HolderGone("user", "a"))
    server.wait(29.0)
    if sign == "token":
        server.feed(HolderSeen("user", "a"))
    else:
        server.ask(Renew(lease=lease))
    server.wait(5.0)
    assert server.slots.leases


def test_the_token_of_another_run_says_nothing() -> None:
    server = Server()
    server.reserve()
    server.feed(HolderGone("user", "b"))
    server.feed(HolderGone("somebody", "a"))
    server.wait(31.0)
    assert server.slots.leases


@pytest.mark.parametrize(
    "message", [Renew, Release, lambda lease: evaluate(lease, 1), lambda lease: Cancel(lease=lease, batches=[])]
)
def test_a_lease_is_of_use_to_its_own_run_only(message: object) -> None:
    server = Server()
    lease = server.ready("a")
    request = message(lease=lease)  # type: ignore[operator]
    assert code(server.asked(request, "b")) == "lease-lost"
    assert server.commands == []


# ---- epochs -------------------------------------------------------------------------------------------------------


def test_a_higher_epoch_takes_the_slots_over() -> None:
    server = Server()
    old = server.ready(nonce=1, epoch=0)
    queries = [*server.evaluate(old, 1, 2, 3), server.ask(Renew(lease=old, known_ready=2))]
    lease = server.reserve(nonce=2, epoch=1)
    assert lease.lease != old
    assert server.commands == [Stop(0), Stop(1)]
    assert [code(server.answers[query]) for query in queries] == ["lease-lost"] * 4
    assert server.finish(0, 1) == [Prepare(0, reserve(nonce=2, epoch=1), probe=True, known=True)]
    assert code(server.asked(Renew(lease=old))) == "lease-lost"
    server.finish(1, 2)
    assert server.reserve(nonce=2, epoch=1).slots == 2


def test_who_takes_over_does_not_queue_behind_those_who_waited_meanwhile() -> None:
    server = Server(1)
    server.ready("a", nonce=1, epoch=0)
    server.reserve("b")
    assert server.reserve("a", nonce=2, epoch=1).slots == 1
    assert server.reserve("b").slots == 0


@pytest.mark.parametrize("epoch", [2, 3])
def test_a_lower_epoch_or_the_same_one_anew_is_refused(epoch: int) -> None:
    server = Server()
    lease = server.reserve(nonce=1, epoch=3)
    assert code(server.asked(reserve(nonce=2, epoch=epoch))) == "lease-lost"
    assert server.reserve(nonce=1, epoch=3) == lease


def test_a_lower_epoch_is_refused_after_the_lease_ended_and_the_same_one_is_not() -> None:
    server = Server()
    server.ask(Release(lease=server.ready(nonce=1, epoch=3)))
    assert code(server.asked(reserve(nonce=2, epoch=2))) == "lease-lost"
    assert server.reserve(nonce=3, epoch=3).slots == 2


def test_epochs_of_different_runs_and_users_are_apart() -> None:
    server = Server()
    server.reserve("a", slots=1, epoch=5)
    assert server.reserve("b", epoch=0).slots == 1


def test_so_many_epochs_are_remembered(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(slots, "EPOCHS", 2)
    server = Server()
    for name in ("a", "b", "a", "c"):
        server.ask(Release(lease=server.reserve(name, epoch=9).lease), name)
    assert code(server.asked(reserve(epoch=8), "a")) == "lease-lost"
    assert isinstance(server.asked(reserve(epoch=8), "b"), Lease)


# ---- renewals -----------------------------------------------------------------------------------------------------


def test_a_renewal_is_answered_when_another_number_of_slots_is_ready() -> None:
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


def test_a_renewal_is_held_for_ten_seconds_at_most_and_not_without_knowledge() -> None:
    server = Server()
    lease = server.ready()
    query = server.ask(Renew(lease=lease, known_ready=2))
    server.wait(10.0)
    assert query not in server.answers
    server.wait(0.25)
    assert query in server.answers
    assert isinstance(server.asked(Renew(lease=lease)), Lease)


# ---- batches ------------------------------------------------------------------------------------------------------


def test_one_batch_runs_and_one_waits_per_slot() -> None:
    server = Server()
    lease = server.ready()
    queries = []
    for batch, commands in ((1, [run(0, lease, 1)]), (2, [run(1, lease, 2)]), (3, []), (4, [])):
        queries += server.evaluate(lease, batch)
        assert server.commands == commands
    assert code(server.asked(evaluate(lease, 5))) == "busy"
    assert server.finish(1, 2) == [run(1, lease, 3)]
    assert server.answers[queries[1]] == outcomes(2)
    assert not {queries[0], queries[2], queries[3]} & set(server.answers)


def test_batches_wait_for_slots_that_are_prepared() -> None:
    server = Server(1)
    lease = server.reserve().lease
    server.evaluate(lease, 1)
    assert server.commands == []
    assert server.feed(Prepared(0, PROBE, 0.5)) == [run(0, lease, 1)]


def test_a_lease_without_slots_takes_no_batch() -> None:
    server = Server(1)
    server.ready("a")
    lease = server.reserve("b").lease
    assert code(server.asked(evaluate(lease, 1), "b")) == "busy"


def test_a_finished_batch_asked_again_is_answered_with_what_was_kept() -> None:
    server = Server()
    lease = server.ready()
    server.evaluate(lease, 1)
    server.finish(0, 1)
    assert server.asked(evaluate(lease, 1)) == outcomes(1)
    assert server.commands == []


@pytest.mark.parametrize("ahead", [0, 1])
def test_a_batch_asked_again_is_computed_once_and_the_last_query_gets_its_outcome(ahead: int) -> None:
    """Running (nothing ahead) or waiting (one batch ahead)."""
    server = Server(1)
    lease = server.ready()
    server.evaluate(lease, *range(ahead))
    first, second = server.evaluate(lease, 7, 7)
    assert code(server.answers[first]) == "cancelled"
    if ahead:
        assert server.finish(0, 0) == [run(0, lease, 7)]
    else:
        assert server.commands == []
    assert server.finish(0, 7) == []
    assert server.answers[second] == outcomes(7)


def test_a_long_batch_is_answered_running_whether_it_runs_or_waits_and_can_be_asked_again() -> None:
    server = Server(1)
    lease = server.ready()
    queries = server.evaluate(lease, 1, 2)
    for trial in range(4):
        server.trials = [trial]
        server.wait(7.5)
    assert not set(queries) & set(server.answers)
    server.wait(0.25)
    assert [server.answers[query] for query in queries] == [
        Running(batch=1, done=3, given=True),
        Running(batch=2, done=0),
    ]
    again = server.evaluate(lease, 1, 2)
    server.finish(0, 1)
    server.finish(0, 2)
    assert [server.answers[query] for query in again] == [outcomes(1), outcomes(2)]


def test_the_outcome_of_a_batch_nobody_asks_for_is_kept() -> None:
    server, lease, _ = running_one()
    for trial in range(5):
        server.trials = [trial]
        server.wait(7.0)
    server.finish(0, 1)
    assert server.asked(evaluate(lease, 1)) == outcomes(1)


def test_a_batch_that_is_not_kept_any_more_is_computed_again() -> None:
    server, lease, _ = running_one()
    server.finish(0, 1)
    server.slots.kept.drop(lease)
    server.evaluate(lease, 1)
    assert server.commands == [run(0, lease, 1)]


def test_an_ended_lease_leaves_nothing_kept() -> None:
    server = Server(2)
    first, second = server.ready("a", slots=1), server.ready("b", slots=1)
    server.evaluate(first, 1)
    server.finish(0, 1)
    server.evaluate(second, 1, run="b")
    server.finish(1, 1)
    server.ask(Release(lease=first), "a")
    assert server.slots.kept.leases() == {second}


def test_a_slot_that_finishes_what_it_was_not_given_is_a_bug() -> None:
    server = Server()
    server.ready()
    with pytest.raises(LocalProtocolError):
        server.finish(0, 1)


# ---- pieces -------------------------------------------------------------------------------------------------------


def played(first: int, end: int, *, trial_s: float = 0.5) -> bytes:
    """Outcomes of these trials, which say their numbers; no metrics."""
    fitness = bytes(number % 256 for number in range(first, end))
    return codec.encode(Outcomes(batch=1, fitness=fitness, metrics=b"", seconds=trial_s * (end - first)))


def test_a_batch_is_shared_by_the_slots_piece_by_piece_smaller_ones_towards_the_end() -> None:
    server = Server(2)
    lease = server.ready()
    query = server.ask(evaluate(lease, 1, 12))
    given = seeds(server.commands)
    assert given == [(0, [0, 1, 2]), (1, [3, 4, 5])]
    ends = {0: 3, 1: 6}
    for slot in itertools.cycle([0, 1]):
        first = next(trials[0] for s, trials in reversed(given) if s == slot)
        given += seeds(server.feed(Finished(slot, played(first, ends[slot]))))
        if query in server.answers:
            break
        ends = {slot: trials[-1] + 1 for slot, trials in given}
    assert [len(trials) for _, trials in given] == [3, 3, 2, 1, 1, 1, 1]
    answer = server.answer(query, Outcomes)
    assert (answer.trials, answer.fitness, answer.seconds) == (b"", bytes(range(12)), 6.0)


@pytest.mark.parametrize(("trial_s", "sizes"), [(1e-4, [19, 18]), (1e-5, [37])])
def test_little_work_is_cut_into_one_piece_for_each_idle_slot_and_very_little_not_at_all(
    trial_s: float, sizes: list[int]
) -> None:
    server = Server(2)
    lease = server.ready(trial_s=trial_s)
    server.ask(evaluate(lease, 1, 37))
    assert [len(trials) for _, trials in seeds(server.commands)] == sizes


def test_a_piece_has_the_genomes_of_its_trials_only() -> None:
    server = Server(2)
    lease = server.ready()
    server.ask(evaluate(lease, 1, 4))
    piece = codec.decode_request(server.commands[1].body)  # type: ignore[attr-defined]
    assert piece == Evaluate(
        lease=lease, batch=1, genomes=[b"1"], participants=codec.indices([0]), seeds=(1).to_bytes(8, "little")
    )  # fmt: skip


@pytest.mark.parametrize(
    "wrong", [{"seeds": b""}, {"seeds": b"", "participants": b""}, {"participants": b"\0" * 6}, {"participants": b""}]
)
def test_a_batch_that_cannot_be_cut_goes_to_a_slot_whole_which_refuses_it(wrong: dict[str, bytes]) -> None:
    server = Server(2)
    lease = server.ready()
    message = Evaluate(lease=lease, batch=1, **{"genomes": [b"g"], "participants": bytes(8), "seeds": bytes(16)} | wrong)  # type: ignore[arg-type]
    query = server.ask(message)
    whole = wrong == {"participants": b""}  # two trials that nobody plays can be cut
    assert len(server.commands) == (2 if whole else 1)
    refused = Refused(code="malformed", reason="no")
    for slot in range(len(server.commands)):
        server.feed(Finished(slot, codec.encode(refused)))
    assert server.answers[query] == refused


def test_handing_out_a_piece_costs_the_same_however_much_waits() -> None:
    """Counted in Python's instructions."""

    def of(trials: int) -> int:
        server = Server(2)
        lease = server.ready()
        server.ask(evaluate(lease, 1, trials))
        (_, [first, *others]), _ = seeds(server.commands)
        finished = Finished(0, played(first, first + len(others) + 1))
        return instructions(lambda: server.feed(finished))

    assert of(100) == of(1000)


def test_slots_that_have_nothing_to_do_have_outcomes_told_that_wait_for_others() -> None:
    """So the run sends more; the last answer has all outcomes again, for a run that did not get the first one."""
    server = Server(2)
    lease = server.ready()
    query = server.ask(evaluate(lease, 1, 2))
    server.now += 5.0
    server.feed(Finished(1, played(1, 2)))
    assert query not in server.answers
    assert server.slots.next_time() == server.now + slots.HUNGRY_S
    server.now += slots.HUNGRY_S
    server.feed(Tick((0, 0)))
    told = Running(batch=1, done=1, given=True, trials=codec.indices([1]), fitness=b"\1", seconds=0.5)
    assert server.answers[query] == told
    assert server.slots.next_time() == float("inf")
    again = server.ask(evaluate(lease, 1, 2))
    server.wait(5.0)
    assert again not in server.answers, "once"
    server.feed(Finished(0, played(0, 1)))
    assert server.answers[again] == Outcomes(batch=1, fitness=b"\0\1", metrics=b"", seconds=1.0)


def test_outcomes_are_not_told_early_while_something_waits_or_is_sent_at_once() -> None:
    server = Server(2)
    lease = server.ready()
    server.ask(evaluate(lease, 1, 2))
    server.feed(Finished(1, played(1, 2)))
    server.evaluate(lease, 2, 3)
    assert server.slots.next_time() == float("inf")


def test_a_fault_ends_its_batch_when_the_other_slots_are_done_and_their_outcomes_are_told() -> None:
    server = Server(3)
    lease = server.ready()
    query = server.ask(evaluate(lease, 1, 9))
    assert seeds(server.commands) == [(0, [0, 1]), (1, [2, 3]), (2, [4])]
    server.finish(2, 1)
    assert server.feed(Died(1, 1, "crash"))[0] == Prepare(1, reserve(), probe=False)
    assert query not in server.answers
    assert server.feed(Finished(0, played(0, 2))) == [], "nothing more of it is handed out"
    server.feed(Died(2, 0, "crash"))
    answer = server.answer(query, Fault)
    assert (answer.trial, answer.trials) == (3, codec.indices([0, 1, 4]))
    assert server.asked(evaluate(lease, 1, 9)) == answer


def test_a_cancelled_batch_is_stopped_in_all_slots_and_answered_when_all_have_ended() -> None:
    server = Server(2)
    lease = server.ready()
    query = server.ask(evaluate(lease, 1, 8))
    server.ask(Cancel(lease=lease, batches=[1]))
    assert server.commands == [Stop(0), Stop(1)]
    assert server.finish(0, 1) == []
    assert query not in server.answers
    server.finish(1, 1)
    assert code(server.answers[query]) == "cancelled"


def test_what_a_draining_server_began_of_a_batch_is_told() -> None:
    server = Server(2)
    lease = server.ready()
    query = server.ask(evaluate(lease, 1, 8))
    server.feed(Drain())
    server.feed(Finished(0, played(0, 2)))
    assert Drained() in server.feed(Finished(1, played(2, 4)))
    answer = server.answer(query, Outcomes)
    assert (answer.trials, answer.fitness) == (codec.indices(range(4)), bytes(range(4)))


# ---- cancelling ---------------------------------------------------------------------------------------------------


def test_a_cancelled_batch_that_waits_is_refused_at_once() -> None:
    server = Server(1)
    lease = server.ready()
    queries = server.evaluate(lease, 1, 2)
    assert server.asked(Cancel(lease=lease, batches=[2, 99])) == Done()
    assert code(server.answers[queries[1]]) == "cancelled"
    assert server.commands == []
    assert server.finish(0, 1) == []


def test_a_cancelled_batch_that_runs_is_stopped_and_its_outcome_is_worth_nothing() -> None:
    server = Server(1)
    lease = server.ready()
    queries = server.evaluate(lease, 1, 2)
    server.ask(Cancel(lease=lease, batches=[1]))
    assert server.commands == [Stop(0)]
    server.ask(Cancel(lease=lease, batches=[1]))
    assert server.commands == []
    assert server.finish(0, 1) == [run(0, lease, 2)]
    assert code(server.answers[queries[0]]) == "cancelled"
    server.finish(0, 2)
    server.evaluate(lease, 1)
    assert server.commands == [run(0, lease, 1)], "what was cut short must not be kept"


def test_a_cancelled_batch_that_goes_on_is_killed_and_blamed_on_nobody() -> None:
    server = Server(1)
    lease = server.ready()
    queries = server.evaluate(lease, 1, 2)
    server.wait(5.0)
    server.ask(Cancel(lease=lease, batches=[1]))
    server.trials = [7]
    assert server.wait(2.0) == []
    assert server.wait(0.25) == [Kill(0), Prepare(0, reserve(), probe=False)]
    assert code(server.answers[queries[0]]) == "cancelled"
    assert server.feed(Prepared(0, b"", 0.0)) == [run(0, lease, 2)]


def test_a_process_that_dies_with_a_cancelled_batch_is_no_fault() -> None:
    server, lease, query = running_one()
    server.ask(Cancel(lease=lease, batches=[1]))
    assert server.feed(Died(0, 0, "crash")) == [Prepare(0, reserve(), probe=False)]
    assert code(server.answers[query]) == "cancelled"


def test_cancelled_batches_that_still_run_take_no_room_from_new_ones() -> None:
    server = Server(1)
    lease = server.ready()
    server.evaluate(lease, 1, 2)
    server.ask(Cancel(lease=lease, batches=[1, 2]))
    queries = server.evaluate(lease, 3, 4)
    assert not set(queries) & set(server.answers)
    assert code(server.asked(evaluate(lease, 5))) == "busy"
    assert server.finish(0, 1) == [run(0, lease, 3)]


# ---- faults -------------------------------------------------------------------------------------------------------


def test_a_process_that_dies_blames_one_trial_and_is_prepared_anew() -> None:
    server = Server(1)
    lease = server.ready()
    queries = server.evaluate(lease, 1, 2)
    assert server.feed(Died(0, 3, "killed by signal 11")) == [Prepare(0, reserve(), probe=False)]
    fault = Fault(batch=1, kind="crashed", trial=3, reason="simulator minisim: killed by signal 11")
    assert server.answers[queries[0]] == fault
    assert server.asked(evaluate(lease, 1)) == fault
    assert server.feed(Prepared(0, b"", 0.0)) == [run(0, lease, 2)]


def test_a_trial_that_takes_too_long_is_killed_and_blamed() -> None:
    server, _lease, query = running_one()
    for server.trials[0] in range(2):
        assert server.wait(TIMEOUT_S) == []
    assert server.wait(0.5) == [Kill(0), Prepare(0, reserve(), probe=False)]
    answer = server.answer(query, Fault)
    assert (answer.batch, answer.kind, answer.trial) == (1, "timeout", 1)


def test_a_fault_of_a_batch_nobody_asks_for_is_kept() -> None:
    server, lease, _ = running_one()
    for server.trials[0] in range(4):
        server.wait(8.0)
    server.feed(Died(0, 3, "crash"))
    assert isinstance(server.asked(evaluate(lease, 1)), Fault)


def test_an_idle_slot_whose_process_dies_is_prepared_anew() -> None:
    server = Server(1)
    lease = server.ready()
    assert server.feed(Died(0, 0, "killed")) == [Prepare(0, reserve(), probe=False)]
    server.evaluate(lease, 1)
    assert server.feed(Prepared(0, b"", 0.0)) == [run(0, lease, 1)]


def test_a_free_slot_whose_process_died_is_not_taken_for_prepared() -> None:
    server = Server(2)
    first = server.ready("a", slots=1)
    server.ready("b", slots=2)
    server.ask(Release(lease=first), "a")
    assert server.reserve("b").ready == 2
    server.feed(Died(0, 0, "killed"))
    assert server.reserve("b").ready == 1


def test_a_run_that_shares_does_without_the_slot_alone_that_could_not_be_prepared() -> None:
    """Not without those, too, that others have for now."""
    server = Server(6)
    lease = server.ready("a")
    other = server.ready("b")
    assert [server.reserve(name).slots for name in "ab"] == [3, 3]
    broken = server.slots.leases[lease].slots[0].index
    for _ in range(1 + slots.PREPARE_ATTEMPTS):  # the first one while it is idle
        server.feed(Died(broken, 0, "killed"))
    server.ask(Release(lease=other), "b")
    assert server.reserve("a").slots == 5


def test_a_problem_that_cannot_be_prepared_fails_the_lease_and_frees_its_slots() -> None:
    server = Server(1)
    lease = server.reserve("a").lease
    server.ask(reserve(simulator="other"), "b")
    queries = [*server.evaluate(lease, 1), server.ask(Renew(lease=lease, known_ready=0))]
    assert server.feed(Unprepared(0, "no such map")) == [Prepare(0, reserve(simulator="other"), probe=True)]
    assert code(server.answers[queries[0]]) == "mismatch"
    renewed = server.answer(queries[1], Lease)
    assert (renewed.state, renewed.reason, renewed.slots) == ("failed", "no such map", 0)
    assert server.asked(evaluate(lease, 2)) == Refused(code="mismatch", reason="no such map")
    assert isinstance(server.asked(Renew(lease=lease, known_ready=0)), Lease), "a failed lease holds no renewal"
    assert server.asked(Release(lease=lease)) == Done()


def test_a_process_that_dies_while_it_is_prepared_is_tried_three_times() -> None:
    server = Server()
    server.reserve()
    for _ in range(2):
        assert server.feed(Died(0, 0, "killed")) == [Prepare(0, reserve(), probe=True)]
    assert server.feed(Died(0, 0, "killed")) == []
    lease = server.reserve()
    assert lease.state == "failed"
    assert "killed" in lease.reason
    assert server.states() == ["FREE", "FREE"]


def test_a_slot_that_cannot_be_prepared_is_given_up_while_the_others_go_on() -> None:
    server = Server()
    lease = server.reserve().lease
    server.feed(Prepared(0, PROBE, 0.5))
    (query,) = server.evaluate(lease, 1)
    for _ in range(2):
        assert server.feed(Died(1, 0, "no memory")) == [Prepare(1, reserve(), probe=False)]
    assert server.feed(Died(1, 0, "no memory")) == []
    assert server.states() == ["BUSY", "FREE"]
    server.finish(0, 1)
    assert server.answers[query] == outcomes(1)
    assert server.reserve().slots == 1


def test_the_last_slot_of_a_lease_is_not_given_up() -> None:
    server = Server(1)
    server.ready()
    for _ in range(4):
        server.feed(Died(0, 0, "no memory"))
    assert server.reserve().state == "failed"


def test_deaths_of_a_slot_that_was_ready_between_do_not_add_up() -> None:
    server = Server(1)
    server.ready()
    for _ in range(5):
        assert server.feed(Died(0, 0, "killed")) == [Prepare(0, reserve(), probe=False)]
        server.feed(Died(0, 0, "killed"))
        server.feed(Prepared(0, b"", 0.0))
    assert server.reserve().state == "ready"


@pytest.mark.parametrize("released", [False, True])
def test_a_preparation_that_does_not_end_is_killed(released: bool) -> None:
    server = Server(1)
    lease = server.reserve().lease
    server.ask(Renew(lease=lease, known_ready=0))
    if released:
        server.ask(Release(lease=lease))
    limit_s = slots.PREPARE_S + (0 if released else slots.PROBE_GENOMES * slots.PROBE_SEEDS * reserve().trial_timeout_s)
    for _ in range(20):
        server.ask(Renew(lease=lease, known_ready=0))
        assert server.wait(limit_s / 20) == []
    assert server.wait(0.25) == [Kill(0)]
    assert server.states() == ["FREE"]
    assert released or server.reserve().state == "failed"


# ---- memory -------------------------------------------------------------------------------------------------------


def some(first: int, end: int) -> Outcomes:
    """Outcomes of some trials of batch 1, which took a second each; trial 2 raised."""
    return Outcomes(
        batch=1, fitness=bytes(range(first, end)), metrics=bytes(range(end, first, -1)), seconds=float(end - first),
        error="no way" if first <= 2 < end else "",
    )  # fmt: skip


def test_a_trial_that_takes_all_memory_is_blamed() -> None:
    server, _lease, query = running_one()
    assert server.feed(Died(0, 4, "more than 512 MB", "memory")) == [Prepare(0, reserve(), probe=False)]
    assert server.answers[query] == Fault(batch=1, kind="memory", trial=4, reason="simulator minisim: more than 512 MB")


def test_a_worn_process_is_replaced_before_the_next_batch_and_nobody_is_blamed() -> None:
    server = Server(1)
    lease = server.ready()
    queries = server.evaluate(lease, 1, 2)
    renewal = server.ask(Renew(lease=lease, known_ready=1))
    assert server.feed(Finished(0, codec.encode(outcomes(1)), worn=True)) == [Kill(0), Prepare(0, reserve(), probe=False)]
    assert server.answers[queries[0]] == outcomes(1)
    answer = server.answer(renewal, Lease)
    assert answer.ready == 0
    assert server.feed(Prepared(0, b"", 0.0)) == [run(0, lease, 2)]


def test_another_slot_goes_on_while_a_worn_one_is_replaced() -> None:
    server = Server(2)
    lease = server.ready()
    server.evaluate(lease, 1, 2, 3, 4)
    assert server.feed(Finished(0, codec.encode(outcomes(1)), worn=True)) == [Kill(0), Prepare(0, reserve(), probe=False)]
    assert server.finish(1, 2) == [run(1, lease, 3)]


def test_a_worn_process_of_an_ended_lease_is_not_taken_for_prepared() -> None:
    server = Server(2)
    lease = server.ready("a", slots=1)
    server.ready("b", slots=2)
    server.evaluate(lease, 1)
    server.ask(Release(lease=lease))
    assert server.feed(Finished(0, codec.encode(outcomes(1)), worn=True)) == [
        Kill(0),
        Prepare(0, reserve(slots=2), probe=False),
    ]


def test_a_batch_that_its_process_has_no_memory_for_goes_on_where_it_stopped_and_is_answered_whole() -> None:
    server = Server(1)
    lease = server.ready(trial_s=1e-6)
    query = server.ask(evaluate(lease, 1, 8))
    (second,) = server.evaluate(lease, 2)
    assert server.feed(Exhausted(0, some(0, 0), 0, alone=5)) == [Kill(0), Prepare(0, reserve(), probe=False)]
    assert server.feed(Prepared(0, b"", 0.0)) == [run(0, lease, 1, first=0, alone=5, trials=8)], "before the batch that waits"
    server.feed(Exhausted(0, some(0, 5), 5, alone=5))
    assert server.feed(Prepared(0, b"", 0.0)) == [run(0, lease, 1, first=5, alone=5, trials=8)]
    assert not {query, second} & set(server.answers)
    assert server.feed(Finished(0, codec.encode(some(5, 8)))) == [run(0, lease, 2)]
    whole = Outcomes(
        batch=1, fitness=bytes(range(8)), metrics=bytes([5, 4, 3, 2, 1, 8, 7, 6]), seconds=8.0, error="no way"
    )  # fmt: skip
    assert server.answers[query] == whole
    assert server.asked(evaluate(lease, 1)) == whole


def test_another_slot_that_is_ready_goes_on_with_it() -> None:
    server = Server(2)
    lease = server.ready()
    server.ask(evaluate(lease, 1))
    assert server.feed(Exhausted(0, some(0, 0), 0, alone=0)) == [
        Kill(0),
        Prepare(0, reserve(), probe=False),
        run(1, lease, 1, alone=0),
    ]


def test_the_trials_before_are_counted_when_the_rest_of_a_batch_ends_in_a_fault_or_is_refused() -> None:
    server = Server(1)
    lease = server.ready(trial_s=1e-6)
    query = server.ask(evaluate(lease, 1, 4))
    server.feed(Exhausted(0, some(0, 2), 2, alone=2))
    server.feed(Prepared(0, b"", 0.0))
    server.feed(Died(0, 2, "more than 512 MB", "memory"))
    answer = server.answer(query, Fault)
    assert (answer.trial, answer.trials, answer.fitness, answer.seconds) == (2, codec.indices([0, 1]), bytes([0, 1]), 2.0)
    query = server.ask(evaluate(lease, 2, 4))
    server.feed(Prepared(0, b"", 0.0))
    server.feed(Exhausted(0, some(0, 2), 2, alone=2))
    server.feed(Prepared(0, b"", 0.0))
    refused = Refused(code="malformed", reason="it does not fit")
    server.feed(Finished(0, codec.encode(refused)))
    assert server.answers[query] == refused


@pytest.mark.parametrize(("end", "why"), [("cancel", "cancelled"), ("release", "lease-lost"), ("drain", "")])
def test_a_batch_that_ended_meanwhile_does_not_go_on(end: str, why: str) -> None:
    server = Server(1)
    lease = server.ready(trial_s=1e-6)
    query = server.ask(evaluate(lease, 1, 4))
    match end:
        case "cancel":
            server.ask(Cancel(lease=lease, batches=[1]))
        case "release":
            server.ask(Release(lease=lease))
        case "drain":
            server.feed(Drain())
    commands = server.feed(Exhausted(0, some(0, 2), 2, alone=-1))
    assert commands[0] == Kill(0)
    if end == "drain":
        assert server.answer(query, Outcomes).trials == codec.indices([0, 1]), "what was played is not lost"
    else:
        assert code(server.answers[query]) == why
    assert (Drained() in commands) == (end == "drain")
    if end == "cancel":
        assert server.feed(Prepared(0, b"", 0.0)) == []


def test_a_batch_that_goes_on_is_held_like_one_that_waits() -> None:
    server = Server(1)
    lease = server.ready(trial_s=1e-6)
    query = server.ask(evaluate(lease, 1, 4))
    server.feed(Exhausted(0, some(0, 2), 2, alone=-1))
    server.wait(30.0)
    assert query not in server.answers
    server.wait(0.25)
    answer = server.answer(query, Running)
    assert (answer.done, answer.given, answer.trials, answer.fitness) == (2, False, codec.indices([0, 1]), bytes([0, 1]))
    (again,) = server.evaluate(lease, 1)
    server.feed(Prepared(0, b"", 0.0))
    server.feed(Finished(0, codec.encode(some(2, 4))))
    assert isinstance(server.answers[again], Outcomes)


def test_a_slot_that_is_exhausted_by_what_it_was_not_given_is_a_bug() -> None:
    server = Server(1)
    server.ready()
    with pytest.raises(LocalProtocolError):
        server.feed(Exhausted(0, some(0, 1), 1, alone=-1))


# ---- draining -----------------------------------------------------------------------------------------------------


def test_a_server_with_nothing_to_do_drains_at_once() -> None:
    server = Server()
    server.ready()
    assert server.feed(Drain()) == [Drained()]


def test_draining_finishes_what_runs_and_answers_all_that_is_asked() -> None:
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


def test_slots_that_get_free_while_the_server_drains_go_to_nobody() -> None:
    server = Server(2)
    first, second = server.ready("a", slots=1), server.ready("b", slots=1)
    server.reserve("c")
    server.evaluate(first, 1)
    server.feed(Drain())
    server.ask(Release(lease=second), "b")
    assert server.commands == []
    assert server.reserve("c").slots == 0


def test_a_server_that_stood_still_blames_no_trial() -> None:
    """A laptop that slept, a stopped process: its workers stood still as well, and get their time."""
    server, lease, _ = running_one()
    server.wait(TIMEOUT_S - 1.0)
    server.now += 50.0
    server.ask(Renew(lease=lease, known_ready=0))
    assert server.wait(0.75) == []
    assert server.wait(0.75)[0] == Kill(0)


# ---- what is counted


def test_trials_are_counted_when_their_outcomes_are_there() -> None:
    """Of the lease and of all; with the time that slots spent on them. What is refused or cancelled is none."""
    server = Server(1)
    lease = server.ready()
    server.evaluate(lease, 1, 2)
    server.now += 0.5
    server.finish(0, 1)
    held = server.slots.leases[lease]
    assert (server.slots.trials, held.trials, server.slots.seconds) == (1, 1, 0.5)
    server.now += 0.25
    server.feed(Finished(0, codec.encode(Refused(code="malformed", reason="it does not fit"))))
    assert (server.slots.trials, held.trials, server.slots.seconds) == (1, 1, 0.75)
    server.evaluate(lease, 3)
    server.ask(Cancel(lease=lease, batches=[3]))
    server.finish(0, 3)
    assert (server.slots.trials, held.trials) == (1, 1)
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
