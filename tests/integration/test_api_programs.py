"""Programs that use ``import zswarm`` survive interruptions and failing simulators."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

import zswarm
from tests.integration import plugin, programs
from tests.integration.programs import wait_until

pytestmark = pytest.mark.programs

INTERRUPTED = """
import sys
import zswarm

problem = zswarm.problem("stadium")
with zswarm.connect("local", local_slots=1) as cluster:
    before = cluster.evaluate(problem, problem.random(3))
    try:
        zswarm.run(zswarm.load("stadium", {"generations": 1_000_000}), connection=cluster)
    except KeyboardInterrupt as stopped:
        print(*stopped.__notes__, flush=True)
    try:
        print("evaluating", flush=True)
        cluster.evaluate(zswarm.problem("stadium", trials=100_000), problem.random(1000))
    except KeyboardInterrupt:
        print("interrupted again", flush=True)
    print((cluster.evaluate(problem, problem.random(3)) == before).all())
"""

FAILING = """
import zswarm

with zswarm.connect("local", local_slots=1) as cluster:
    for how in ("fine", "raises", "exits", "fine"):
        problem = zswarm.problem(simulator="rough", settings={"how": how}, trials=3)
        try:
            fitness = cluster.evaluate(problem, problem.random(2))
            print(fitness, cluster.outcomes(problem, problem.random(1)).fitness)
        except zswarm.EvaluationError as error:
            print(error)
"""


def test_an_interrupted_program_keeps_its_servers_and_its_run(tmp_path: Path) -> None:
    """Ctrl-C and the stop button of a notebook interrupt all of the program's process group."""
    log = tmp_path / "out"
    with log.open("wb") as out:
        program = subprocess.Popen(
            [sys.executable, "-c", INTERRUPTED],
            cwd=tmp_path,
            stdout=out,
            stderr=subprocess.STDOUT,
            process_group=0,
        )
    folder = tmp_path / "runs" / "stadium"
    try:
        wait_until(lambda: (folder / "champion.zsc").exists(), "a generation is over")
        os.killpg(program.pid, signal.SIGINT)
        wait_until(
            lambda: "evaluating" in log.read_text(),
            "the run is stopped, and it evaluates",
        )
        os.killpg(program.pid, signal.SIGINT)
        assert program.wait(programs.DEADLINE_S) == 0
    finally:
        program.kill()
        program.wait()
    assert log.read_text().splitlines() == [
        "nothing is lost; to resume: zswarm.resume('runs/stadium')",
        "evaluating",
        "interrupted again",
        "True",
    ]
    left = zswarm.read(folder)
    assert not left.going_on
    assert not left.finished
    assert left.generations() > 0


def test_failing_simulators_are_reported_and_the_connection_continues(
    tmp_path: Path,
) -> None:
    """An exception in a trial makes its outcome NaN; the end of a process is an error."""
    environment = os.environ | {
        "PYTHONPATH": plugin.install(tmp_path),
        "ZSWARM_PLAIN": "1",
    }
    done = subprocess.run(
        [sys.executable, "-c", FAILING],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    fine, raises, exits, again = done.stdout.splitlines()
    assert "nan" not in fine
    assert raises.startswith("[nan nan] [[")
    assert raises.count("nan") == 3, "of the outcomes one trial of three"
    assert exits.startswith("a trial ended in a fault 3 times, last on local-")
    assert again == fine
    assert done.stderr == ""
