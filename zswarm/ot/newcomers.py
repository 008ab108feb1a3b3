"""New servers wait for each other until no more of them come.

Zenoh sends a question to each link that is not quite up yet, beside the one it is for: a thousand servers that are asked
while a thousand links come up are a million messages, and some of these servers then never answer.
"""

import math
from typing import Generic, TypeVar

QUIET_S = 0.02  # without another new server, before they are asked; half the time in which they came if that is more
GATHER_S = 5.0  # at most, while ever more of them come

T = TypeVar("T")


class Newcomers(Generic[T]):
    """Those that wait; times are of any one clock, in seconds."""

    def __init__(self) -> None:
        self._waiting: list[T] = []
        self._since = 0.0
        self.due = math.inf  # when they are to be taken

    def add(self, newcomer: T, now: float) -> None:
        """One more is there."""
        if not self._waiting:
            self._since = now
        self._waiting.append(newcomer)
        self.due = min(now + max(QUIET_S, (now - self._since) / 2), self._since + GATHER_S)

    def remove(self, newcomer: T) -> None:
        """It has left, if it was there."""
        self._keep([other for other in self._waiting if other != newcomer])

    def take(self, now: float) -> list[T]:
        """All of them when it is time, in the order in which they came; else none."""
        if now < self.due:
            return []
        taken = self._waiting
        self._keep([])
        return taken

    def _keep(self, waiting: list[T]) -> None:
        self._waiting = waiting
        self.due = self.due if waiting else math.inf
