"""Limits of a server: what it takes of a simulator's settings, and what is no limit."""

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest

from tests.repository import REPOSITORY
from zswarm import experiment
from zswarm.errors import ConfigError
from zswarm.ss import detected_labels, options
from zswarm.ss.admission import Limit, broken, read
from zswarm.ss.workers import memory

OFFERED = ["arena", "emergency-exit", "minisim"]


def limited(**tables: Any) -> list[Limit]:
    return read(
        {key.replace("__", "."): value for key, value in tables.items()},
        OFFERED,
        "ss.toml: limits",
    )


@pytest.mark.parametrize(
    ("said", "value", "why"),
    [
        ({"max": 100}, 100, ""),
        ({"max": 100}, 101, "arena.robots is 101; this server takes at most 100"),
        ({"min": 2}, 2, ""),
        (
            {"min": 2, "max": 8},
            1,
            "arena.robots is 1; this server takes at least 2 and at most 8",
        ),
        ({"choice": [1, 4]}, 4, ""),
        ({"choice": [1, 4]}, 2, "arena.robots is 2; this server takes one of 1, 4"),
        ({"choice": [4]}, 2, "arena.robots is 2; this server takes 4"),
        ({"max": 100}, "many", "arena.robots is 'many'; this server takes at most 100"),
        ({"max": 100}, True, "arena.robots is True; this server takes at most 100"),
        ({"choice": [1]}, True, "arena.robots is True; this server takes 1"),
        ({"max": 100}, {"from": 5, "to": 100}, ""),
        (
            {"max": 100},
            {"from": 5, "to": 101},
            "arena.robots is 101; this server takes at most 100",
        ),
        (
            {"min": 5},
            {"from": 4, "to": 101},
            "arena.robots is 4; this server takes at least 5",
        ),
        (
            {"max": 100},
            {"choice": [1, [2, 200]]},
            "arena.robots is 200; this server takes at most 100",
        ),
        (
            {"max": 100},
            {"from": 1, "to": 2, "by": 1},
            "arena.robots is {'from': 1, 'to': 2, 'by': 1}; this server takes at most 100",
        ),
        (
            {"max": 100},
            {"choice": 5},
            "arena.robots is {'choice': 5}; this server takes at most 100",
        ),
        (
            {"max": 100},
            {"choice": "5"},
            "arena.robots is {'choice': '5'}; this server takes at most 100",
        ),
        ({"max": 100}, [1, 101], "arena.robots is 101; this server takes at most 100"),
    ],
)
def test_a_setting_beyond_a_limit_is_named_with_it(
    said: dict[str, Any], value: object, why: str
) -> None:
    """Both ends of a range count, every value of a choice, and every item of a list."""
    assert broken(limited(arena__robots=said), "arena", {"robots": value}) == why


def test_a_setting_that_is_not_sent_is_its_default() -> None:
    assert broken(limited(arena__robots={"max": 3}), "arena", {}).startswith(
        "arena.robots is "
    )
    assert broken(limited(arena__robots={"max": 3}), "minisim", {}) == ""


def test_all_broken_limits_are_named() -> None:
    found = limited(
        arena__robots={"max": 3},
        arena__steps={"min": 5},
        **{"emergency-exit__field": {"choice": ["stadium"]}},
    )
    takes = "this server takes at"
    reason = f"arena.robots is 4; {takes} most 3; arena.steps is 1; {takes} least 5"
    assert broken(found, "arena", {"robots": 4, "steps": 1}) == reason
    assert [str(limit) for limit in found] == [
        "arena.robots at most 3",
        "arena.steps at least 5",
        "emergency-exit.field stadium",
    ]


@pytest.mark.parametrize(
    ("key", "table", "told"),
    [
        (
            "arena",
            {"max": 1},
            "'arena': expected SIMULATOR.SETTING and its rule, such as",
        ),
        (
            "arena.robots",
            5,
            "'arena.robots': expected SIMULATOR.SETTING and its rule, such as",
        ),
        (
            "arenas.robots",
            {"max": 1},
            "'arenas.robots': no simulator 'arenas' is offered (did you mean 'arena'?)",
        ),
        ("light.steps", {"max": 1}, "'light.steps': no simulator 'light' is offered"),
        (
            "arena.robot",
            {"max": 1},
            "'arena.robot': arena has no setting 'robot' (did you mean 'robots'?)",
        ),
        (
            "arena.robots",
            {},
            "'arena.robots': expected bounds, such as { min = 1, max = 100 }, or values, such as",
        ),
        (
            "arena.robots",
            {"max": 1, "choice": [1]},
            "'arena.robots': expected bounds, such as",
        ),
        (
            "arena.robots",
            {"mx": 1},
            "'arena.robots': unknown key 'mx' (did you mean 'max'?)",
        ),
        (
            "arena.robots",
            {"max": "1"},
            "'arena.robots': max: expected int | float | null, got str",
        ),
        (
            "emergency-exit.field",
            {"choice": ["stadion"]},
            "'emergency-exit.field': choice: 'stadion' is not a valid value: ",
        ),
        (
            "arena.robots",
            {"min": 5, "max": 4},
            "'arena.robots': no value is at least 5 and at most 4",
        ),
        (
            "arena.robots",
            {"max": float("nan")},
            "'arena.robots': nan is not a bound; expected numbers",
        ),
        (
            "emergency-exit.field",
            {"max": 4},
            "'emergency-exit.field': not a number, so it has no bounds; expected",
        ),
        ("arena.\x1b", {"max": 4}, "'arena.\\x1b': arena has no setting"),
    ],
)
def test_an_invalid_limit_is_refused(key: str, table: Any, told: str) -> None:
    with pytest.raises(ConfigError) as refused:
        read({key: table}, OFFERED, "ss.toml: limits")
    assert str(refused.value).startswith(f"ss.toml: limits: {told}")


def test_reading_limits_loads_no_compiler() -> None:
    """The daemon's process evaluates nothing, and slots inherit an unchanged environment."""
    code = (
        "import os, sys; from zswarm.ss.admission import read;"
        "read({'arena.robots': {'max': 1}}, ['arena'], '');"
        "print('numba' in sys.modules, os.environ.get('ZSWARM_PLAIN'))"
    )
    environment = {
        key: value for key, value in os.environ.items() if key != "ZSWARM_PLAIN"
    }
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=False,
        env=environment,
    )
    assert (done.stdout, done.stderr) == ("False None\n", "")


def test_a_servers_file_has_labels_and_limits(tmp_path: Path) -> None:
    file = tmp_path / "ss.toml"
    file.write_text(
        'simulators = ["arena"]\n[labels]\ngpu = "yes"\ndisks = 2\n'
        '[limits]\n"arena.robots" = { max = 100 }\n'
    )
    loaded = options.load(file, {})
    assert (loaded.labels, loaded.limits) == (
        {"gpu": "yes", "disks": 2},
        {"arena.robots": {"max": 100}},
    )
    assert options.load(file, {"labels": ["gpu=no"]}).labels == {"gpu": "no"}
    with pytest.raises(
        ConfigError, match=r"^--label: os: a server detects that by itself"
    ):
        options.load(file, {"labels": ["os=plan9"]})
    for text, told in (
        ('[labels]\nos = "plan9"\n', "labels: os: a server detects that by itself"),
        ("[labels]\ngpu = true\n", "labels: gpu: a value is "),
        (
            '[limits]\n"arena.robots" = { mx = 1 }\n',
            "limits: 'arena.robots': unknown key 'mx'",
        ),
        (
            'simulators = ["minisim"]\n[limits]\n"arena.robots" = { max = 1 }\n',
            "limits: 'arena.robots': no simulator 'arena' is",
        ),
        (
            'simulators = ["arenas"]\n',
            "unknown simulator 'arenas' (did you mean 'arena'?)",
        ),
    ):
        file.write_text(text)
        with pytest.raises(ConfigError) as refused:
            options.load(file, {})
        assert told in str(refused.value)


def test_a_server_detects_its_labels() -> None:
    """They have the names that a user may not give, and valid values."""
    known = detected_labels.detected_labels("lab-3", 4, 700)
    assert (known["name"], known["slots"], known["slot_memory_mb"], known["os"]) == (
        "lab-3",
        "4",
        "700",
        sys.platform,
    )
    assert int(known["memory_mb"]) == memory.machine_mb() >= memory.per_slot_mb(1) >> 1
    assert int(known["cores"]) == os.cpu_count()
    assert known.keys() <= set(detected_labels.NAMES)


def test_the_examples_of_the_document_are_valid(
    tmp_path: Path,
) -> None:
    """The labels that the document lists are those that the program detects."""
    page = (REPOSITORY / "docs" / "mixed.md").read_text(encoding="utf-8")
    file, cluster = re.findall(r"```toml\n(.*?)```", page, re.S)
    (tmp_path / "ss.toml").write_text(file)
    shown = options.load(tmp_path / "ss.toml", {})
    assert (len(shown.simulators), len(shown.labels), len(shown.limits)) == (2, 2, 3)
    assert len(experiment.cluster(tomllib.loads(cluster)["cluster"]).require) == 4
    (table,) = re.findall(
        r"\| label \| meaning \|\n\| --- \| --- \|\n((?:\|.*\n)+)", page
    )
    assert (
        tuple(
            name
            for row in table.splitlines()
            for name in re.findall(r"`(\w+)`", row.split("|")[1])
        )
        == detected_labels.NAMES
    )
