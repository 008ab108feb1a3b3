"""The line of trials that wait."""

import numpy as np

from zswarm.ot.cluster.queue import QueuedTrials, TrialQueue
from zswarm.ot.cluster.remote_server import RemoteServer, SentBatch

A, B, C = RemoteServer("a"), RemoteServer("b"), RemoteServer("c")
BOTH = {"a": A, "b": B}


def batch(server: RemoteServer, number: int) -> SentBatch:
    return SentBatch(server, number, np.array([]), np.array([]), 0)


def line(*pieces: QueuedTrials) -> TrialQueue:
    """Return a queue of these pieces with the first one in front."""
    waiting = TrialQueue()
    for piece in reversed(pieces):
        waiting.put(piece)
    return waiting


def piece(
    *trials: int, avoid: str = "", stranded: SentBatch | None = None
) -> QueuedTrials:
    return QueuedTrials(np.array(trials), frozenset(avoid), stranded)


def taken(
    waiting: TrialQueue,
    server: str,
    size: int = 100,
    ready: dict[str, RemoteServer] = BOTH,
) -> list[int] | None:
    """Return the trials that a server gets."""
    found = waiting.take(server, size, ready)
    return None if found is None else list(found.trials)


def test_a_server_gets_the_first_trials_and_never_from_two_chunks() -> None:
    waiting = line(piece(1, 2, 3), piece(4, 5))
    assert [taken(waiting, "a", 2) for _ in range(4)] == [[1, 2], [3], [4, 5], None]
    assert waiting.count == 0


def test_returned_trials_are_handed_out_first() -> None:
    waiting = line(piece(1, 2))
    waiting.put(piece(7))
    assert waiting.count == 3
    assert taken(waiting, "a") == [7]


def test_a_failed_trial_waits_for_another_server_without_delaying_others() -> None:
    waiting = line(piece(1, avoid="a"), piece(2))
    assert [taken(waiting, "a"), taken(waiting, "a"), taken(waiting, "b")] == [
        [2],
        None,
        [1],
    ]


def test_a_trial_that_failed_on_all_serving_servers_may_go_anywhere() -> None:
    waiting = line(piece(1, avoid="ab"))
    assert taken(waiting, "a", ready={**BOTH, "c": C}) is None
    assert taken(waiting, "a", ready={"a": A}) == [1]


def test_a_part_of_a_chunk_avoids_the_same_servers() -> None:
    waiting = line(piece(1, 2, avoid="a"))
    part = waiting.take("b", 1, BOTH)
    assert part is not None
    assert part.avoid == {"a"}
    assert (taken(waiting, "a"), taken(waiting, "b")) == (None, [2])


def test_another_server_takes_a_piece_of_a_stranded_batch_and_the_rest_is_as_any() -> (
    None
):
    """Its server, when it is back, is to cancel the batch: that is possible as a whole only."""
    stranded = batch(A, 7)
    waiting = line(piece(1, 2, 3, stranded=stranded))
    found = waiting.take("b", 1, BOTH)
    assert found is not None
    assert (list(found.trials), found.stranded) == ([1], stranded)
    assert waiting.stranded(A) == []
    found = waiting.take("b", 5, BOTH)
    assert found is not None
    assert (list(found.trials), found.stranded) == ([2, 3], None)


def test_stranded_batches_stay_with_their_server_until_another_takes_them() -> None:
    own = piece(3, 4, stranded=batch(A, 9))
    waiting = line(
        piece(1, stranded=batch(A, 7)), piece(2, stranded=batch(B, 8)), own, piece(5)
    )
    assert taken(waiting, "b") == [1]
    assert waiting.stranded(A) == [waiting.entries[1]]
    waiting.remove(waiting.entries[1])
    assert waiting.stranded(A) == []
    assert waiting.count == 2


def test_a_cleared_line_is_empty_and_names_the_stranded_batches() -> None:
    first, second = batch(A, 7), batch(B, 8)
    waiting = line(piece(1, stranded=first), piece(2), piece(3, stranded=second))
    assert waiting.clear() == [first, second]
    assert (waiting.count, taken(waiting, "a")) == (0, None)
