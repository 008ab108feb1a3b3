"""Logs in the paper's format, their fitness by both rules, and errors by line."""

from pathlib import Path

import pytest

from zswarm.ros.launch import logs
from zswarm.ros.launch.logs import LogError

# Three robots: one is out at step 7, one wandered off, one stands still next to an exit.
FIRST = "# step\tdistance\n0\t2.5\n\n1\t2.0\n3\t1.25\n7\t0.1\n"
SECOND = "#\n0\t3\n5\t60.5\n5\t55.0\n"
THIRD = "0\t0.2\r\nx\n1\t0.2\r\n"


def written(folder: Path, *texts: str) -> Path:
    folder.mkdir(exist_ok=True)
    for number, text in enumerate(texts):
        (folder / f"robot_{number:03}.log").write_text(text)
    return folder


def test_both_rules_worked_out_by_hand(tmp_path: Path) -> None:
    """Compute the fitness of three robots by hand.

    First: last distance 0.1 m, 4 steps (an empty line and a comment are skipped): (50 - 0.1) / 50 x
    100 = 99.8, and as 0.1 < 0.2, (90 - 4) / 90 x 100 = 95.5555...: 195.3555...
    Second: step 5 twice, the later line counts: 55 m, cut to 50: 0; 2 steps, far from an exit: 0.
    Third: 0.2 m is not less than 0.2; a line of one character is skipped: (50 - 0.2) / 50 x 100 =
    99.6. cpswarm-log: (195.3555... + 0 + 99.6) / 3 = 98.31851...; last-distance: -55.3.
    """
    robots = logs.read(written(tmp_path / "log", FIRST, SECOND, THIRD), 3)
    assert robots == [(0.1, 4), (55.0, 2), (0.2, 2)]
    assert logs.fitness("cpswarm-log", robots) == pytest.approx(
        (99.8 + 8600 / 90 + 0 + 99.6) / 3, abs=1e-12
    )
    assert logs.fitness("last-distance", robots) == pytest.approx(-55.3, abs=1e-12)


def test_more_than_90_steps_count_as_90(tmp_path: Path) -> None:
    """A distance of 0 counts 100, and (90 - 90) / 90 steps count 0."""
    text = "".join(f"{step}\t0.0\n" for step in range(120))
    robots = logs.read(written(tmp_path / "log", text), 1)
    assert robots == [(0.0, 120)]
    assert logs.fitness("cpswarm-log", robots) == 100.0


def test_an_empty_log_counts_as_worst_for_one_rule_and_is_an_error_for_the_other(
    tmp_path: Path,
) -> None:
    """The rule cpswarm-log counts 50 m and 90 steps, which is 0; last-distance has no distance."""
    robots = logs.read(written(tmp_path / "log", "# nothing\n", "3\t1e1\n"), 2)
    assert logs.fitness("cpswarm-log", robots) == (0.0 + 80.0) / 2
    with pytest.raises(
        LogError, match=r"^1 of 2 logs have no lines; last-distance needs one in each$"
    ):
        logs.fitness("last-distance", robots)


@pytest.mark.parametrize(
    "line",
    [
        "0 1.5",
        "0\tfar",
        "1.5\t2",
        "0\t1.5\t3",
        "zero\t1",
        "0\tnan",
        "0\tinf",
        "0\t1e999",
        "0\t",
        "\t1.5",
        "0\t1,5",
        "0x1\t2",
    ],
)
def test_a_malformed_line_is_reported_with_its_number(line: str, tmp_path: Path) -> None:
    folder = written(tmp_path / "log", f"# step\tdistance\n0\t2.0\n{line}\n")
    with pytest.raises(LogError) as raised:
        logs.read(folder, 1)
    assert str(raised.value).startswith(
        "robot_000.log, line 3: expected a step, a tab and a distance, not "
    )


@pytest.mark.parametrize(
    ("robots", "told"),
    [
        (
            3,
            r"^log/ has 2 logs \(robot_000\.log, robot_001\.log\); expected 3, one of each robot$",
        ),
        (
            1,
            r"^log/ has 2 logs \(robot_000\.log, robot_001\.log\); expected 1, one of each robot$",
        ),
    ],
)
def test_each_robot_has_a_log(robots: int, told: str, tmp_path: Path) -> None:
    with pytest.raises(LogError, match=told):
        logs.read(written(tmp_path / "log", FIRST, SECOND), robots)


def test_a_missing_log_is_an_error_and_not_nan(tmp_path: Path) -> None:
    """The published reader divided by zero."""
    with pytest.raises(
        LogError, match=r"^log/ has 0 logs; expected 2, one of each robot$"
    ):
        logs.read(written(tmp_path / "log"), 2)


def test_bytes_that_are_not_text_are_an_error(tmp_path: Path) -> None:
    (written(tmp_path / "log") / "robot.log").write_bytes(b"0\t1.0\n\xff\xfe\x00\n")
    with pytest.raises(LogError, match=r"^robot\.log, line 2: expected "):
        logs.read(tmp_path / "log", 1)


@pytest.mark.parametrize(
    ("said", "number"),
    [
        ("fitness=1.5", 1.5),
        ("read 3 bags\nfitness = -2e-3 \n", -0.002),
        ("fitness=1\nfitness=2\ndone\n", 2.0),
    ],
)
def test_the_fitness_is_read_from_a_commands_output(said: str, number: float) -> None:
    assert logs.given(said) == number


@pytest.mark.parametrize(
    "said",
    ["", "fitness", "fitness=nan", "fitness=1.0 of 2", "my fitness=1", "Fitness=3"],
)
def test_output_without_a_fitness_is_an_error(said: str) -> None:
    with pytest.raises(LogError, match=r"^its output has no line fitness=<number>$"):
        logs.given(said)
