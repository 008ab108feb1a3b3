"""The line on which a TOML file sets a key."""

import tomllib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from zswarm.config.toml_lines import LONGEST, find, has

TEXT = '''\
# seed of agents and realm
name = "agents = 3"
generations = 5
notes = """
seed = 1
[problem]
agents = 7
"""
problem.trials = 2
"od d"."k\\"ey" = 1

[ problem . settings ] # of agents
agents = 3
exits = [
  1, # realm
  2,
]

[cluster]
realm = "lab"
connect = ["tcp/a:1"]
more = { seed = 4, deep.est = 5 }

[[study.list]]
population = 3
[optimizer]
kind = "nnga"
seed = 3
'''


@pytest.mark.parametrize(
    ("path", "line"),
    [
        ("name", 2),
        ("generations", 3),
        ("notes", 4),
        ("problem.trials", 9),
        ("problem.settings", 12),
        ("problem.settings.agents", 13),
        ("problem.settings.exits", 14),
        ("cluster", 19),
        ("cluster.realm", 20),
        ("cluster.more", 22),
        ("cluster.more.seed", 22),
        ("cluster.more.deep.est", 22),
        ("optimizer", 26),
        ("optimizer.seed", 28),
        ("study.list", 24),
    ],
)
def test_the_line_of_a_key_is_found_in_every_notation(path: str, line: int) -> None:
    assert has(tomllib.loads(TEXT), path.split("."))
    assert find(TEXT, path.split(".")) == line


@pytest.mark.parametrize(
    "path",
    [
        [],
        ["seed"],
        ["problem", "agents"],
        ["name", "agents"],
        ["cluster", "realm", "x"],
        ['k"ey'],
    ],
)
def test_a_missing_key_has_no_line(path: list[str]) -> None:
    assert find(TEXT, path) is None


def test_the_line_of_an_implicit_table_is_that_of_its_first_table() -> None:
    assert find("a = 1\n[b.c]\nd = 1\n", ["b"]) == 2
    assert find("[b.c]\nd = 1\n[b]\n", ["b"]) == 3, "its own name is nearer"


def test_a_very_long_text_is_not_searched() -> None:
    assert find("a = 1\n" + "#\n" * LONGEST + "b = 1\n", ["b"]) is None


@given(
    st.lists(st.sampled_from("abc"), min_size=1, max_size=8, unique=True),
    st.integers(0, 3),
)
def test_plain_keys_are_found_on_their_lines(names: list[str], blank: int) -> None:
    text = "".join("\n" * blank + f"{name} = 1\n" for name in names)
    assert [find(text, [name]) for name in names] == [
        (index + 1) * (blank + 1) for index in range(len(names))
    ]
