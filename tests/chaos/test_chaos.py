"""Faults change no history: every candidate is counted once, and nothing leaks.

A seed that fails names the line that replays it, such as ``make chaos SEED=17``.
"""

from collections.abc import Callable

import pytest

from .planted import PLANTED
from .schedule import play

CHUNK = 10  # schedules of a test
# Up to which number schedules are played, with ``make test``, ``make long`` and ``make thorough``.
SOME, MORE, ALL = 10, 1250, 2000
FOUND_WITHIN = 100  # schedules, a planted bug
# Which schedule shows a bug that few do: it is played first.
SHOWN_BY = {
    "a_ban_ends_with_the_program": 61,
    "a_batch_is_not_kept": 7,
    "a_batch_may_run_for_ever": 14,
    "a_copy_is_cancelled_too_soon": 35,
    "a_failed_copy_is_sent_again": 9,
    "a_lent_slot_never_returns": 40,
    "a_lost_copy_is_sent_again": 81,
    "a_machine_is_each_of_its_ids": 23,
    "a_question_without_deadline": 6,
    "a_server_verifies_its_machine": 23,
    "turns_go_by_name": 8,
    "users_are_ignored": 40,
}


@pytest.mark.parametrize(
    "seed",
    [
        pytest.param(8474590806985, id="a-stalled-server-is-asked-for-slots-first"),
        pytest.param(250336794969056, id="what-failed-waits-for-a-stalled-server"),
        pytest.param(40994407654989, id="a-machine-verifies-itself-after-a-ban"),
        pytest.param(19267978361669, id="who-has-too-many-slots-gets-a-free-one"),
    ],
)
def test_rare_faults_stay_mended(seed: int) -> None:
    """About one schedule in a thousand shows one of these."""
    play(seed)


@pytest.mark.parametrize(
    "first",
    [
        *range(0, SOME, CHUNK),
        *(
            pytest.param(first, marks=pytest.mark.long)
            for first in range(SOME, MORE, CHUNK)
        ),
        *(
            pytest.param(first, marks=pytest.mark.thorough)
            for first in range(MORE, ALL, CHUNK)
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


def verdict(seed: int) -> str:
    """Return what is wrong with a schedule, or ""."""
    try:
        play(seed)
    except AssertionError as error:
        return str(error)
    return ""


@pytest.mark.parametrize("bug", PLANTED, ids=lambda bug: bug.__name__)
def test_a_planted_bug_is_found_and_its_line_replays_it(
    bug: Callable[[pytest.MonkeyPatch], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    bug(monkeypatch)
    seeds = [SHOWN_BY.get(bug.__name__, 0), *range(FOUND_WITHIN)]
    verdicts = ((seed, verdict(seed)) for seed in seeds)
    seed, found = next((each for each in verdicts if each[1]), (0, ""))
    assert found, f"not found in {FOUND_WITHIN} schedules"
    assert verdict(seed) == found
    assert found.startswith(f"make chaos SEED={seed} ")
