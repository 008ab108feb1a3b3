"""Which runs a study has, what they are called, and when another one begins."""

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.smallest_experiment import study
from zswarm.ot.study.plan import MOST_AT_ONCE, Planned, another, identity, label, plan
from zswarm.protocol import keys


def names(folder: Path, text: str) -> list[str]:
    return [one.name for one in plan(study(folder, text), "small.toml")]


# ---- which


def test_repeats_have_the_seeds_that_follow(tmp_path: Path) -> None:
    planned = plan(study(tmp_path, "[study]\nrepeat = 3"), "small.toml")
    assert [(one.name, one.seed, one.experiment.seed) for one in planned] == [
        ("seed-7", 7, 7),
        ("seed-8", 8, 8),
        ("seed-9", 9, 9),
    ]


def test_every_setting_has_its_first_seed_before_any_has_its_second(
    tmp_path: Path,
) -> None:
    assert names(
        tmp_path, '[study]\nrepeat = 2\n[study.grid]\n"optimizer.population" = [50, 100]'
    ) == [
        "population-50-seed-7",
        "population-100-seed-7",
        "population-50-seed-8",
        "population-100-seed-8",
    ]


def test_the_name_of_a_run_holds_every_changed_setting(tmp_path: Path) -> None:
    text = '[study.grid]\n"representation.hidden" = [2]\n"optimizer.severity" = [0.5]\n'
    text += '"problem.seeds" = ["fresh"]'
    assert names(tmp_path, text) == ["hidden-2-severity-0-5-seeds-fresh-seed-7"]


def test_names_that_would_be_equal_get_a_hash(tmp_path: Path) -> None:
    """A long setting is cut; what differs may be behind that."""
    long = "[[study.list]]\n" + "\n".join(
        f'"optimizer.{key}" = 0.2' for key in ("random", "mutation", "crossover", "renew")
    )
    both = (
        long
        + '\n"optimizer.probability" = 0.25\n'
        + long
        + '\n"optimizer.probability" = 0.75'
    )
    first, second = names(tmp_path, both)
    assert first == "random-0-2-mutation-0-2-crossover-0-2-renew-0-2-p-seed-7"
    assert second != first
    assert second.startswith("random-0-2-mutation-0-2-crossover-0-2-renew-0-2-p-")
    assert keys.is_id(second)
    assert names(tmp_path, both) == [first, second], "they stay the same"


@given(
    st.dictionaries(
        st.text(), st.one_of(st.text(), st.floats(), st.lists(st.text())), max_size=5
    ),
    st.integers(0, 2**63 - 2),
)
def test_every_setting_gives_a_safe_folder_name(
    settings: dict[str, Any], seed: int
) -> None:
    from zswarm.ot.study.plan import _names

    for _, name in zip(range(3), _names(settings, seed), strict=False):
        assert keys.is_id(name)


def test_a_folder_with_another_run_is_not_reused(tmp_path: Path) -> None:
    """This happens when the study's file was changed since."""
    first = plan(study(tmp_path, "[study]\nrepeat = 2"), "small.toml")
    found = {one.name: identity(one.experiment) for one in first}
    assert plan(study(tmp_path, "[study]\nrepeat = 2"), "small.toml", found) == first
    changed = plan(
        study(
            tmp_path,
            "activation = 'x'\n[study]\nrepeat = 2".replace(
                "activation = 'x'", "population = 60"
            ),
        ),
        "x",
        found,
    )
    assert {one.name for one in changed}.isdisjoint(found)
    found |= {one.name: identity(one.experiment) for one in changed}
    assert (
        plan(study(tmp_path, "population = 60\n[study]\nrepeat = 2"), "x", found)
        == changed
    ), "it is found again"


def test_the_length_of_a_run_is_not_part_of_its_identity(tmp_path: Path) -> None:
    (short,), (long,) = (
        plan(study(tmp_path, f"[study.grid]\ngenerations = [{number}]"), "x")
        for number in (3, 5)
    )
    assert identity(short.experiment) == identity(long.experiment)
    assert short.name != long.name


# ---- labels


def test_a_label_distinguishes_settings() -> None:
    settings = [
        {"optimizer.population": 50, "problem.seeds": "fresh"},
        {"a.width": 2, "b.width": [1, 2]},
        {},
    ]
    assert [label(one, settings) for one in settings] == [
        "population 50, seeds fresh",
        "a.width 2, b.width [1, 2]",
        "",
    ]
    assert label({"optimizer.x": "\x1b[2J"}, []) == "optimizer.x \\x1b[2J"


# ---- when


@pytest.mark.parametrize(
    ("trials", "slots", "begins"),
    [
        ([], 0, True),  # one always
        ([None], 2, False),  # its trials are not known yet
        ([50], 0, False),  # no slot is ready
        ([50], 2, False),
        ([50], 25, False),
        ([50], 26, True),
        ([50, 50], 51, True),
        ([50, None], 1000, False),
        ([1] * (MOST_AT_ONCE - 1), 1000, True),
        ([1] * MOST_AT_ONCE, 1000, False),
    ],
)
def test_another_run_begins_when_the_active_ones_do_not_fill_the_slots(
    trials: list[int | None], slots: int, begins: bool
) -> None:
    assert another(trials, slots, at_once=0) is begins


def test_a_requested_number_of_parallel_runs_is_respected() -> None:
    assert [another([50] * going, 2, at_once=3) for going in range(5)] == [
        True,
        True,
        True,
        False,
        False,
    ]
    assert another([None], 0, at_once=2)


def test_a_planned_run_is_a_whole_experiment(tmp_path: Path) -> None:
    (one,) = plan(study(tmp_path, ""), "small.toml")
    assert one == Planned("seed-7", {}, 7, study(tmp_path, ""))
