"""Each run of a study is what it is alone, through any failure of processes."""

import shutil
import signal
from pathlib import Path
from typing import Any

import pytest

from tests.integration import plugin
from tests.integration.programs import Optimizer, Server, query, wait_until
from tests.promise.promise import check_run

pytestmark = pytest.mark.programs

EXPERIMENT = """
name = "{name}"
seed = 3
generations = {generations}
[problem]
simulator = "emergency-exit"
trials = {trials}
[problem.settings]
steps = {steps}
[representation]
kind = "fully-meshed"
[optimizer]
kind = "nnga"
population = 20
[cluster]
servers = "local"
local_slots = 1
"""
GRID = """
[study]
repeat = 2
at_once = 2
[study.grid]
"representation.hidden" = [1, 2]
"""
NAMES = ["hidden-1-seed-3", "hidden-2-seed-3", "hidden-1-seed-4", "hidden-2-seed-4"]


def write(
    folder: Path,
    study: str,
    *,
    name: str = "sweep",
    generations: int = 3,
    trials: int = 4,
    steps: int = 20,
) -> str:
    file = folder / f"{name}.toml"
    file.write_text(
        EXPERIMENT.format(name=name, generations=generations, trials=trials, steps=steps)
        + study
    )
    return str(file)


def slow(folder: Path) -> str:
    """Return a study long enough to disturb it."""
    return write(folder, GRID, generations=3, trials=20, steps=3000)


def play(folder: Path, name: str, *arguments: str, **environment: str) -> Optimizer:
    return Optimizer(folder, name, [*arguments, "--json"], **environment)


def ended(optimizer: Optimizer) -> dict[str, dict[str, Any]]:
    """Return the folder names of runs reported as finished."""
    return {
        Path(line["run"]).name: line
        for line in optimizer.lines()
        if line["event"] == "run"
    }


def counted(study: Path) -> int:
    runs = [path.parent for path in study.glob("*/run.sqlite")]
    return sum(
        query(run, "SELECT coalesce(sum(count), 0) FROM outcomes")[0][0]
        for run in runs
        if query(run, "SELECT 1 FROM meta")
    )


def hashes(study: Path) -> dict[str, str]:
    """Check the promise and return the runs' hashes by folder name."""
    checked = {
        run.name: check_run(run, sample=3) for run in study.iterdir() if run.is_dir()
    }
    return {name: facts.history_hash for name, facts in checked.items() if facts.finished}


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Return the hashes of the runs of ``slow`` without faults."""
    folder = tmp_path_factory.mktemp("undisturbed")
    play(folder, "ot", "run", slow(folder)).done()
    return hashes(folder / "runs" / "sweep")


def test_a_run_of_a_study_equals_a_single_run_bit_for_bit(tmp_path: Path) -> None:
    study = play(tmp_path, "study", "run", write(tmp_path, GRID))
    done = study.done()
    runs = ended(study)
    assert sorted(runs) == sorted(NAMES)
    assert (done["runs"], done["finished"], done["failed"]) == (4, 4, 0)
    assert [(each["settings"], each["runs"]) for each in done["settings"]] == [
        ({"representation.hidden": 1}, 2),
        ({"representation.hidden": 2}, 2),
    ]
    assert done["best"] == max(line["best"] for line in runs.values())
    assert done["evaluations"] == sum(line["evaluations"] for line in runs.values())
    assert {line["run"] for line in study.lines() if line["event"] == "generation"} == {
        f"runs/sweep/{name}" for name in NAMES
    }
    options = ["--seed", "4", "--set", "representation.hidden=2"]
    alone = play(
        tmp_path, "alone", "run", write(tmp_path, "", name="alone"), *options
    ).done()
    assert alone["history_hash"] == runs["hidden-2-seed-4"]["history_hash"]
    assert hashes(tmp_path / "runs" / "sweep") == {
        name: line["history_hash"] for name, line in runs.items()
    }
    assert (
        "[study]"
        not in (tmp_path / "runs" / "sweep" / NAMES[0] / "experiment.toml").read_text()
    )


def test_repeat_is_an_option_and_the_result_is_printed(tmp_path: Path) -> None:
    optimizer = Optimizer(tmp_path, "ot", ["run", write(tmp_path, ""), "--repeat", "3"])
    assert optimizer.wait() == 0, optimizer.err.read_text()
    told, out = optimizer.err.read_text().splitlines(), optimizer.out.read_text()
    assert told[:2] == [
        "in all: 3 runs, 150 evaluations, 600 simulations",
        "sweep, 3 runs: 1 slot of this machine",
    ]
    assert [line.split("  ")[0] for line in told if " of 3)" in line] == [
        "seed-3",
        "seed-4",
        "seed-5",
    ]
    assert "all runs" in out
    assert "3 of 3 runs finished" in out
    assert "study   runs/sweep" in out
    assert max(map(len, out.splitlines())) <= 80
    assert "\x1b" not in out + "".join(told)


@pytest.mark.long
def test_a_finished_study_is_reported_again_and_grows_with_its_file(
    tmp_path: Path,
) -> None:
    """A study grows by repeats, values and generations; removed values leave their runs."""
    first = play(tmp_path, "first", "run", write(tmp_path, GRID))
    first.done()
    study = tmp_path / "runs" / "sweep"
    before = {name: (study / name / "run.sqlite").stat().st_mtime_ns for name in NAMES}
    again = play(tmp_path, "again", "resume", "runs/sweep")
    assert again.done()["finished"] == 4
    assert {name: line["history_hash"] for name, line in ended(again).items()} == hashes(
        study
    )
    text = (study / "experiment.toml").read_text()
    (study / "experiment.toml").write_text(
        text.replace("repeat = 2", "repeat = 3").replace("    2,\n", "")
    )
    more = play(tmp_path, "more", "resume", "runs/sweep")
    assert more.done()["finished"] == 3
    assert sorted(ended(more)) == [
        "hidden-1-seed-3",
        "hidden-1-seed-4",
        "hidden-1-seed-5",
    ]
    assert "hidden-2-seed-3, hidden-2-seed-4" in more.err.read_text()
    assert {
        name: (study / name / "run.sqlite").stat().st_mtime_ns for name in NAMES
    } == before, "finished runs were touched"
    text = (study / "experiment.toml").read_text()
    (study / "experiment.toml").write_text(
        text.replace("generations = 3", "generations = 4").replace(
            "repeat = 3", "repeat = 1"
        )
    )
    longer = play(tmp_path, "longer", "resume", "runs/sweep").done()
    assert longer["finished"] == 1
    whole = write(tmp_path, "", name="whole", generations=4)
    alone = play(
        tmp_path, "alone", "run", whole, "--set", "representation.hidden=1"
    ).done()
    assert hashes(study)["hidden-1-seed-3"] == alone["history_hash"]


@pytest.mark.faults
def test_a_killed_study_continues_and_repeats_nothing(
    tmp_path: Path, undisturbed: dict[str, str]
) -> None:
    """One run is finished, one is running, one has only its folder."""
    study = tmp_path / "runs" / "sweep"
    killed = play(tmp_path, "killed", "run", slow(tmp_path))
    wait_until(lambda: len(ended(killed)) == 1, "a run is over")
    enough = counted(study) + 100
    wait_until(lambda: counted(study) > enough, "another one is under way")
    killed.kill()
    killed.wait()
    assert len(ended(killed)) < len(NAMES), "the study is over too early for this test"
    assert not (study / NAMES[-1]).exists()
    (study / NAMES[-1]).mkdir()
    for left in ("lock", "run.part"):
        (study / NAMES[-1] / left).touch()
    before = {
        name: query(study / name, "SELECT count(*), max(at) FROM outcomes")
        for name in ended(killed)
    }
    resumed = play(tmp_path, "resumed", "resume", "runs/sweep")
    assert resumed.done()["finished"] == len(NAMES)
    assert hashes(study) == undisturbed, "it is not the study that nothing happened to"
    assert {
        name: query(study / name, "SELECT count(*), max(at) FROM outcomes")
        for name in before
    } == before


@pytest.mark.faults
@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)]
)
def test_a_stopped_study_prints_how_to_resume(
    tmp_path: Path, undisturbed: dict[str, str], number: int, code: int
) -> None:
    study = tmp_path / "runs" / "sweep"
    stopped = play(tmp_path, "stopped", "run", slow(tmp_path))
    wait_until(lambda: counted(study) > 300, "some trials are counted")
    second = play(tmp_path, "second", "resume", "runs/sweep")
    assert second.wait() == 2, "two programs at one study"
    assert (
        "runs/sweep: this study is in use by another zswarm-ot process; stop that one first"
        in second.err.read_text()
    )
    stopped.kill(number)
    assert stopped.wait() == code
    told = stopped.err.read_text()
    assert (
        told.count("stopped; nothing is lost. Resume with: zswarm-ot resume runs/sweep")
        == 1
    )
    assert "Traceback" not in told
    play(tmp_path, "resumed", "resume", "runs/sweep").done()
    assert hashes(study) == undisturbed


@pytest.mark.faults
def test_a_run_that_fails_stops_no_other(tmp_path: Path) -> None:
    """It is named, the exit code says so, and resume tries it again."""
    rough = plugin.install(tmp_path)
    file = plugin.experiment(tmp_path, "fine")
    file.write_text(
        file.read_text() + '\n[study.grid]\n"problem.settings.how" = ["exits", "fine"]\n'
    )
    options = ["--servers", "local", "--set", "cluster.local_slots=1"]
    first = play(
        tmp_path, "first", "run", str(file), *options, PYTHONPATH=rough, ZSWARM_PLAIN="1"
    )
    again = (
        play(tmp_path, "again", "resume", "runs/rough", PYTHONPATH=rough)
        if first.wait() == 1
        else None
    )
    assert again is not None, first.err.read_text()
    assert again.wait() == 1
    for optimizer in (first, again):
        done = optimizer.lines()[-1]
        assert (done["event"], done["finished"], done["failed"]) == ("done", 1, 1)
        assert list(ended(optimizer)) == ["how-fine-seed-1"]
        (failed,) = (line for line in optimizer.lines() if line["event"] == "failed")
        assert failed["run"] == "runs/rough/how-exits-seed-1"
        assert "ended with code 7" in failed["error"]


@pytest.mark.faults
def test_a_damaged_run_stops_no_other_and_foreign_folders_are_not_removed(
    tmp_path: Path,
) -> None:
    play(tmp_path, "first", "run", write(tmp_path, GRID)).done()
    study = tmp_path / "runs" / "sweep"
    for name in NAMES[:3]:
        shutil.rmtree(study / name)
    (study / NAMES[0]).mkdir()
    (study / NAMES[0] / "thesis.tex").touch()
    shutil.copytree(study / NAMES[3], study / NAMES[1])
    with (study / NAMES[1] / "run.sqlite").open("r+b") as file:
        file.truncate(5000)
    resumed = play(tmp_path, "resumed", "resume", "runs/sweep")
    assert resumed.wait() == 1
    failed = {
        Path(line["run"]).name: line["error"]
        for line in resumed.lines()
        if line["event"] == "failed"
    }
    assert {NAMES[0]} <= set(failed) <= set(NAMES[:2]), resumed.err.read_text()
    assert (study / NAMES[1] / "run.sqlite").stat().st_size == 5000, (
        "what is damaged was touched"
    )
    assert (
        failed[NAMES[0]]
        == f"runs/sweep/{NAMES[0]}: expected a run's folder or none, but it holds thesis.tex"
    )
    assert (study / NAMES[0] / "thesis.tex").exists()
    assert NAMES[2] in ended(resumed)


def test_runs_share_a_server_and_its_slots_move_on_when_one_ends(tmp_path: Path) -> None:
    """The first has both, the others wait for them."""
    server = Server(tmp_path, "ss", capacity=2).ready()
    text = write(
        tmp_path, GRID.replace("at_once = 2", "at_once = 4"), trials=1, generations=2
    )
    options = ["--servers", "1", f"--connect={server.endpoint}", "--no-multicast"]
    try:
        done = play(tmp_path, "ot", "run", text, *options).done()
        wait_until(lambda: len(server.events("lease_released")) == 4, "all are released")
    finally:
        server.close()
    assert done["finished"] == 4
    assert len(server.events("lease_granted")) == 4
    runs = [tmp_path / "runs" / "sweep" / name for name in NAMES]
    assert all(
        query(run, "SELECT count(DISTINCT server) FROM servers") == [(1,)] for run in runs
    )


@pytest.mark.long
def test_a_study_without_the_requested_servers_ends_like_a_run(tmp_path: Path) -> None:
    """The study waits for ten seconds."""
    optimizer = play(
        tmp_path, "ot", "run", write(tmp_path, GRID), "--servers", "2", "--no-multicast"
    )
    assert optimizer.wait() == 4
    assert "0 of 2 matching servers were found in 10 s" in optimizer.err.read_text()
    assert "zswarm-ot resume runs/sweep" in optimizer.err.read_text()
