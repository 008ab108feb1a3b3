"""Mappings that do not fit a struct are refused with key, expectation and nearest known key."""

from typing import Annotated, Any, Literal

import msgspec
import pytest
from msgspec import Meta

from zswarm.config.decode import convert
from zswarm.errors import ConfigError


class Inner(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    depth: Annotated[float, Meta(gt=0, le=10)] = 1.0
    names: list[str] = []


class Bare(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    pass


class Outer(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    count: int
    colour: Literal["red", "green"] = "red"
    inner: Inner = Inner()
    free: dict[str, Any] = {}
    either: Literal["all"] | int = "all"
    bare: Bare = Bare()


def test_a_valid_mapping_is_converted_and_gets_defaults() -> None:
    assert convert({"count": 2, "inner": {"depth": 3}}, Outer, "file") == Outer(
        count=2, inner=Inner(depth=3.0)
    )
    assert convert({"count": 2, "free": {"anything": [1, {}]}}, Outer, "file").free == {
        "anything": [1, {}]
    }
    assert convert({"count": 2, "either": 5}, Outer, "file").either == 5


@pytest.mark.parametrize(
    ("mapping", "text"),
    [
        ({}, "file: key count is missing"),
        ({"count": "2"}, "file: count: expected int, got str"),
        ({"count": 2.0}, "file: count: expected int, got float"),
        ({"count": True}, "file: count: expected int, got bool"),
        ({"count": None}, "file: count: expected int, got null"),
        (
            {"count": 2, "colour": "blue"},
            "file: colour: expected red or green, not 'blue'",
        ),
        (
            {"count": 2, "colour": "gren"},
            "file: colour: expected red or green, not 'gren' (did you mean 'green'?)",
        ),
        (
            {"count": 2, "colour": "a\x1b\n"},
            "file: colour: expected red or green, not 'a\\x1b\\n'",
        ),
        ({"count": 2, "inner": 3}, "file: inner: expected object, got int"),
        ({"count": 2, "inner": {"depth": 0}}, "file: inner.depth: expected float > 0.0"),
        (
            {"count": 2, "inner": {"depth": float("nan")}},
            "file: inner.depth: expected float > 0.0",
        ),
        (
            {"count": 2, "inner": {"names": ["a", 3]}},
            "file: inner.names[1]: expected str, got int",
        ),
        (
            {"count": 2, "either": "some"},
            "file: either: expected all or a number, not 'some'",
        ),
        (
            {"count": 2, "color": "red"},
            "file: unknown key 'color' (did you mean 'colour'?); known are: count, colour, "
            "inner, free, either, bare",
        ),
        (
            {"count": 2, "xyz": 1},
            "file: unknown key 'xyz'; known are: count, colour, inner, free, either, bare",
        ),
        (
            {"count": 2, "inner": {"dept": 1}},
            "file: inner: unknown key 'dept' (did you mean 'depth'?); known are: depth, names",
        ),
        ({"count": 2, "bare": {"x": 1}}, "file: bare: unknown key 'x'; there are none"),
        (
            {"count": 2, "depth": 1},
            "file: unknown key 'depth' (did you mean 'inner.depth'?); known are: count, colour, "
            "inner, free, either, bare",
        ),
        (
            {"count": 2, "x": 1, "free": {"a": {"x": 2}}},
            "file: unknown key 'x' (did you mean 'free.a.x'?); known are: count, colour, inner, "
            "free, either, bare",
        ),
    ],
)
def test_an_invalid_mapping_is_refused_in_one_clear_line(
    mapping: dict[str, Any], text: str
) -> None:
    with pytest.raises(ConfigError) as refusal:
        convert(mapping, Outer, "file")
    assert str(refusal.value) == text


def test_an_unknown_key_is_named_before_a_missing_one() -> None:
    """A misspelt key is both; its own name helps more."""
    with pytest.raises(ConfigError, match="unknown key 'cuont'"):
        convert({"cuont": 2}, Outer, "file")
