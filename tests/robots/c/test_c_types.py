"""Names that people gave, in files, packages and functions."""

import pytest

from zswarm.robots.c.c_types import folded


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("stadium", "stadium"),
        ("Emergency Exit--2", "emergency_exit_2"),
        ("größe/../../etc", "groe_etc"),
        ("*/ int main(void)", "int_main_void"),
        ("__x__", "x"),
        ("2 robots", "n2_robots"),
        ("4" * 39 + "-b", "n" + "4" * 39),
        ("日本", "controller"),
        ("", "controller"),
        ("a" * 39 + "-b" * 9, "a" * 39),
    ],
)
def test_any_name_becomes_one_for_files_packages_and_functions(
    name: str, expected: str
) -> None:
    assert folded(name) == expected
    assert folded(expected) == expected
