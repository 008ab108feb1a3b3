"""Cached replies."""

import pytest

from zswarm.ss.slots import reply_cache
from zswarm.ss.slots.reply_cache import ReplyCache


def cached(replies: ReplyCache, *keys: tuple[bytes, int]) -> list[bool]:
    return [key in replies for key in keys]  # use() would mark them as new


def test_a_reply_is_found_by_its_lease_and_batch() -> None:
    replies = ReplyCache()
    replies.put(b"a", 1, b"first", now=0.0)
    replies.put(b"b", 1, b"second", now=0.0)
    assert (replies.use(b"a", 1, 0.0), replies.use(b"b", 1, 0.0)) == (b"first", b"second")
    assert cached(replies, (b"a", 2), (b"c", 1)) == [False, False]
    assert {lease for lease, _ in replies} == {b"a", b"b"}


def test_the_oldest_replies_are_dropped_beyond_a_number_of_bytes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(reply_cache, "MAX_BYTES", 20)
    replies = ReplyCache()
    replies.put(b"a", 1, bytes(10), now=0.0)
    for batch in (2, 3):
        replies.put(b"b", batch, bytes(10), now=0.0)
    assert cached(replies, (b"a", 1), (b"b", 2), (b"b", 3)) == [False, True, True]
    assert replies.size == 20


def test_the_last_reply_is_cached_regardless_of_its_size(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(reply_cache, "MAX_BYTES", 20)
    replies = ReplyCache()
    replies.put(b"a", 1, bytes(10), now=0.0)
    replies.put(b"a", 2, bytes(100), now=0.0)
    assert cached(replies, (b"a", 1), (b"a", 2)) == [False, True]
    assert replies.size == 100


def test_replies_are_cached_for_two_minutes() -> None:
    """A run asks again after a query's timeout; later replies would only take memory."""
    replies = ReplyCache()
    replies.put(b"a", 1, b"first", now=0.0)
    replies.put(b"a", 2, b"second", now=reply_cache.MAX_AGE_S)
    assert cached(replies, (b"a", 1), (b"a", 2)) == [True, True]
    replies.put(b"a", 3, b"third", now=reply_cache.MAX_AGE_S + 0.1)
    assert cached(replies, (b"a", 1), (b"a", 2), (b"a", 3)) == [False, True, True]
    assert replies.size == len(b"second" + b"third")


def test_a_reply_that_is_sent_again_is_marked_as_new() -> None:
    """It may be lost again: the link of the query may be down."""
    replies = ReplyCache()
    replies.put(b"a", 1, b"first", now=0.0)
    replies.put(b"a", 2, b"second", now=0.0)
    assert replies.use(b"a", 1, reply_cache.MAX_AGE_S) == b"first"
    replies.put(b"a", 3, b"third", now=reply_cache.MAX_AGE_S + 0.1)
    assert cached(replies, (b"a", 1), (b"a", 2), (b"a", 3)) == [True, False, True]
    assert replies.size == len(b"first" + b"third")


def test_the_replies_of_an_ended_lease_are_dropped() -> None:
    replies = ReplyCache()
    for lease, batch in ((b"a", 1), (b"b", 1), (b"a", 2)):
        replies.put(lease, batch, bytes(10), now=0.0)
    replies.drop(b"a")
    assert cached(replies, (b"a", 1), (b"b", 1), (b"a", 2)) == [False, True, False]
    assert replies.size == 10
    replies.drop(b"b")
    assert replies.size == 0
