"""Declare settings of parts: their base class, and limits and meaning of a key."""

from typing import Any

import msgspec
from msgspec import Meta

ONLY_WITH = "only with"


class PartSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Settings of a part, such as a simulator; a child declares the keys with their defaults."""


def about(meaning: str, **limits: Any) -> Meta:
    """Give a key its meaning, in Markdown, and other limits of its value."""
    return Meta(description=meaning, **limits)


def within(low: float, high: float, meaning: str) -> Meta:
    """Give a key its limits, which it may have, and its meaning."""
    return Meta(ge=low, le=high, description=meaning)


def above(low: float, high: float, meaning: str) -> Meta:
    """Give a key a lower limit that it must exceed, an upper one that it may have, a meaning."""
    return Meta(gt=low, le=high, description=meaning)


def only_with(**values: Any) -> Meta:
    """Declare that a key has an effect only where another one has this value."""
    return Meta(extra={ONLY_WITH: values})
