"""Jobs: how a batch is cut into chunks, answered, cancelled, and retried without memory."""

import itertools

import msgspec
import pytest

from tests.instruction_count import instructions
from tests.ss.slots.table_server import (
    PROBE,
    Server,
    code,
    evaluate,
    outcomes,
    played,
    reserve,
    run,
    running_one,
    seeds,
    some,
)
from zswarm.errors import LocalProtocolError
from zswarm.protocol import codec
from zswarm.protocol.messages import (
    Cancel,
    Done,
    Evaluate,
    Fault,
    Lease,
    Outcomes,
    Refused,
    Release,
    Renew,
    Running,
)
from zswarm.ss.slots import table
from zswarm.ss.slots.events import (
    Died,
    Drain,
    Drained,
    Exhausted,
    Finished,
    KillSlot,
    Prepared,
    PrepareSlot,
    StopSlot,
    Tick,
)

# ---- batches ----------------------------------------------------------------------------


def test_one_batch_runs_and_one_waits_per_slot() -> None:
    server = Server()
    lease = server.ready()
    queries = []
    for batch, commands in (
        (1, [run(0, lease, 1)]),
        (2, [run(1, lease, 2)]),
        (3, []),
        (4, []),
    ):
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


def test_a_finished_batch_asked_again_is_answered_from_the_cache() -> None:
    server = Server()
    lease = server.ready()
    server.evaluate(lease, 1)
    server.finish(0, 1)
    assert server.asked(evaluate(lease, 1)) == outcomes(1)
    assert server.commands == []


@pytest.mark.parametrize("ahead", [0, 1])
def test_a_batch_asked_again_is_computed_once_and_the_last_query_gets_its_outcome(
    ahead: int,
) -> None:
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


def test_a_long_batch_is_answered_running_whether_it_runs_or_waits_and_can_be_asked_again() -> (
    None
):
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


def test_the_outcome_of_a_batch_without_a_query_is_cached() -> None:
    server, lease, _ = running_one()
    for trial in range(5):
        server.trials = [trial]
        server.wait(7.0)
    server.finish(0, 1)
    assert server.asked(evaluate(lease, 1)) == outcomes(1)


def test_a_batch_that_is_no_longer_cached_is_computed_again() -> None:
    server, lease, _ = running_one()
    server.finish(0, 1)
    server.slots.leases.replies.drop(lease)
    server.evaluate(lease, 1)
    assert server.commands == [run(0, lease, 1)]


def test_an_ended_lease_has_no_cached_replies() -> None:
    server = Server(2)
    first, second = server.ready("a", slots=1), server.ready("b", slots=1)
    server.evaluate(first, 1)
    server.finish(0, 1)
    server.evaluate(second, 1, run="b")
    server.finish(1, 1)
    server.ask(Release(lease=first), "a")
    assert {lease for lease, _ in server.slots.leases.replies} == {second}


def test_a_slot_that_finishes_a_chunk_it_does_not_have_is_a_bug() -> None:
    server = Server()
    server.ready()
    with pytest.raises(LocalProtocolError):
        server.finish(0, 1)


# ---- chunks -----------------------------------------------------------------------------


def test_a_batch_is_cut_into_chunks_that_get_smaller_towards_the_end() -> None:
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
def test_little_work_is_one_chunk_for_each_idle_slot_and_very_little_is_not_cut(
    trial_s: float, sizes: list[int]
) -> None:
    server = Server(2)
    lease = server.ready(trial_s=trial_s)
    server.ask(evaluate(lease, 1, 37))
    assert [len(trials) for _, trials in seeds(server.commands)] == sizes


def test_a_chunk_has_only_the_genomes_of_its_trials() -> None:
    server = Server(2)
    lease = server.ready()
    server.ask(evaluate(lease, 1, 4))
    assert server.commands[1].work == Evaluate(  # type: ignore[attr-defined]
        lease=lease,
        batch=1,
        genomes=[b"1"],
        participants=codec.indices([0]),
        seeds=(1).to_bytes(8, "little"),
    )


@pytest.mark.parametrize(
    "wrong",
    [
        {"seeds": b""},
        {"participants": b"\0" * 6},
        {"participants": b""},
    ],
)
def test_a_malformed_batch_goes_to_one_slot_whole_which_refuses_it(
    wrong: dict[str, bytes],
) -> None:
    server = Server(2)
    lease = server.ready()
    message = Evaluate(
        lease=lease,
        batch=1,
        **{"genomes": [b"g"], "participants": bytes(8), "seeds": bytes(16)} | wrong,
    )  # type: ignore[arg-type]
    query = server.ask(message)
    whole = wrong == {"participants": b""}  # two trials that nobody plays can be cut
    assert len(server.commands) == (2 if whole else 1)
    refused = Refused(code="malformed", reason="no")
    for slot in range(len(server.commands)):
        server.feed(Finished(slot, refused))
    assert server.answers[query] == refused


def test_a_batch_is_asked_for_by_its_id_alone_or_reported_missing() -> None:
    server = Server(1)
    lease = server.ready()
    whole, again = evaluate(lease, 1), Evaluate(lease=lease, batch=1)
    missing = server.ask(again)
    assert server.answers[missing].code == "unknown-batch"  # type: ignore[union-attr]
    first = server.ask(whole)
    assert len(server.commands) == 1
    second = server.ask(again)
    assert server.answers[first] == Refused(code="cancelled", reason="asked again")
    server.feed(Finished(0, outcomes(1)))
    assert server.answers[second] == server.answers[server.ask(again)]


def test_handing_out_a_chunk_takes_constant_time() -> None:
    """The test counts Python's instructions."""

    def of(trials: int) -> int:
        server = Server(2)
        lease = server.ready()
        server.ask(evaluate(lease, 1, trials))
        (_, [first, *others]), _ = seeds(server.commands)
        finished = Finished(0, played(first, first + len(others) + 1))
        return instructions(lambda: server.feed(finished))

    assert of(100) == of(1000)


def test_outcomes_are_reported_early_when_slots_are_idle() -> None:
    """The run can then send more; the last answer repeats all outcomes, in case one is lost."""
    server = Server(2)
    lease = server.ready()
    query = server.ask(evaluate(lease, 1, 2))
    server.now += 5.0
    server.feed(Finished(1, played(1, 2)))
    assert query not in server.answers
    assert server.slots.next_time() == server.now + table.IDLE_S
    server.now += table.IDLE_S
    server.feed(Tick((0, 0)))
    told = Running(
        batch=1, done=1, given=True, trials=codec.indices([1]), fitness=b"\1", seconds=0.5
    )
    assert server.answers[query] == told
    assert server.slots.next_time() == float("inf")
    again = server.ask(evaluate(lease, 1, 2))
    server.wait(5.0)
    assert again not in server.answers, "once"
    server.feed(Finished(0, played(0, 1)))
    assert server.answers[again] == Outcomes(
        batch=1, fitness=b"\0\1", metrics=b"", seconds=1.0
    )


def test_the_end_of_a_short_trial_is_awaited_before_outcomes_are_reported() -> None:
    server = Server(2)
    query = server.ask(evaluate(server.ready(trial_s=0.02), 1, 2))
    server.feed(Finished(1, played(1, 2, trial_s=0.02)))
    assert server.slots.next_time() == pytest.approx(server.now + table.IDLE_S + 0.02)
    server.now += table.IDLE_S
    server.feed(Tick((0, 0)))
    assert query not in server.answers
    server.now = server.slots.next_time()
    server.feed(Tick((0, 0)))
    assert isinstance(server.answers[query], Running)


def test_outcomes_are_not_reported_early_while_slots_have_work() -> None:
    server = Server(2)
    lease = server.ready()
    server.ask(evaluate(lease, 1, 2))
    server.feed(Finished(1, played(1, 2)))
    server.evaluate(lease, 2, 3)
    assert server.slots.next_time() == float("inf")


def test_a_fault_ends_its_batch_when_the_other_slots_are_done() -> None:
    server = Server(3)
    lease = server.ready()
    query = server.ask(evaluate(lease, 1, 9))
    assert seeds(server.commands) == [(0, [0, 1]), (1, [2, 3]), (2, [4])]
    server.finish(2, 1)
    assert server.feed(Died(1, 1, "crash"))[0] == PrepareSlot(1, reserve())
    assert query not in server.answers
    assert server.feed(Finished(0, played(0, 2))) == [], (
        "nothing more of it is handed out"
    )
    server.feed(Died(2, 0, "crash"))
    answer = server.answer(query, Fault)
    assert (answer.trial, answer.trials) == (3, codec.indices([0, 1, 4]))
    assert server.asked(evaluate(lease, 1, 9)) == answer


def test_a_cancelled_batch_is_stopped_in_all_slots_and_answered_when_all_have_ended() -> (
    None
):
    server = Server(2)
    lease = server.ready()
    query = server.ask(evaluate(lease, 1, 8))
    server.ask(Cancel(lease=lease, batches=[1]))
    assert server.commands == [StopSlot(0), StopSlot(1)]
    assert server.finish(0, 1) == []
    assert query not in server.answers
    server.finish(1, 1)
    assert code(server.answers[query]) == "cancelled"


def test_a_draining_server_reports_the_finished_part_of_a_batch() -> None:
    server = Server(2)
    lease = server.ready()
    query = server.ask(evaluate(lease, 1, 8))
    server.feed(Drain())
    server.feed(Finished(0, played(0, 2)))
    assert Drained() in server.feed(Finished(1, played(2, 4)))
    answer = server.answer(query, Outcomes)
    assert (answer.trials, answer.fitness) == (codec.indices(range(4)), bytes(range(4)))


# ---- cancelling -------------------------------------------------------------------------


def test_a_waiting_batch_is_refused_at_once_when_cancelled() -> None:
    server = Server(1)
    lease = server.ready()
    queries = server.evaluate(lease, 1, 2)
    assert server.asked(Cancel(lease=lease, batches=[2, 99])) == Done()
    assert code(server.answers[queries[1]]) == "cancelled"
    assert server.commands == []
    assert server.finish(0, 1) == []


def test_a_running_batch_is_stopped_when_cancelled_and_its_outcome_is_dropped() -> None:
    server = Server(1)
    lease = server.ready()
    queries = server.evaluate(lease, 1, 2)
    server.ask(Cancel(lease=lease, batches=[1]))
    assert server.commands == [StopSlot(0)]
    server.ask(Cancel(lease=lease, batches=[1]))
    assert server.commands == []
    assert server.finish(0, 1) == [run(0, lease, 2)]
    assert code(server.answers[queries[0]]) == "cancelled"
    server.finish(0, 2)
    server.evaluate(lease, 1)
    assert server.commands == [run(0, lease, 1)], "what was cut short must not be kept"


def test_a_cancelled_batch_that_does_not_stop_is_killed_without_blame() -> None:
    server = Server(1)
    lease = server.ready()
    queries = server.evaluate(lease, 1, 2)
    server.wait(5.0)
    server.ask(Cancel(lease=lease, batches=[1]))
    server.trials = [7]
    assert server.wait(2.0) == []
    assert server.wait(0.25) == [KillSlot(0), PrepareSlot(0, reserve())]
    assert code(server.answers[queries[0]]) == "cancelled"
    assert server.feed(Prepared(0, PROBE[:8], 0.0)) == [run(0, lease, 2)]


def test_a_process_that_dies_with_a_cancelled_batch_is_not_a_fault() -> None:
    server, lease, query = running_one()
    server.ask(Cancel(lease=lease, batches=[1]))
    assert server.feed(Died(0, 0, "crash")) == [PrepareSlot(0, reserve())]
    assert code(server.answers[query]) == "cancelled"


def test_cancelled_batches_that_still_run_do_not_count_as_waiting() -> None:
    server = Server(1)
    lease = server.ready()
    server.evaluate(lease, 1, 2)
    server.ask(Cancel(lease=lease, batches=[1, 2]))
    queries = server.evaluate(lease, 3, 4)
    assert not set(queries) & set(server.answers)
    assert code(server.asked(evaluate(lease, 5))) == "busy"
    assert server.finish(0, 1) == [run(0, lease, 3)]


# ---- memory -----------------------------------------------------------------------------


def test_a_trial_that_takes_all_memory_is_blamed() -> None:
    server, _lease, query = running_one()
    assert server.feed(Died(0, 4, "more than 512 MB", "memory")) == [
        PrepareSlot(0, reserve())
    ]
    assert server.answers[query] == Fault(
        batch=1, kind="memory", trial=4, reason="simulator minisim: more than 512 MB"
    )


def test_a_recycled_process_is_replaced_before_the_next_batch_without_blame() -> None:
    server = Server(1)
    lease = server.ready()
    queries = server.evaluate(lease, 1, 2)
    renewal = server.ask(Renew(lease=lease, known_ready=1))
    assert server.feed(Finished(0, outcomes(1), recycle=True)) == [
        KillSlot(0),
        PrepareSlot(0, reserve()),
    ]
    assert server.answers[queries[0]] == outcomes(1)
    answer = server.answer(renewal, Lease)
    assert answer.ready == 0
    assert server.feed(Prepared(0, PROBE[:8], 0.0)) == [run(0, lease, 2)]


def test_another_slot_continues_while_one_is_recycled() -> None:
    server = Server(2)
    lease = server.ready()
    server.evaluate(lease, 1, 2, 3, 4)
    assert server.feed(Finished(0, outcomes(1), recycle=True)) == [
        KillSlot(0),
        PrepareSlot(0, reserve()),
    ]
    assert server.finish(1, 2) == [run(1, lease, 3)]


def test_a_recycled_process_of_an_ended_lease_is_prepared_again() -> None:
    server = Server(2)
    lease = server.ready("a", slots=1)
    server.ready("b", slots=2)
    server.evaluate(lease, 1)
    server.ask(Release(lease=lease))
    assert server.feed(Finished(0, outcomes(1), recycle=True)) == [
        KillSlot(0),
        PrepareSlot(0, reserve(slots=2)),
    ]


def test_trials_after_one_that_left_something_are_played_in_a_new_process() -> None:
    """The outcome of that one counts, and what was left is reported."""
    server, _, query = running_one(trials=4)
    work = server.slots.slots[0].chunk
    assert work is not None
    end = work.positions.stop
    assert end >= 2, "several trials are in a chunk"

    def played_one(first: int, left: str) -> Outcomes:
        one = msgspec.structs.replace(some(first, first + 1), left=left)
        return msgspec.structs.replace(one, trials=codec.indices([0]))

    assert server.feed(Finished(0, played_one(0, "a file open (x)"))) == [
        KillSlot(0),
        PrepareSlot(0, reserve()),
    ]
    assert seeds(server.feed(Prepared(0, PROBE[:8], 0.0))) == [(0, [*range(1, end)])]
    server.feed(Finished(0, played_one(1, "1 thread running")))
    server.feed(Prepared(0, PROBE[:8], 0.0))
    while query not in server.answers:
        chunk = server.slots.slots[0].chunk
        assert chunk is not None
        server.feed(Finished(0, some(chunk.positions.start, chunk.positions.stop)))
    answer = server.answer(query, Outcomes)
    assert (answer.trials, answer.fitness) == (b"", bytes(range(4)))
    assert answer.left == "a file open (x); 1 thread running"
    assert server.slots.trials == 4


def test_an_exhausted_chunk_is_split_and_the_batch_is_answered_whole() -> None:
    """No trial is to blame yet: those before it, that one alone, and those after it run again."""
    server = Server(1)
    lease = server.ready(trial_s=1e-6)
    query = server.ask(evaluate(lease, 1, 8))
    (second,) = server.evaluate(lease, 2)
    replaced = [KillSlot(0), PrepareSlot(0, reserve())]
    assert server.feed(Exhausted(0, 5)) == replaced
    prepared, expected = Prepared(0, PROBE[:8], 0.0), run(0, lease, 1, 0, 5, of=8)
    assert server.feed(prepared) == [expected], "before the batch that waits"
    assert server.feed(Finished(0, some(0, 5), recycle=True)) == replaced
    assert server.feed(prepared) == [run(0, lease, 1, 5, 6, of=8)]
    assert server.feed(Finished(0, some(5, 6))) == [run(0, lease, 1, 6, 8, of=8)]
    assert not {query, second} & set(server.answers)
    assert server.feed(Finished(0, some(6, 8))) == [run(0, lease, 2)]
    whole = Outcomes(
        batch=1,
        fitness=bytes(range(8)),
        metrics=bytes([5, 4, 3, 2, 1, 6, 8, 7]),
        seconds=8.0,
        error="no way",
    )
    assert server.answers[query] == whole
    assert server.asked(evaluate(lease, 1)) == whole


@pytest.mark.parametrize(
    ("trial", "sizes"),
    [(0, [1, 3]), (1, [1, 1, 2]), (3, [3, 1])],
    ids=["first", "inner", "last"],
)
def test_an_exhausted_chunk_is_split_around_its_trial(
    trial: int, sizes: list[int]
) -> None:
    server = Server(1)
    lease = server.ready(trial_s=1e-6)
    server.ask(evaluate(lease, 1, 4))
    server.feed(Exhausted(0, trial))
    found = []
    commands = server.feed(Prepared(0, PROBE[:8], 0.0))
    while chunks := seeds(commands):
        found += chunks
        first, end = chunks[0][1][0], chunks[0][1][-1] + 1
        commands = server.feed(Finished(0, played(first, end, trial_s=1e-6)))
    assert [len(trials) for _, trials in found] == sizes
    assert [trial for _, trials in found for trial in trials] == [0, 1, 2, 3]


def test_another_slot_that_is_ready_takes_an_exhausted_chunk() -> None:
    server = Server(2)
    lease = server.ready()
    server.ask(evaluate(lease, 1))
    assert server.feed(Exhausted(0, 0)) == [
        KillSlot(0),
        PrepareSlot(0, reserve()),
        run(1, lease, 1),
    ]


def test_outcomes_before_a_memory_fault_are_reported_and_before_a_refusal_are_not() -> (
    None
):
    server = Server(1)
    lease = server.ready(trial_s=1e-6)
    query = server.ask(evaluate(lease, 1, 4))
    server.feed(Exhausted(0, 2))
    server.feed(Prepared(0, PROBE[:8], 0.0))
    server.feed(Finished(0, some(0, 2)))
    server.feed(Died(0, 0, "more than 512 MB", "memory"))
    answer = server.answer(query, Fault)
    reported = answer.trial, answer.trials, answer.fitness, answer.seconds
    assert reported == (2, codec.indices([0, 1]), bytes([0, 1]), 2.0)
    query = server.ask(evaluate(lease, 2, 4))
    server.feed(Prepared(0, PROBE[:8], 0.0))
    server.feed(Exhausted(0, 2))
    server.feed(Prepared(0, PROBE[:8], 0.0))
    refused = Refused(code="malformed", reason="it does not fit")
    server.feed(Finished(0, refused))
    assert server.answers[query] == refused


@pytest.mark.parametrize(
    ("end", "why"),
    [("cancel", "cancelled"), ("release", "lease-lost"), ("drain", "draining")],
)
def test_an_exhausted_chunk_of_a_batch_that_ended_is_not_run_again(
    end: str, why: str
) -> None:
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
    commands = server.feed(Exhausted(0, 2))
    assert commands[0] == KillSlot(0)
    assert code(server.answers[query]) == why
    assert (Drained() in commands) == (end == "drain")
    if end == "cancel":
        assert server.feed(Prepared(0, PROBE[:8], 0.0)) == []


def test_a_draining_server_reports_finished_trials_of_an_exhausted_batch() -> None:
    server = Server(1)
    lease = server.ready(trial_s=1e-6)
    query = server.ask(evaluate(lease, 1, 4))
    server.feed(Exhausted(0, 2))
    server.feed(Prepared(0, PROBE[:8], 0.0))
    server.feed(Drain())
    assert Drained() in server.feed(Finished(0, some(0, 2)))
    assert server.answer(query, Outcomes).trials == codec.indices([0, 1])


def test_a_batch_with_a_waiting_exhausted_chunk_is_answered_like_others() -> None:
    server = Server(1)
    lease = server.ready(trial_s=1e-6)
    query = server.ask(evaluate(lease, 1, 4))
    server.feed(Exhausted(0, 2))
    server.feed(Prepared(0, PROBE[:8], 0.0))
    server.feed(Finished(0, some(0, 2), recycle=True))
    server.wait(30.0)
    assert query not in server.answers
    server.wait(0.25)
    answer = server.answer(query, Running)
    reported = answer.done, answer.given, answer.trials, answer.fitness
    assert reported == (2, False, codec.indices([0, 1]), bytes([0, 1]))
    (again,) = server.evaluate(lease, 1)
    server.feed(Prepared(0, PROBE[:8], 0.0))
    for first in (2, 3):
        server.feed(Finished(0, some(first, first + 1)))
    assert isinstance(server.answers[again], Outcomes)


def test_a_slot_that_is_exhausted_without_a_chunk_is_a_bug() -> None:
    server = Server(1)
    server.ready()
    with pytest.raises(LocalProtocolError):
        server.feed(Exhausted(0, 0))
