"""The versions of the protocol that a server speaks in addition to its own, for one release.

A new version changes ``keys.VERSION`` and the messages. So that servers can be upgraded before the
optimizers, ``OLDER`` then gets an adapter for the previous one, and loses it in the next release.
"""

from collections.abc import Callable
from typing import NamedTuple


class VersionAdapter(NamedTuple):
    """Rewrites messages, as bytes, from an older version into the present one, and back."""

    taken: Callable[[bytes], bytes]
    sent: Callable[[bytes], bytes]


OLDER: dict[str, VersionAdapter] = {}  # by the version's name in keys


def taken(version: str, body: bytes) -> bytes:
    """Return a message of a peer as one of the present version."""
    return OLDER[version].taken(body) if version in OLDER else body


def sent(version: str, body: bytes) -> bytes:
    """Return a message of the present version as one that a peer understands."""
    return OLDER[version].sent(body) if version in OLDER else body
