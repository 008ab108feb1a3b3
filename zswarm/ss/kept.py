"""Answers to finished batches, kept for a run that asks again."""

from collections import OrderedDict

KEPT_BYTES = 64 << 20  # of answers, per server
KEPT_S = 120.0  # a run asks again when a query's time, 60 s, is up


class Kept:
    """The answers, by lease and batch; the oldest are dropped when there are too many bytes, or when they are too old."""

    def __init__(self) -> None:
        self.bytes = 0
        self._answers: OrderedDict[tuple[bytes, int], tuple[bytes, float]] = OrderedDict()  # with the time, the oldest first

    def put(self, lease: bytes, batch: int, answer: bytes, now: float) -> None:
        """Keep the answer to a batch that is not kept yet; however large, the last one stays."""
        self._answers[lease, batch] = (answer, now)
        self.bytes += len(answer)
        while len(self._answers) > 1 and (self.bytes > KEPT_BYTES or self._oldest() < now - KEPT_S):
            _, (dropped, _) = self._answers.popitem(last=False)
            self.bytes -= len(dropped)

    def get(self, lease: bytes, batch: int, now: float) -> bytes | None:
        """The answer, or None when it is not kept; it is as new then, for it may be lost on its way once more."""
        if (lease, batch) not in self._answers:
            return None
        answer, _ = self._answers.pop((lease, batch))
        self._answers[lease, batch] = (answer, now)
        return answer

    def drop(self, lease: bytes) -> None:
        """A lease ended: nobody may ask again."""
        for key in [key for key in self._answers if key[0] == lease]:
            self.bytes -= len(self._answers.pop(key)[0])

    def leases(self) -> set[bytes]:
        """Whose answers are kept."""
        return {lease for lease, _ in self._answers}

    def _oldest(self) -> float:
        return next(iter(self._answers.values()))[1]
