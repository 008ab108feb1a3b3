"""Answers that are kept."""

import pytest

from zswarm.ss import kept
from zswarm.ss.kept import Kept


def still(answers: Kept, *keys: tuple[bytes, int]) -> list[bool]:
    return [key in answers._answers for key in keys]  # without asking, which keeps them anew


def test_an_answer_is_found_by_its_lease_and_batch() -> None:
    answers = Kept()
    answers.put(b"a", 1, b"first", now=0.0)
    answers.put(b"b", 1, b"second", now=0.0)
    assert (answers.get(b"a", 1, 0.0), answers.get(b"b", 1, 0.0)) == (b"first", b"second")
    assert still(answers, (b"a", 2), (b"c", 1)) == [False, False]
    assert answers.leases() == {b"a", b"b"}


def test_answers_are_kept_up_to_a_number_of_bytes_the_oldest_dropped_first(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kept, "KEPT_BYTES", 20)
    answers = Kept()
    answers.put(b"a", 1, bytes(10), now=0.0)
    for batch in (2, 3):
        answers.put(b"b", batch, bytes(10), now=0.0)
    assert still(answers, (b"a", 1), (b"b", 2), (b"b", 3)) == [False, True, True]
    assert answers.bytes == 20


def test_the_last_answer_is_kept_however_large(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kept, "KEPT_BYTES", 20)
    answers = Kept()
    answers.put(b"a", 1, bytes(10), now=0.0)
    answers.put(b"a", 2, bytes(100), now=0.0)
    assert still(answers, (b"a", 1), (b"a", 2)) == [False, True]
    assert answers.bytes == 100


def test_answers_are_kept_for_two_minutes() -> None:
    """A run asks again when a query's time is up; for longer a server would only gather memory."""
    answers = Kept()
    answers.put(b"a", 1, b"first", now=0.0)
    answers.put(b"a", 2, b"second", now=kept.KEPT_S)
    assert still(answers, (b"a", 1), (b"a", 2)) == [True, True]
    answers.put(b"a", 3, b"third", now=kept.KEPT_S + 0.1)
    assert still(answers, (b"a", 1), (b"a", 2), (b"a", 3)) == [False, True, True]
    assert answers.bytes == len(b"second" + b"third")


def test_an_answer_that_is_asked_for_is_kept_anew() -> None:
    """It may be lost on its way again: the link that the question came by may be gone."""
    answers = Kept()
    answers.put(b"a", 1, b"first", now=0.0)
    answers.put(b"a", 2, b"second", now=0.0)
    assert answers.get(b"a", 1, kept.KEPT_S) == b"first"
    answers.put(b"a", 3, b"third", now=kept.KEPT_S + 0.1)
    assert still(answers, (b"a", 1), (b"a", 2), (b"a", 3)) == [True, False, True]
    assert answers.bytes == len(b"first" + b"third")


def test_an_ended_lease_leaves_nothing_kept() -> None:
    answers = Kept()
    for lease, batch in ((b"a", 1), (b"b", 1), (b"a", 2)):
        answers.put(lease, batch, bytes(10), now=0.0)
    answers.drop(b"a")
    assert still(answers, (b"a", 1), (b"b", 1), (b"a", 2)) == [False, True, False]
    assert (answers.leases(), answers.bytes) == ({b"b"}, 10)
    answers.drop(b"b")
    assert (answers.leases(), answers.bytes) == (set(), 0)
