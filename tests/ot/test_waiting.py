"""The line of trials that wait."""

import numpy as np

from zswarm.ot.waiting import Piece, Waiting

BOTH = ["a", "b"]


def line(*pieces: Piece) -> Waiting:
    """With these pieces, the first one in front."""
    waiting = Waiting()
    for piece in reversed(pieces):
        waiting.put(piece.trials, piece.avoid, piece.left)
    return waiting


def piece(*trials: int, avoid: str = "", left: tuple[str, int] | None = None) -> Piece:
    return Piece(np.array(trials), frozenset(avoid), left)


def taken(waiting: Waiting, server: str, size: int = 100, serving: list[str] = BOTH) -> list[int] | None:
    """The trials that a server gets."""
    found = waiting.take(server, size, serving)
    return None if found is None else list(found.trials)


def test_a_server_gets_so_many_trials_from_the_front_and_never_of_two_pieces() -> None:
    waiting = line(piece(1, 2, 3), piece(4, 5))
    assert [taken(waiting, "a", 2) for _ in range(4)] == [[1, 2], [3], [4, 5], None]
    assert waiting.trials == 0


def test_what_comes_back_is_given_out_first() -> None:
    waiting = line(piece(1, 2))
    waiting.put(np.array([7]))
    assert waiting.trials == 3
    assert taken(waiting, "a") == [7]


def test_a_trial_that_failed_on_a_server_waits_for_another_one_and_holds_nobody_up() -> None:
    waiting = line(piece(1, avoid="a"), piece(2))
    assert [taken(waiting, "a"), taken(waiting, "a"), taken(waiting, "b")] == [[2], None, [1]]


def test_a_trial_that_failed_on_all_that_serve_goes_anywhere() -> None:
    waiting = line(piece(1, avoid="ab"))
    assert taken(waiting, "a", serving=["a", "b", "c"]) is None
    assert taken(waiting, "a", serving=["a"]) == [1]


def test_a_part_of_a_piece_avoids_the_same_servers() -> None:
    waiting = line(piece(1, 2, avoid="a"))
    part = waiting.take("b", 1, BOTH)
    assert part is not None
    assert part.avoid == {"a"}
    assert (taken(waiting, "a"), taken(waiting, "b")) == (None, [2])


def test_what_a_server_was_left_with_goes_elsewhere_whole() -> None:
    """Its batch there can be cancelled as a whole only."""
    waiting = line(piece(1, 2, 3, left=("a", 7)))
    found = waiting.take("b", 1, BOTH)
    assert found is not None
    assert (list(found.trials), found.left) == ([1, 2, 3], ("a", 7))


def test_what_a_server_was_left_with_is_its_own_again_until_somebody_took_it() -> None:
    waiting = line(piece(1, left=("a", 7)), piece(2, left=("b", 8)), piece(3, 4, left=("a", 9)), piece(5))
    assert taken(waiting, "b") == [1]
    assert [(batch, list(found.trials)) for batch, found in waiting.take_left("a")] == [(9, [3, 4])]
    assert waiting.take_left("a") == []
    assert waiting.trials == 2


def test_what_is_forgotten_waits_on_as_any_other() -> None:
    waiting = line(piece(1, 2, left=("a", 7)), piece(3, left=("b", 8)))
    waiting.forget_left("a")
    assert waiting.take_left("a") == []
    assert taken(waiting, "a", 1) == [1]
    assert waiting.clear() == [("b", 8)]


def test_a_cleared_line_is_empty_and_names_who_was_left_with_what() -> None:
    waiting = line(piece(1, left=("a", 7)), piece(2), piece(3, left=("b", 8)))
    assert waiting.clear() == [("a", 7), ("b", 8)]
    assert (waiting.trials, taken(waiting, "a")) == (0, None)
