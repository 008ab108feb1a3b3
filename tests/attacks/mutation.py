"""Mutate valid messages by their structure: types, sizes, ranges, fields, and bytes."""

import copy
import random
import struct
from typing import Any

import msgspec

from zswarm.protocol.messages import MAX_TEXT, Message

EXTENSION = msgspec.msgpack.Ext(5, b"unknown")
# Of every type, at and beyond the ends of ranges.
VALUES: list[Any] = [
    *(None, True, False, 0, 1, -1, 7, 255, 256, 65_535, 65_536, 2**31, 2**53, 2**53 + 1),
    *(2**63, 2**64 - 1, -(2**63), 0.0, -0.0, 1e-300, 5e-324, 1e9, 1.7e308, 0.5),
    *(float("nan"), float("inf"), float("-inf")),
    *(
        "",
        "x",
        "ready",
        "x" * MAX_TEXT,
        "x" * (MAX_TEXT + 1),
        "\x1b]0;title\x07",
        "\ud7ff\u202e",
    ),
    *(
        b"",
        b"x",
        bytes(8),
        bytes(16),
        bytes(17),
        bytes(64),
        b"\xff" * 8,
        b"\0\0\xf8\x7f" * 4,
    ),
    *([], [0], [[]] * 50, [1] * 5_000, {}, {"a": 1}, {1: 2}, {"": {"": {"": {}}}}),
    *({"from": 1, "to": 0}, {"choice": []}, {"choice": [1, "x"]}, EXTENSION),
]


def plain(message: Message) -> dict[str, Any]:
    """Return a message as a map, with all of its fields."""
    fields: dict[str, Any] = msgspec.to_builtins(message, builtin_types=(bytes,))
    return fields


def mutated(message: Message, draw: random.Random) -> bytes:
    """Return the bytes of a message after some changes; most are of its structure."""
    fields = copy.deepcopy(plain(message))
    for _ in range(draw.choice([1, 1, 1, 2, 3])):
        _change(fields, draw)
    body = msgspec.msgpack.encode(fields)
    return _damage(body, draw) if draw.random() < 0.2 else body


def _change(fields: dict[str, Any], draw: random.Random) -> None:
    """Change one value, field or item anywhere in a message."""
    places = list(_places(fields))
    if not places:
        return
    parent, key = draw.choice(places)
    match draw.randrange(6):
        case 0 | 1:
            parent[key] = copy.deepcopy(draw.choice(VALUES))
        case 2:
            parent[key] = _near(parent[key], draw)
        case 3:
            del parent[key]
        case 4 if isinstance(parent, dict):
            name = draw.choice(["later", "type", "lease", "\x1b", key])
            parent[name] = copy.deepcopy(draw.choice(VALUES))
        case _:
            parent[key] = _resized(parent[key], draw)


def _places(value: Any) -> Any:
    """Yield each parent and key in a message."""
    items = list(value.items()) if isinstance(value, dict) else list(enumerate(value))
    for key, item in items:
        yield value, key
        if isinstance(item, dict | list):
            yield from _places(item)


def _near(value: Any, draw: random.Random) -> Any:
    """Return a value of the same type, close to another or far away."""
    match value:
        case bool():
            return not value
        case int():
            far = draw.choice([1, -1, 10**6, 2**32, 2**53, -(2**40)])
            return max(-(2**63), min(2**64 - 1, value + far))
        case float():
            return value * draw.choice([-1.0, 0.0, 1e-300, 1e300, 2.0])
        case str():
            return value[::-1] + draw.choice(["", "-", " ", "\n", "é"])
        case bytes():
            number = draw.randrange(len(value) + 1)
            special = draw.choice(
                [b"\xff" * 8, struct.pack("<d", float("inf")), bytes(8)]
            )
            return (value[:number] + special + value[number:])[: max(8, len(value))]
    return value


def _resized(value: Any, draw: random.Random) -> Any:
    match value:
        case str() | bytes() | list():
            return draw.choice([value[:-1], value[1:], value * 2, value * 50, value[:0]])
        case dict():
            return value | {
                f"k{number}": number for number in range(draw.choice([1, 200]))
            }
    return [value]


def _damage(body: bytes, draw: random.Random) -> bytes:
    """Cut a message, or change some of its bytes."""
    at = draw.randrange(len(body) + 1)
    match draw.randrange(5):
        case 0:
            return body[:at]
        case 1:
            return draw.randbytes(draw.choice([0, 1, 20, 3_000]))
        case 2:
            return body[:at] + draw.randbytes(4) + body[at:]
        case 3:
            return body + body
    changed = bytearray(body or b"\0")
    for _ in range(draw.choice([1, 2, 8])):
        changed[draw.randrange(len(changed))] = draw.randrange(256)
    return bytes(changed)
