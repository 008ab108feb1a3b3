"""The servers whose tokens are there: at a time, a limited number of each name is used.

Each server that is used has a thread here, and lines in the record. A machine that may show tokens
of one name could otherwise make as many as it likes.
"""

import itertools
from collections.abc import Callable
from typing import Any

import msgspec

SAME_NAME = 16  # servers that are used


class Announced(msgspec.Struct, eq=False):
    """The tokens that are there.

    Args:
        name_of: returns the name in a server's id.
    """

    name_of: Callable[[str], str]
    # Servers in the order of their tokens, and where each is.
    _by_name: dict[str, dict[str, Any]] = {}

    def add(self, server: str, where: object) -> bool:
        """Add a token; return whether its server is used."""
        there = self._by_name.setdefault(self.name_of(server), {})
        there[server] = where
        return server in self._used(there)

    def remove(self, server: str) -> tuple[str, Any] | None:
        """Remove a token; return a server that waited, and where it is, if it is used instead."""
        name = self.name_of(server)
        there = self._by_name.get(name, {})
        was_used = server in self._used(there)
        there.pop(server, None)
        if not there:
            self._by_name.pop(name, None)
        used = self._used(there)
        return (
            (used[-1], there[used[-1]]) if was_used and len(used) == SAME_NAME else None
        )

    @staticmethod
    def _used(there: dict[str, Any]) -> list[str]:
        return list(itertools.islice(there, SAME_NAME))
