"""Texts of other machines and programs, nested in tables and lists."""

import pytest

from zswarm.system.text import NESTED, clean_all


def test_texts_in_tables_and_lists_are_made_safe_and_numbers_stay() -> None:
    dirty = {"a\x07": ["\x1b[2J", {"b": "c\n"}], "d": 1.5, "e": None, "f": True}
    cleaned = {"a\\x07": ["\\x1b[2J", {"b": "c\\x0a"}], "d": 1.5, "e": None, "f": True}
    assert clean_all(dirty) == cleaned


def test_what_is_nested_deeper_than_any_record_is_refused() -> None:
    value: object = "x"
    for _ in range(NESTED):
        value = [value]
    assert clean_all(value) == value
    with pytest.raises(RecursionError, match=f"nested deeper than {NESTED} levels"):
        clean_all({"a": value})
