"""What a key of a struct is, in words."""

from typing import Annotated, Any, Literal

import msgspec
import pytest
from msgspec import Meta

from zswarm.config.meta import PartSettings, about, only_with
from zswarm.config.settings_docs import Key, keys, markdown, unused

Small = Annotated[int, Meta(ge=1, le=9, description="of the alias")]


class Sheet(msgspec.Struct, kw_only=True):
    needed: str
    count: Annotated[int, Meta(ge=0, lt=1001, description="how `many` | or few")] = 3
    alias: Small = 1
    described: Annotated[Small, Meta(description="of its own")] = 1
    named: Annotated[str, Meta(extra={"type": "id"})] = "a"
    parts: list[str] = []
    anything: dict[str, Any] = {}
    either: Literal["a", "b"] | Small = "a"
    maybe: float | None = None
    flag: bool = False


class Outer(msgspec.Struct):
    sheet: Sheet
    number: int


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        (int, "int"),
        (float, "float"),
        (Annotated[int, Meta(ge=2)], "int, from 2"),
        (Annotated[int, Meta(gt=2, le=10)], "int, 3 to 10"),
        (Annotated[int, Meta(le=10)], "int, up to 10"),
        (Annotated[float, Meta(gt=0)], "float, above 0"),
        (Annotated[float, Meta(gt=0, le=1e6)], "float, above 0, to 10^6"),
        (Annotated[float, Meta(ge=0, lt=0.5)], "float, 0 to below 0.5"),
        (Annotated[float, Meta(lt=3)], "float, below 3"),
        (Annotated[int, Meta(ge=0, lt=2**48)], "int, 0 to 2^48 - 1"),
        (Annotated[int, Meta(ge=0, le=2**40)], "int, 0 to 2^40"),
        (Annotated[int, Meta(ge=0, le=12_345_678_901)], "int, 0 to 12,345,678,901"),
        (Literal["a", "b", "c"], '"a", "b" or "c"'),
        (list[Any], "list"),
        (list[int], "list of ints"),
    ],
)
def test_a_type_and_its_limits_are_described(kind: Any, words: str) -> None:
    (key,) = keys(msgspec.defstruct("One", [("it", kind)]))
    assert key.type_text == words


def test_every_key_has_its_default_and_meaning() -> None:
    found = {key.name: key for key in keys(Sheet)}
    assert list(found) == [field.name for field in msgspec.structs.fields(Sheet)]
    assert found["needed"].required
    assert found["count"] == Key("count", "int, 0 to 1,000", 3, "how `many` | or few")
    assert found["alias"].meaning == "of the alias"
    assert found["described"].meaning == "of its own"
    assert found["named"].type_text == "id"
    assert found["parts"].default == []
    assert found["either"].type_text == '"a", "b" or int, 1 to 9'
    assert (found["maybe"].type_text, found["maybe"].default) == ("float", None)


def test_a_nested_struct_is_not_a_key() -> None:
    assert [key.name for key in keys(Outer)] == ["number"]


def test_the_table_has_a_row_for_each_key() -> None:
    header, _, first, second, *_ = markdown(keys(Sheet)).splitlines()
    assert header == "| key | type | default | meaning |"
    assert first == "| `needed` | text | required | |"
    assert second == r"| `count` | int, 0 to 1,000 | 3 | how `many` \| or few |"


class Rooms(PartSettings, frozen=True):
    room: Literal["drawn", "hall"] = "drawn"
    doors: Annotated[int, about("of a drawn room"), only_with(room="drawn")] = 5
    robots: int = 10


@pytest.mark.parametrize(
    ("values", "without_effect"),
    [
        ({"room": "hall", "doors": 5}, {"doors"}),
        ({"room": "drawn", "doors": 5}, set()),
        ({"doors": 5}, set()),
        ({"room": {"choice": ["hall", "drawn"]}}, set()),
        ({"room": {"choice": ["hall", "hall"]}}, {"doors"}),
    ],
)
def test_a_key_may_need_a_value_of_another(
    values: dict[str, Any], without_effect: set[str]
) -> None:
    """With a range some trials have each of its values."""
    assert unused(Rooms, values) == without_effect
    assert [key.meaning for key in keys(Rooms)] == ["", "of a drawn room", ""]
