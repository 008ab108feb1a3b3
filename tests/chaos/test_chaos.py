"""Whatever fails, every candidate is counted once, the history is that of an undisturbed run, and nothing leaks.

A seed that fails names the line that replays it, such as ``make chaos SEED=17``.
"""

from collections.abc import Callable

import numpy as np
import pytest

from zswarm.ot.dispatch import Answered, Batch, Counted, Dispatch, Server
from zswarm.protocol.messages import Outcomes, Reply
from zswarm.ss.kept import Kept

from .schedule import play

SCHEDULES, SOME, CHUNK = 2000, 500, 50  # with ``make long``; with ``make test``
FOUND_WITHIN = 100  # schedules, a planted bug


@pytest.mark.parametrize(
    "first",
    [*range(0, SOME, CHUNK), *(pytest.param(first, marks=pytest.mark.long) for first in range(SOME, SCHEDULES, CHUNK))],
)
def test_whatever_fails_the_history_is_the_same_and_nothing_leaks(first: int) -> None:
    """Something does fail in nearly all schedules, and nearly all histories can be compared."""
    ends = [play(seed) for seed in range(first, first + CHUNK)]
    for seed, end in enumerate(ends, first):
        assert end.done == end.runs, f"seed {seed}"
        assert end.histories == end.undisturbed, f"seed {seed}"
        assert (end.slots_taken, end.leases, end.unanswered, end.kept_bytes) == (0, 0, 0, 0), f"seed {seed}"
    assert sum(end.world.faults > 0 for end in ends) > 0.7 * CHUNK
    assert sum(len(end.histories) for end in ends) > 0.7 * sum(len(end.runs) for end in ends)


def test_the_same_seed_is_the_same_schedule() -> None:
    """A failure can be replayed: all that happens is drawn from the seed."""
    first, second = play(3).world, play(3).world
    assert first.now == second.now
    assert [repr(what) for what in first.trace] == [repr(what) for what in second.trace]
    assert [repr(what) for what in first.trace] != [repr(what) for what in play(4).world.trace]


# ---- planted bugs -------------------------------------------------------------------------------------------------


def no_dedupe(patch: pytest.MonkeyPatch) -> None:
    """An answer counts however often it comes, and although its batch was given elsewhere."""
    answered, batch_answered = Dispatch._answered, Dispatch._batch_answered

    def remembers(self: Dispatch, event: Answered, now: float) -> None:
        question = self._questions.get(event.question)
        answered(self, event, now)
        if question is not None:
            self._questions[event.question] = question

    def takes(self: Dispatch, server: Server, batch: Batch, reply: Reply | None, now: float) -> None:
        if isinstance(reply, Outcomes) and self._workload is not None:
            server.batches[batch.id] = batch
        batch_answered(self, server, batch, reply, now)

    def counts(self: Dispatch, trials: np.ndarray, server: str, seconds: float) -> None:
        assert self._workload is not None
        self._rest -= int((~self._workload.counted[trials]).sum())
        self._workload.counted[trials] = True
        self._commands.append(Counted(trials, server, seconds))
        self._complete_if_done()

    patch.setattr(Dispatch, "_answered", remembers)
    patch.setattr(Dispatch, "_batch_answered", takes)
    patch.setattr(Dispatch, "_mark_counted", counts)


def a_lease_is_never_freed(patch: pytest.MonkeyPatch) -> None:
    """The time of a lease does not run out."""
    patch.setattr("zswarm.ss.slots.LEASE_S", 1e9)
    patch.setattr("zswarm.ss.slots.GRACE_S", 1e9)


def a_lost_requeue(patch: pytest.MonkeyPatch) -> None:
    """What a server did not answer is not given out again, one time in four."""
    requeue = Dispatch._requeue

    def loses(self: Dispatch, trials: np.ndarray, *arguments: object) -> None:
        if self._next % 4:
            requeue(self, trials, *arguments)  # type: ignore[arg-type]

    patch.setattr(Dispatch, "_requeue", loses)


def a_batch_is_not_kept(patch: pytest.MonkeyPatch) -> None:
    """A server that is asked again for a finished batch computes it again."""
    patch.setattr(Kept, "put", lambda *_: None)


def a_cut_link_forgets(patch: pytest.MonkeyPatch) -> None:
    """A server that is back is given anew what it still has."""

    def forgets(self: Dispatch, server: Server, now: float) -> None:
        self._end_former(server)

    patch.setattr(Dispatch, "_return_to", forgets)


def a_lie_is_believed(patch: pytest.MonkeyPatch) -> None:
    """Whoever is wrong in a dispute, nobody is found out."""
    patch.setattr(Dispatch, "_bar", lambda *_: None)


PLANTED: list[Callable[[pytest.MonkeyPatch], None]] = [
    no_dedupe, a_lease_is_never_freed, a_lost_requeue, a_batch_is_not_kept, a_cut_link_forgets, a_lie_is_believed,
]  # fmt: skip


@pytest.fixture
def planted(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    request.param(monkeypatch)


def verdict(seed: int) -> str:
    """What is wrong with a schedule, or ""."""
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
