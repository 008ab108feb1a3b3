"""Hold back new servers until no more of them come.

Zenoh sends a query to each link that is not quite up yet, and not only to the one it is for. If a
thousand servers are asked while a thousand links come up, these are a million messages, and some
servers never answer.
"""

import math

import msgspec

# Without another new server, before they are asked; half the time in which they came, if longer.
QUIET_S = 0.02
GATHER_S = 5.0  # at most, while more of them come


class Newcomers(msgspec.Struct, eq=False):
    """Servers that are held back; times are seconds of any one clock."""

    due: float = math.inf  # when they are to be taken
    _waiting: list[str] = []
    _since: float = 0.0

    def add(self, newcomer: str, now: float) -> None:
        """Hold a server back."""
        if not self._waiting:
            self._since = now
        self._waiting.append(newcomer)
        self.due = min(
            now + max(QUIET_S, (now - self._since) / 2), self._since + GATHER_S
        )

    def remove(self, newcomer: str) -> None:
        """Forget a server that left, if it is held back."""
        self._keep([other for other in self._waiting if other != newcomer])

    def take(self, now: float) -> list[str]:
        """Return all servers, in order, if it is time; else none."""
        if now < self.due:
            return []
        taken = self._waiting
        self._keep([])
        return taken

    def _keep(self, waiting: list[str]) -> None:
        self._waiting = waiting
        self.due = self.due if waiting else math.inf
