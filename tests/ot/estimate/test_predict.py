"""Predict an experiment: measure on servers, calculate by the model, compare in the report."""

import json
import math
import sqlite3
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from tests.ot.invented_record import written
from tests.ot.record.sealing import reseal
from zswarm import experiment
from zswarm.ot import cli
from zswarm.ot.assessment import amount
from zswarm.ot.build import Parts, build
from zswarm.ot.commands.shared.exits import EXIT_NO_SERVERS
from zswarm.ot.estimate import calibration as constants
from zswarm.ot.estimate import cost_model
from zswarm.ot.estimate import retrospect as hindsight
from zswarm.ot.estimate.cost_model import TABLE_I, Plan
from zswarm.ot.notes import Note
from zswarm.ot.record.reader import Run

PAPER = Plan(generations=200, population=50, steps=50, agents=10)


def problem(name: str, **settings: object) -> Parts:
    overrides = [f"{key.replace('__', '.')}={value}" for key, value in settings.items()]
    return build(
        experiment.complete(experiment.load(experiment.find(name), overrides), name)
    )


def test_the_papers_designs_have_the_papers_times() -> None:
    """The paper gives 351,500, 138,400 and 50,600 s for 10 agents, 50 steps and one slot."""
    ways = {way.way: way for way in cost_model.predict(PAPER, TABLE_I, 1)}
    assert ways["broker"].seconds == pytest.approx(351_500, rel=1e-3)
    assert ways["files"].seconds == pytest.approx(138_400, rel=1e-3)
    assert ways["parameters"].seconds == pytest.approx(50_600, rel=1e-3)
    assert ways["broker"].messages == 10_000 * (5 + 2 * 50 * 10)
    assert ways["broker"].useful_slots == 2


def test_every_way_has_an_explanation() -> None:
    assert all(meaning for _, meaning in cost_model.WAYS.values())


@pytest.mark.parametrize(
    ("name", "steps", "agents", "turns"),
    [("minisim", 100, 8, 1), ("xor", 1, 4, 1), ("arena-dispersion", 500, 16, 1)],
)
def test_turns_of_a_trial_are_counted(
    name: str, steps: int, agents: int, turns: int
) -> None:
    made, optimizer = problem(name)
    simulator = made.simulator
    assert len(simulator.owners) == agents
    assert getattr(simulator.settings, "steps", 1) == steps
    plan = constants.plan_of(made, optimizer.ask(), 50, 37)
    assert (plan.steps, plan.agents, plan.turns) == (steps, agents, turns)
    assert plan.batches == (50 * plan.evaluations, 37 * plan.evaluations)


def test_agents_that_act_one_after_another_take_separate_turns() -> None:
    made, optimizer = problem("emergency-exit")
    plan = constants.plan_of(made, optimizer.ask(), 50, 37)
    assert plan.turns == pytest.approx(plan.agents, rel=0.1)


def test_games_count_as_simulations() -> None:
    """Each of 6 candidates plays each other one from both sides, which is 30 games."""
    made, optimizer = problem("minisim-duel", ranking__kind='"full-tournament"')
    assert constants.plan_of(made, optimizer.ask(), 6, 6).population == 30


def test_the_assessment_racing_and_budgets_are_counted() -> None:
    """As in the table of docs/noise.md, and in ``[stop]``."""

    def planned(name: str, **settings: object) -> Plan:
        made, optimizer = problem(name, **settings)
        return constants.plan_of(made, optimizer.ask(), 50, 37)

    whole = planned("minisim")
    assert (whole.after, whole.simulations) == (1863, 18_630 + 1863)
    longer = cost_model.expected_s(cost_model.blob, whole, TABLE_I)
    without = planned("minisim", assessment__budget=0)
    assert (without.after, without.simulations) == (0, 18_630)
    shorter = cost_model.expected_s(cost_model.blob, without, TABLE_I)
    assert longer / shorter == pytest.approx(1.1, rel=0.01)
    tracked = planned("minisim", assessment__budget=0, assessment__track=20)
    assert tracked.after == 200
    raced = planned("minisim", assessment__racing="true")
    assert raced.simulations == pytest.approx(1.1 * amount.RACED * 18_630, rel=0.01)
    budget = planned("minisim", stop__evaluations=50 + 9 * 37)
    assert (budget.generations, budget.simulations) == (10, 3830 + 383)
    assert planned("minisim-duel").after == 0
    made, optimizer = problem("stadium")
    assert constants.plan_of(made, optimizer.ask(), 50, 37, differ=False).after == 0


def test_the_predicted_batch_has_as_many_trials_as_dispatch_sends() -> None:
    assert constants.batch(0.075, slots=4, trials=1000) == 4
    assert constants.batch(10.0, slots=4, trials=1000) == 1
    assert constants.batch(1e-6, slots=4, trials=50) == 25


@pytest.mark.programs
def test_constants_are_measured_on_servers(tmp_path: Path) -> None:
    """A real server of this machine, in a real program."""
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "zswarm.ot",
            "predict",
            "xor",
            "--servers",
            "local",
            "--set",
            "cluster.local_slots=2",
            "--json",
        ],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert (told["servers"], told["slots"], told["constants_from"]) == (1, 2, "measured")
    measured = told["constants"]
    assert all(
        0 < measured[key] < 1
        for key in ("step_s", "message_s", "busy_s", "evolve_s", "dispatch_s")
    )
    assert measured["busy_s"] <= measured["message_s"] * 2
    assert told["plan"]["after"] == 0, "all trials of xor are alike"
    assert told["plan"]["agents"] == 4, "the four lines of the table are answered at once"
    assert [way["way"] for way in told["ways"]] == list(cost_model.WAYS)
    assert all(way["seconds"] > 0 and way["useful_slots"] >= 1 for way in told["ways"])
    assert told["ways"][0]["seconds"] < told["ways"][-1]["seconds"], "nothing is compiled"


def test_the_papers_table_needs_no_server(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    limits = ["--set", "stop.stagnation=7", "--set", "stop.fitness=0"]
    done = CliRunner().invoke(
        cli.command, ["predict", "stadium", "--table1", "--slots", "8", *limits]
    )
    assert done.exit_code == 0, done.output
    said = " ".join(done.output.split())
    assert (
        "a candidate has the fitness 0, or 7 generations in a row find nothing better"
        in said
    )
    assert "of them after the last generation" in said
    assert "Table I of the paper" in done.output
    assert "predicted for 8" in done.output
    assert max(map(len, done.output.splitlines())) <= 80
    assert done.output.index("parameters ") < done.output.index("broker ")


def test_predict_without_a_server_fails_with_one_line(tmp_path: Path) -> None:
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "zswarm.ot",
            "predict",
            "xor",
            "--servers",
            "1",
            "--no-multicast",
            "--connect",
            "tcp/127.0.0.1:9",
        ],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == EXIT_NO_SERVERS
    assert done.stderr.count("\n") == 1
    assert "zswarm-ot doctor" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["no-such"], "no-such"),
        (["xor", "--slots", "0"], "0 is not in the range"),
        (["xor", "--set", "problem.simulator=nothing", "--table1"], "nothing"),
    ],
)
def test_a_mistake_is_reported_in_one_line(arguments: list[str], told: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "zswarm.ot", "predict", *arguments],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert told in done.stderr
    assert "Traceback" not in done.stderr


# ---- looking back


def with_times(folder: Path, seconds: float) -> Run:
    """Set the times of a run's generations, this many seconds apart."""
    with sqlite3.connect(folder / "run.sqlite") as database:
        begun = database.execute(
            "SELECT value FROM meta WHERE key = 'created_at'"
        ).fetchone()[0]
        database.execute(
            "UPDATE generations SET finished_at = ? + (generation + 1) * ?",
            (begun, seconds),
        )
    database.close()
    reseal(folder)
    return Run(folder)


def test_a_run_is_predicted_from_its_first_generations(tmp_path: Path) -> None:
    """Three candidates of .01 s take three slots a third of that; the rest of .05 s is a gap."""
    notes = [
        Note("server_joined", "lab-1", count=2),
        Note("server_slots", "lab-1", count=3),
    ]
    run = with_times(written(tmp_path, range(1, 21), notes=notes), 0.05)
    champion = run.champion()
    assert champion is not None
    seen = hindsight.look_back(run, champion.genome)
    assert seen is not None
    assert seen.known == 4
    assert seen.trial_s == pytest.approx(0.01 / 3)
    assert seen.gap_s == pytest.approx(0.05 - 0.01 / 3, rel=1e-4)
    assert seen.measured_s == pytest.approx(19 * 0.05, rel=1e-4)
    assert seen.predicted_s == pytest.approx(19 * 0.05, rel=1e-4)
    plan = constants.plan_of(problem("stadium").problem, [champion.genome], 3, 3)
    assert (
        seen.broker_s
        > 19 * 3 / 3 * 2 * plan.steps * plan.agents * cost_model.TABLE_I.message_s
    )
    assert seen.files_s == pytest.approx(
        19 * (0.05 + 0.00535 + 8.833 + 0.00069), rel=1e-4
    )
    assert math.isfinite(seen.broker_s)


@pytest.mark.parametrize("generations", [3, 9])
def test_a_short_run_is_not_predicted(generations: int, tmp_path: Path) -> None:
    run = Run(
        written(
            tmp_path,
            range(1, generations + 1),
            notes=[Note("server_joined", "lab-1", count=2)],
        )
    )
    champion = run.champion()
    assert champion is not None
    assert hindsight.look_back(run, champion.genome) is None


def test_the_report_shows_predicted_and_measured_times(tmp_path: Path) -> None:
    from zswarm.ot.report import report

    run = with_times(
        written(tmp_path, range(1, 21), notes=[Note("server_joined", "lab-1", count=3)]),
        0.05,
    )
    page = report.of_run(run, trials=0)
    assert "Time, predicted and measured" in page
    assert "from generations 2 to 5: a trial takes a slot 3.3 ms" in page
    assert "by broker" in page
