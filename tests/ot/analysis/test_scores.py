"""Runs with a tournament: their scores are compared within a generation only."""

import json
import sqlite3
from pathlib import Path

import msgspec
import numpy as np
import pytest
from click.testing import CliRunner

import zswarm
from zswarm import experiment
from zswarm.champion.controller import Controller
from zswarm.ot.analysis import curves
from zswarm.ot.build import build
from zswarm.ot.cli import command
from zswarm.ot.display.progress import summary
from zswarm.ot.logger import Result
from zswarm.ot.record.reader import Run
from zswarm.ot.record.summary import list_runs
from zswarm.ot.record.writer import Record
from zswarm.ot.replay import held_out
from zswarm.ot.report import report

SCORES = [12.0, 7.0, 9.0]  # the best of each generation


def invoke(*arguments: str) -> str:
    done = CliRunner().invoke(
        command, list(arguments), catch_exceptions=False, env={"COLUMNS": "80"}
    )
    assert done.exit_code == 0
    return done.stdout


def champion(seed: int) -> Controller:
    problem = build(duel()).problem
    return problem.controller(problem.random(1, seed)[0], SCORES[-1], f"duel-{seed}")


def duel() -> experiment.Experiment:
    return experiment.complete(
        experiment.load(experiment.find("minisim-duel"), ["generations=3"]), "test"
    )


def written(parent: Path, seed: int = 1) -> Path:
    """Write a finished run and return its folder."""
    with Record.create(
        parent, duel(), "0" * 32, ("captures", "steals", "tagged"), relative=1
    ) as record:
        for generation, best in enumerate(SCORES):
            statistics = {"best": best, "mean": 6.0}
            record.finish(
                generation, [b"%d" % seed, b"b"], np.array([best, 0.0]), statistics, {}
            )
        record.champion(champion(seed))
        record.set_meta("history_hash", record.history().hex())
        return record.folder


def test_the_best_score_of_a_relative_run_is_that_of_its_last_generation(
    tmp_path: Path,
) -> None:
    folder = written(tmp_path)
    assert Run(folder).relative
    assert Run(folder).best() == list_runs(tmp_path)[0]["best"] == SCORES[-1]
    with sqlite3.connect(folder / "run.sqlite") as database:
        found = database.execute("SELECT generation, best FROM champions").fetchall()
    database.close()
    assert found == list(enumerate(SCORES))
    assert "best score of the last generation" in Run(folder)._repr_html_()
    assert "fitness" not in Run(folder)._repr_html_()


def test_the_curve_of_a_relative_run_is_labelled_as_scores_per_generation(
    tmp_path: Path,
) -> None:
    folder = written(tmp_path)
    assert curves.series(Run(folder)).best.tolist() == SCORES
    figure = zswarm.plot(Run(folder))
    (axes,) = figure.axes
    assert axes.get_ylabel() == "score in its generation"
    assert "best of the generation" in [
        text.get_text() for text in (*axes.texts, *axes.get_legend().get_texts())
    ]


def test_relative_runs_are_not_compared(tmp_path: Path) -> None:
    """The refusal names the command to use instead."""
    folders = [str(written(tmp_path, seed)) for seed in (1, 2)]
    refused = CliRunner().invoke(command, ["compare", *folders])
    assert "a score, which compares within one generation only" in str(refused.exception)
    assert "evaluate RUN --against RUN" in str(refused.exception)


def test_the_report_of_a_relative_run_explains_the_score_and_names_the_opponent(
    tmp_path: Path,
) -> None:
    folder = written(tmp_path)
    page = report.of_run(Run(folder), 4)
    assert "with the score 9 in 3 generations" in page
    assert "9, by swiss among the candidates of its generation" in page
    assert "against itself, the fitness of a trial" in page
    study = report.of_study(tmp_path, [Run(folder), Run(written(tmp_path, 2))])
    assert "Candidates of these runs played each other" in study
    assert "<h2>Comparison</h2>" not in study


def test_the_summary_of_a_relative_run_shows_a_score() -> None:
    ended = Result("runs/duel", 3, 9.0, 150, 0, "0" * 32, 1.0, 0, 0, relative=True)
    assert summary(ended).startswith(
        "the last generation's best score is 9 after 3 generations, 150 eval"
    )
    assert summary(ended._replace(relative=False)).startswith(
        "best fitness 9 after 3 generations"
    )


def test_resuming_a_finished_relative_run_shows_its_score(tmp_path: Path) -> None:
    assert (
        f"the last generation's best score is {SCORES[-1]:g} after 3 generations"
        in invoke("resume", str(written(tmp_path)))
    )


def test_two_champions_play_each_other_from_each_side_in_turn() -> None:
    one, other = champion(1), champion(3)
    played, turned = held_out.play(one, 21, 5, other), held_out.play(other, 21, 5, one)
    assert played.results.tolist() == turned.results[:, ::-1].tolist(), (
        "the game is the same for both sides"
    )
    won, lost = (
        int((played.results[:, side] > played.results[:, 1 - side]).sum())
        for side in (0, 1)
    )
    assert played.score() == {"won": won, "tied": 21 - won - lost, "lost": lost}
    assert won != lost
    assert held_out.play(one, 21, 5).score() == {"won": 0, "tied": 21, "lost": 0}


def test_a_failed_participant_loses() -> None:
    """Against several it takes more than the best of them to win."""
    nan = np.nan
    results = np.array(
        [
            [1.0, 0.0, 0.5],
            [1.0, 2.0, 0.0],
            [1.0, 1.0, 0.0],
            [nan, 0.0, -1.0],
            [0.0, nan, -1.0],
            [nan, nan, nan],
        ]
    )
    assert held_out.HeldOutResult(results, np.empty((6, 0)), ()).score() == {
        "won": 2,
        "tied": 2,
        "lost": 2,
    }


def test_evaluate_against_a_champion_reports_who_won(tmp_path: Path) -> None:
    folder = written(tmp_path)
    (tmp_path / "other.zsc").write_bytes(msgspec.msgpack.encode(champion(3)))
    told = invoke(
        "evaluate",
        str(folder),
        "--against",
        str(tmp_path / "other.zsc"),
        "--trials",
        "11",
    )
    score = held_out.play(champion(1), 11, 0, champion(3)).score()
    words = ", ".join(f"{count} {what}" for what, count in score.items())
    assert f"against         the champion of duel-3: {words}" in told
    alone = json.loads(invoke("evaluate", str(folder), "--trials", "3", "--json"))
    assert (alone["won"], alone["tied"], alone["lost"]) == (0, 3, 0)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            {"simulator_settings": {"teams": 2, "defenders": 0}},
            "cannot play each other: not the same simulator settings",
        ),
        (
            {"representation_settings": {"hidden": 9}},
            "cannot play each other: not the same representation settings",
        ),
    ],
)
def test_champions_of_different_games_or_networks_do_not_play_each_other(
    tmp_path: Path, changes: dict[str, object], words: str
) -> None:
    other = tmp_path / "other.zsc"
    other.write_bytes(
        msgspec.msgpack.encode(msgspec.structs.replace(champion(3), **changes))
    )
    refused = CliRunner().invoke(
        command, ["evaluate", str(written(tmp_path)), "--against", str(other)]
    )
    assert words in str(refused.exception)


def test_check_counts_games_and_reports_who_drives_the_robots() -> None:
    two = ("--set", "optimizer.population=2", "--set", "optimizer.mutation=0.5")
    assert "fitness 1 game in the first" in " ".join(
        invoke("check", "minisim-duel", *two).split()
    )
    told = " ".join(invoke("check", "minisim-duel").split())
    assert "8, driven by 2 genomes that play each other" in told
    assert "150 games in the first generation" in told
    assert "1,550 evaluations, 18,600 simulations" in told, (
        "31 generations of 6 rounds of 25 games of 4 trials"
    )
