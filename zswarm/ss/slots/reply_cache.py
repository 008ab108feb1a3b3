"""Cached replies to finished batches, for a run that asks again because a reply was lost."""

from collections import OrderedDict

MAX_BYTES = 64 << 20
# A run asks again at the latest when its query times out, after 60 s.
MAX_AGE_S = 120.0


class ReplyCache(OrderedDict[tuple[bytes, int], tuple[bytes, float]]):
    """Replies with the time of their last use, by lease and batch; the oldest is first.

    When there are too many bytes, or they are too old, the oldest are dropped.
    """

    size = 0  # bytes

    def put(self, lease: bytes, batch: int, reply: bytes, now: float) -> None:
        """Add the reply to a new batch; the last one is cached however large it is."""
        self[lease, batch] = (reply, now)
        self.size += len(reply)
        while len(self) > 1:
            oldest, used_at = next(iter(self.values()))
            if self.size <= MAX_BYTES and used_at >= now - MAX_AGE_S:
                break
            self.popitem(last=False)
            self.size -= len(oldest)

    def use(self, lease: bytes, batch: int, now: float) -> bytes | None:
        """Return a reply if it is cached, and mark it as new: it may be lost again."""
        if (found := self.pop((lease, batch), None)) is None:
            return None
        self[lease, batch] = (found[0], now)
        return found[0]

    def drop(self, lease: bytes) -> None:
        """Drop the replies of a lease that ended."""
        for key in [key for key in self if key[0] == lease]:
            self.size -= len(self.pop(key)[0])
