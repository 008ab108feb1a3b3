"""Faults change no history: every candidate is counted once, and nothing leaks.

A seed that fails names the line that replays it, such as ``make chaos SEED=17``.
"""

from collections.abc import Callable

import numpy as np
import pytest

from zswarm.ot.cluster.bans import Bans
from zswarm.ot.cluster.batches import Batches
from zswarm.ot.cluster.dispatch import Dispatch
from zswarm.ot.cluster.events import Answered, Counted
from zswarm.ot.cluster.machines import Machines
from zswarm.ot.cluster.queue import QueuedTrials
from zswarm.ot.cluster.remote_server import SentBatch
from zswarm.ot.cluster.second_starts import SecondStarts
from zswarm.ot.cluster.servers import Servers
from zswarm.protocol.messages import Outcomes
from zswarm.ss.slots.reply_cache import ReplyCache

from .schedule import play

SCHEDULES, SOME, CHUNK = 2000, 200, 50  # with ``make long``; with ``make test``
FOUND_WITHIN = 100  # schedules, a planted bug


@pytest.mark.parametrize(
    "first",
    [
        *range(0, SOME, CHUNK),
        *(
            pytest.param(first, marks=pytest.mark.long)
            for first in range(SOME, SCHEDULES, CHUNK)
        ),
    ],
)
def test_faults_do_not_change_the_history_and_nothing_leaks(first: int) -> None:
    """Something does fail in nearly all schedules, and nearly all histories can be compared."""
    ends = [play(seed) for seed in range(first, first + CHUNK)]
    for seed, end in enumerate(ends, first):
        assert end.done == end.runs, f"seed {seed}"
        assert end.histories == end.undisturbed, f"seed {seed}"
        assert (end.slots_taken, end.leases, end.unanswered, end.kept_bytes) == (
            0,
            0,
            0,
            0,
        ), f"seed {seed}"
    assert sum(end.world.faults > 0 for end in ends) > 0.7 * CHUNK
    assert sum(len(end.histories) for end in ends) > 0.7 * sum(
        len(end.runs) for end in ends
    )


def test_the_same_seed_is_the_same_schedule() -> None:
    """A failure can be replayed: all that happens is drawn from the seed."""
    first, second = play(3).world, play(3).world
    assert first.now == second.now
    assert [repr(what) for what in first.trace] == [repr(what) for what in second.trace]
    assert [repr(what) for what in first.trace] != [
        repr(what) for what in play(4).world.trace
    ]


# ---- planted bugs -----------------------------------------------------------------------


def no_dedupe(patch: pytest.MonkeyPatch) -> None:
    """Count an answer however often it comes, even if its batch was sent elsewhere."""
    answered, ask = Dispatch._answered, Batches.ask
    sent: dict[tuple[int, int], SentBatch] = {}  # by dispatch and question

    def asks(self: Batches, batch: SentBatch) -> None:
        ask(self, batch)
        sent[id(self), batch.question] = batch

    def remembers(self: Dispatch, event: Answered) -> None:
        query, batch = (
            self.out.queries.get(event.question),
            sent.get((id(self.batches), event.question)),
        )
        if (
            query
            and batch
            and self.batches.workload
            and isinstance(event.reply, Outcomes)
        ):
            self.servers.by_id[query.server].batches[batch.id] = batch
            batch.question = event.question
            batch.done[:] = False
        answered(self, event)
        if query is not None:
            self.out.queries[event.question] = query

    def counts(self: Batches, trials: np.ndarray, server: str, seconds: float) -> None:
        assert self.workload is not None
        self.uncounted -= int((~self.workload.counted[trials]).sum())
        self.workload.counted[trials] = True
        self.out.commands.append(Counted(trials, server, seconds))

    patch.setattr(Batches, "ask", asks)
    patch.setattr(Dispatch, "_answered", remembers)
    patch.setattr(Batches, "_count_once", counts)


def a_lease_is_never_freed(patch: pytest.MonkeyPatch) -> None:
    """Let the time of a lease never run out."""
    patch.setattr("zswarm.ss.slots.state.LEASE_S", 1e9)
    patch.setattr("zswarm.ss.slots.state.GRACE_S", 1e9)


def a_lost_requeue(patch: pytest.MonkeyPatch) -> None:
    """Do not queue the unanswered trials of a server again, one time in four."""
    requeue = Batches._requeue

    def loses(self: Batches, entry: QueuedTrials) -> None:
        if self.out.number() % 4:
            requeue(self, entry)

    patch.setattr(Batches, "_requeue", loses)


def a_batch_is_not_kept(patch: pytest.MonkeyPatch) -> None:
    """Compute a finished batch again when a server is asked for it again."""
    patch.setattr(ReplyCache, "put", lambda *_: None)


def a_cut_link_forgets(patch: pytest.MonkeyPatch) -> None:
    """Forget work that a returned server still has, and send it again."""
    patch.setattr(Batches, "_resume", Batches._forget_stranded)


def a_lie_is_believed(patch: pytest.MonkeyPatch) -> None:
    """Never ban a server that was found to be wrong."""
    patch.setattr(Bans, "ban", lambda *_: None)


def a_second_outcome_counts(patch: pytest.MonkeyPatch) -> None:
    """Leave a trial in its other copy when one is counted."""
    patch.setattr(SecondStarts, "counted", lambda self, *_: self.pairs.clear() or [])


def a_copy_is_cancelled_too_soon(patch: pytest.MonkeyPatch) -> None:
    """Cancel a batch of which one trial was counted elsewhere, with all others."""
    counted = SecondStarts.counted

    def ends(self: SecondStarts, batch: SentBatch, trials: list[int]) -> list[SentBatch]:
        pairs = [self.pairs[trial] for trial in trials if trial in self.pairs]
        counted(self, batch, trials)
        others = {id(one): one for pair in pairs for one in pair if one is not batch}
        return [one for one in others.values() if one.id in one.server.batches]

    patch.setattr(SecondStarts, "counted", ends)


def a_lost_copy_is_sent_again(patch: pytest.MonkeyPatch) -> None:
    """Queue the trials of a lost copy, though another server still has them."""
    patch.setattr(SecondStarts, "lost", lambda *_: None)


def a_failed_copy_is_sent_again(patch: pytest.MonkeyPatch) -> None:
    """Queue a trial that failed, though another server still has it."""
    patch.setattr(SecondStarts, "elsewhere", lambda *_: False)


def a_copy_is_of_another_trial(patch: pytest.MonkeyPatch) -> None:
    """Send the genome and seed of the next trial with a second start."""
    ask = Batches.ask

    def asks(self: Batches, batch: SentBatch) -> None:
        trials, pair = batch.trials, self.second.pairs.get(int(batch.trials[0]))
        if pair is not None and pair[1] is batch:
            assert self.workload is not None
            batch.trials = (trials + 1) % len(self.workload.seeds)
        ask(self, batch)
        batch.trials = trials

    patch.setattr(Batches, "ask", asks)


def a_machine_is_each_of_its_ids(patch: pytest.MonkeyPatch) -> None:
    """Take the servers of a machine for as many machines."""
    offered = Servers._offered
    patch.setattr(
        Servers,
        "_offered",
        lambda self, server, offer, _: offered(self, server, offer, server.id),
    )


def a_server_verifies_its_machine(patch: pytest.MonkeyPatch) -> None:
    """Let a server verify what another server of its machine counted."""
    patch.setattr(Machines, "of", lambda _self, server: server)


def a_ban_ends_with_the_program(patch: pytest.MonkeyPatch) -> None:
    """Use a machine again that an earlier program of the run banned."""
    patch.setattr(
        Machines, "after", lambda known: Machines(_by_server=dict(known.machines))
    )


PLANTED: list[Callable[[pytest.MonkeyPatch], None]] = [
    no_dedupe,
    a_lease_is_never_freed,
    a_lost_requeue,
    a_batch_is_not_kept,
    a_cut_link_forgets,
    a_lie_is_believed,
    a_second_outcome_counts,
    a_copy_is_cancelled_too_soon,
    a_lost_copy_is_sent_again,
    a_failed_copy_is_sent_again,
    a_copy_is_of_another_trial,
    a_machine_is_each_of_its_ids,
    a_server_verifies_its_machine,
    a_ban_ends_with_the_program,
]


@pytest.fixture
def planted(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    request.param(monkeypatch)


def verdict(seed: int) -> str:
    """Return what is wrong with a schedule, or ""."""
    try:
        play(seed)
    except AssertionError as error:
        return str(error)
    return ""


@pytest.mark.parametrize("planted", PLANTED, indirect=True, ids=lambda bug: bug.__name__)
@pytest.mark.usefixtures("planted")
def test_a_planted_bug_is_found_and_its_line_replays_it() -> None:
    seed = next((seed for seed in range(FOUND_WITHIN) if verdict(seed)), None)
    assert seed is not None, f"not found in {FOUND_WITHIN} schedules"
    assert verdict(seed) == verdict(seed)
    assert verdict(seed).startswith(f"make chaos SEED={seed} ")
