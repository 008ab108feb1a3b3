"""Bugs that are planted to see that the schedules find them."""

from collections.abc import Callable

import numpy as np
import pytest

from zswarm.ot.cluster.allotment import Allotment
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
from zswarm.ss.slots.leases import LeaseTable
from zswarm.ss.slots.reply_cache import ReplyCache
from zswarm.ss.slots.sharing import Sharing, divide
from zswarm.ss.slots.state import HeldLease


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


def a_first_copy_is_never_cancelled(patch: pytest.MonkeyPatch) -> None:
    """Leave a server at work of which another one was the first to send all outcomes."""
    patch.setattr(
        Batches, "_overtaken", lambda _, batch: batch.server.batches.pop(batch.id)
    )


def a_lent_slot_never_returns(patch: pytest.MonkeyPatch) -> None:
    """Take a lease that lent slots for idle, also when it has work again."""
    idle = HeldLease.idle
    patch.setattr(
        HeldLease, "idle", lambda self, *times: self.lent > 0 or idle(self, *times)
    )


def slots_are_taken_from_nobody(patch: pytest.MonkeyPatch) -> None:
    """Let those who came first keep their slots."""
    patch.setattr(LeaseTable, "_take_back", lambda *_: [])


def a_paused_run_keeps_its_slots(patch: pytest.MonkeyPatch) -> None:
    """Ask for no slots while the run pauses, but release none."""
    patch.setattr(Allotment, "surplus", lambda _: None)


def users_are_ignored(patch: pytest.MonkeyPatch) -> None:
    """Share among runs, whoever they belong to."""

    def by_run(
        line: list[HeldLease], capacity: int, wanted: Callable[[HeldLease], int]
    ) -> dict[HeldLease, int]:
        shares = divide(capacity, [wanted(lease) for lease in line])
        return dict(zip(line, shares, strict=True))

    patch.setattr("zswarm.ss.slots.sharing._by_user", by_run)


def runs_are_ignored(patch: pytest.MonkeyPatch) -> None:
    """Give all slots of a user to the run that stands first in line."""

    def first_come(count: int, wanted: list[int]) -> list[int]:
        shares = []
        for want in wanted:
            shares.append(min(want, count))
            count -= shares[-1]
        return shares

    def by_user(
        line: list[HeldLease], capacity: int, wanted: Callable[[HeldLease], int]
    ) -> dict[HeldLease, int]:
        users: dict[str, list[HeldLease]] = {}
        for lease in line:
            users.setdefault(lease.user, []).append(lease)
        wants = {user: [wanted(lease) for lease in own] for user, own in users.items()}
        parts = divide(capacity, [sum(each) for each in wants.values()])
        shares: dict[HeldLease, int] = {}
        for (user, own), part in zip(users.items(), parts, strict=True):
            shares |= zip(own, first_come(part, wants[user]), strict=True)
        return shares

    patch.setattr("zswarm.ss.slots.sharing._by_user", by_user)


def leases_do_not_rotate(patch: pytest.MonkeyPatch) -> None:
    """Never end a turn."""
    patch.setattr(Sharing, "_turn_s", lambda *_: 1e9)


def turns_go_by_name(patch: pytest.MonkeyPatch) -> None:
    """Begin each turn with the same leases."""
    patch.setattr(Sharing, "_place", lambda _self, _used, name: (0.0, name.encode()))


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
    a_first_copy_is_never_cancelled,
    a_lent_slot_never_returns,
    slots_are_taken_from_nobody,
    a_paused_run_keeps_its_slots,
    users_are_ignored,
    runs_are_ignored,
    leases_do_not_rotate,
    turns_go_by_name,
    a_machine_is_each_of_its_ids,
    a_server_verifies_its_machine,
    a_ban_ends_with_the_program,
]
