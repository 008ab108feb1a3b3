"""What the champion does on held-out seeds is shown next to its fitness in search."""

import json
import threading
from pathlib import Path

import msgspec
import numpy as np
import pytest
from click.testing import CliRunner

import zswarm
from tests.ot.assessment.test_assessed_runs import Noisy, evolved, loaded
from tests.ot.cluster.fake_connection import result
from zswarm.champion.controller import load_controller
from zswarm.champion.held_out import HeldOut
from zswarm.ot import cli, run
from zswarm.ot.analysis import curves, figures
from zswarm.ot.build import build
from zswarm.ot.dashboard import downsample, endpoints
from zswarm.ot.dashboard.run_index import RunIndex
from zswarm.ot.dashboard.tail import RecordTail
from zswarm.ot.display.progress import generation_event, progress, summary
from zswarm.ot.logger import Generation, Logger, Result
from zswarm.ot.record.writer import Record
from zswarm.ot.report import report


@pytest.fixture(scope="module")
def assessed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Result, HeldOut]:
    folder, result = evolved(tmp_path_factory.mktemp("runs"), Noisy())
    assert result.champion is not None
    return folder, result, result.champion


def said(*arguments: object) -> str:
    found = CliRunner().invoke(cli.command, [str(one) for one in arguments])
    assert found.exit_code == 0, found.output
    return found.stdout


TRIALS = 2  # of a candidate: people see their mean, programs and the record their sum


def mean(total: float | None) -> str:
    assert total is not None
    return f"{total / TRIALS:.6g}"


def test_at_the_end_of_a_run(assessed: tuple[Path, Result, HeldOut]) -> None:
    _, result, champion = assessed
    best, held_out = summary(result).splitlines()[:2]
    assert best.startswith(f"best fitness {mean(result.best)} (mean of {TRIALS} trials) ")
    assert held_out == (
        f"held-out fitness {mean(champion.mean)} of the champion (95 %: "
        f"{mean(champion.low)} to {mean(champion.high)}, {champion.seeds} seeds); "
        f"in search {mean(champion.in_search)}"
    )
    assert list(result.as_object()["champion"]) == "mean low high seeds in_search".split()
    assert len(summary(result._replace(champion=None)).splitlines()) == 3


class Follower(Logger):
    """Keeps what a display is told."""

    def __init__(self) -> None:
        self.generations: list[Generation] = []
        self.progress: list[tuple[int, int, int]] = []

    def on_generation(self, generation: Generation) -> None:
        self.generations.append(generation)

    def on_progress(self, generation: int, counted: int, trials: int) -> None:
        self.progress.append((generation, counted, trials))


def followed(out: Path, servers: Noisy, *overrides: str) -> Follower:
    complete, follower = loaded(*overrides), Follower()
    metrics = build(complete).problem.simulator.metrics
    with Record.create(out, complete, "0" * 32, metrics) as record:
        stop = threading.Event()
        result(run.evolve(build(complete), record, servers, follower, stop))  # type: ignore[arg-type]
    return follower


def test_a_run_lets_expect_its_assessment(tmp_path: Path) -> None:
    seen = followed(tmp_path / "all", Noisy())
    assert {(one.last, one.after) for one in seen.generations} == {(6, 1.0)}
    line = progress(last := seen.generations[-1], 6)
    assert f"  best {mean(last.best)} a trial  mean {mean(last.mean)}  " in line
    assert generation_event(last)["best"] == last.best
    assert generation_event(last)["trials"] == TRIALS
    of_assessment = [one for one in seen.progress if one[0] == 6]
    played = sum(one.evaluations for one in seen.generations[-1:]) * TRIALS
    assert {trials for _, _, trials in of_assessment} == {played}
    assert of_assessment[-1][1] == played
    alike = followed(tmp_path / "alike", Noisy(noise=0.0))
    assert {one.after for one in alike.generations} == {0.0}
    tracked = followed(tmp_path / "track", Noisy(noise=0.0), "assessment.track=3")
    of_search = 6 * 7 * TRIALS  # like the last generation
    assert tracked.generations[-1].after * of_search == pytest.approx(200)
    budget = followed(tmp_path / "budget", Noisy(), "stop.evaluations=30")
    assert [one.last for one in budget.generations] == [3, 3, 3]


def test_in_lists_comparisons_and_in_python(
    assessed: tuple[Path, Result, HeldOut],
) -> None:
    folder, result, champion = assessed
    (row,) = json.loads(said("list", folder.parent, "--json"))["runs"]
    assert row["champion"] == result.as_object()["champion"]
    assert (row["best"], row["trials"]) == (result.best, TRIALS)
    (state,) = json.loads(said("status", folder.parent, "--json"))["runs"]
    assert (state["best"], state["trials"]) == (result.best, TRIALS)
    listed = said("list", folder.parent)
    for text in (listed, said("status", folder.parent)):
        assert f" {mean(result.best)} " in text
        assert "fitness is the mean of a candidate's trials" in text
    assert f" {mean(champion.mean)} " in listed
    (group,) = json.loads(said("compare", folder, "--json"))["rows"]
    assert group["held_out"] == champion.mean / TRIALS
    assert "held-out" in said("compare", folder)
    run = zswarm.read(folder)
    assert run.held_out == champion
    assert (
        f"champion, held-out</th><td style='text-align:left'>{mean(champion.mean)}"
        in (shown := run._repr_html_())
    )
    assert f"{mean(run.best())} (mean of {TRIALS} trials)" in shown


def test_of_a_champion(assessed: tuple[Path, Result, HeldOut], tmp_path: Path) -> None:
    """Alone, too: its file has the number of trials; one of an earlier version has not."""
    folder, _, _ = assessed
    champion = load_controller(folder)
    words = f"fitness {mean(champion.fitness)} (mean of {TRIALS} trials)"
    out = tmp_path / "exported"
    exported = said("export", folder, "--to", "c99", "--out", out, "--name", "one")
    for text in (
        said("evaluate", folder, "--trials", 1),
        exported,
        (out / "zs_one.h").read_text(),
    ):
        assert words in " ".join(text.replace(" * ", " ").split())
    old = msgspec.structs.replace(champion, trials=0)
    assert old.in_search() == f"{champion.fitness:.6g} (sum of its trials)"


def test_in_the_dashboard(assessed: tuple[Path, Result, HeldOut]) -> None:
    folder, result, champion = assessed
    (row,) = RunIndex([folder.parent]).rows()
    assert row["held_out"] == champion.per_trial(TRIALS).mean
    assert (row["best"], row["fitness_trials"]) == (result.best / TRIALS, TRIALS)
    state = RecordTail(folder).look()["state"]
    assert state["champion"] == msgspec.to_builtins(champion.per_trial(TRIALS))
    assert (state["best"], state["best_sum"]) == (result.best / TRIALS, result.best)
    run = zswarm.read(folder)
    last = len(run.history()) - 1
    best = run.history()[last]
    curve, (first, *_) = downsample.curve(run), downsample.generation(run, last)
    assert curve["best"][-1] == state["best"]
    assert curve["mean"][-1] == state["mean"] == best["mean"] / TRIALS
    of = {"generation": str(last), "candidate": str(first["candidate"])}
    told = endpoints.candidate(run, of)
    assert first["fitness"] == told["fitness"] / told["fitness_trials"]
    assert downsample.champions(run)[-1]["fitness"] == state["best"]
    assert downsample.spread(run)["top"][-1] == first["fitness"]


def test_in_figures_and_reports(assessed: tuple[Path, Result, HeldOut]) -> None:
    folder, _, champion = assessed
    run = zswarm.read(folder)
    drawn = figures._of_one(
        curves.series(run),
        curves.curves({"a": [curves.series(run)]}, "generation")[0],
        "generation",
    )
    level = drawn[-1]
    assert level.label == "champion, held-out"
    assert np.unique(level.y).tolist() == [champion.mean / TRIALS]
    page = report.of_run(run, 0)
    assert "best fitness in search" in page
    assert f"{champion.seeds} held-out seeds" in page
    for number in (champion.mean, champion.low, champion.high, champion.in_search):
        assert f"{number / TRIALS:.6g}" in page
