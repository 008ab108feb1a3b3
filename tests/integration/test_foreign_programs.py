"""Simulators in C and Java give the bits of the bundled one, through any fault."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec.structs import asdict

from tests.integration.programs import (
    Optimizer,
    Server,
    children,
    command_line,
    query,
    wait_until,
)
from tests.repository import REPOSITORY
from zswarm import evaluate, experiment
from zswarm.kernels.random import Stream
from zswarm.ot.build import build
from zswarm.ot.record.history_hash import History
from zswarm.plugins import registry as plugins
from zswarm.sims import emergency_exit, exit_fields

pytestmark = pytest.mark.programs

EXAMPLES = REPOSITORY / "examples" / "foreign"
EXPERIMENT = """
name = "{simulator}"
seed = 5
generations = {generations}
[problem]
simulator = "{simulator}"
trials = {trials}
[problem.settings]
{settings}
[representation]
kind = "fully-meshed"
[optimizer]
kind = "nnga"
population = {population}
"""
STADIUM = {
    "generations": 10,
    "trials": 1,
    "population": 20,
    "settings": 'field = "stadium"\nsteps = 2000',
}
RANDOM = {
    "generations": 30,
    "trials": 2,
    "population": 10,
    "settings": "agents = 4\nsteps = 40",
}
NETWORKS = [
    {"activation": "clamp"},
    {"activation": "sigmoid", "hidden": 0, "iterations": 1},
    {"activation": "relu", "hidden": 5},
    {"activation": "tanh", "hidden": 9, "iterations": 3},
]
# Trial k does what stands at k.
ROUGH = REPOSITORY / "tests" / "sims" / "foreign" / "rough_program.py"
NAN = ("error", "short", "no-agent", "nan")
HARMLESS = ("floods", "fine")
FAULTS = {
    "eats": "its program ended with code 1; expected turn or end; it wrote: .*MemoryError",
    "prints": "its program was ended: its standard output has '.*agent 0 is here'; "
    "print to standard error only",
    "cut-frame": "its program ended with code 0; expected turn or end",
    "hangs": r"simulator rough: one trial took longer than 1 s \(cluster.trial_timeout_s\)",
    "leaves-a-child": "its program ended with code 3; expected turn or end",
}
OF_ROUGH = """
name = "rough"
seed = 1
generations = 1
[problem]
simulator = "rough"
trials = {trials}
[representation]
kind = "fully-meshed"
[optimizer]
kind = "random"
population = 2
[cluster]
trial_timeout_s = 1.0
trial_memory_mb = 512
on_fault = "quarantine"
"""

# The compiler javac takes long.
BOTH = [
    ("emergency-exit-c", "in_c"),
    pytest.param("emergency-exit-java", "in_java", marks=pytest.mark.long),
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Copy the examples, to compile them there."""
    return Path(
        shutil.copytree(
            EXAMPLES,
            tmp_path_factory.mktemp("programs") / "foreign",
            ignore=shutil.ignore_patterns("classes"),
        )
    )


@pytest.fixture(scope="module")
def in_c(folder: Path) -> Path:
    if not shutil.which("make") or not shutil.which("cc"):
        pytest.skip("no C compiler, or no make")
    subprocess.run(["make", "--always-make", "--silent", "-C", folder / "c"], check=True)
    return folder / "c"


@pytest.fixture(scope="module")
def in_java(folder: Path) -> Path:
    if not shutil.which("javac"):
        pytest.skip("no Java compiler")
    sources = sorted((folder / "java").glob("*.java"))
    subprocess.run(
        ["javac", "-Xlint:all", "-Werror", "-d", folder / "java" / "classes", *sources],
        check=True,
    )
    return folder / "java"


def write(to: Path, simulator: str, size: dict[str, Any]) -> Path:
    file = to / f"{simulator}.toml"
    file.write_text(EXPERIMENT.format(simulator=simulator, **size))
    return file


def history(to: Path, size: dict[str, Any]) -> str:
    """Return the history hash of a run in which a slot's program is killed."""
    file = write(to, "emergency-exit", size)
    problem, optimizer = build(experiment.complete(experiment.load(file), str(file)))
    told = History()
    for generation in range(size["generations"]):
        genomes = optimizer.ask()
        work = problem.workload(genomes, generation)
        outcomes = evaluate.evaluate(
            problem.simulator,
            problem.representation,
            genomes,
            work.participants,
            work.seeds,
        )
        fitness = np.zeros(len(genomes))
        for trial in range(size["trials"]):  # added in their order
            fitness += outcomes.fitness[trial :: size["trials"], 0]
        told.add(genomes, fitness)
        optimizer.tell(fitness, np.empty((len(genomes), 0)))
    return told.hex()


def evolve_and_kill(
    to: Path, programs: Path, simulator: str, size: dict[str, Any]
) -> str:
    """Return the history hash of a run in which a slot's program is killed."""
    environment = {"ZSWARM_SIMULATORS": str(programs)}
    server = Server(to, "ss", capacity=2, **environment)
    arguments = [
        "run",
        str(write(to, simulator, size)),
        "--json",
        "--no-multicast",
        "--servers",
        "1",
        "--connect",
        server.endpoint,
    ]
    optimizer = Optimizer(to, "ot", arguments, **environment)
    record = to / "runs" / simulator
    programs_command = "emergency_exit" if simulator.endswith("-c") else "EmergencyExit"

    def victims() -> list[int]:
        found = [child for slot in server.workers() for child in children(slot)]
        return [child for child in found if programs_command in command_line(child)]

    try:
        wait_until(
            lambda: (
                query(record, "SELECT 1 FROM outcomes")
                or optimizer.process.poll() is not None
            ),
            "some trials are counted",
        )
        # Of one that is killed between two trials nobody takes notice.
        while not server.events("slot_died"):
            found = wait_until(
                lambda: victims() or optimizer.process.poll() is not None,
                "a program plays",
            )
            assert found is not True, "no program was killed within a trial"
            victim = found[0]
            os.kill(victim, signal.SIGKILL)
            wait_until(
                lambda victim=victim: (
                    server.events("slot_died")
                    or (len(now := victims()) == 2 and victim not in now)
                    or optimizer.process.poll() is not None
                ),
                "the slot or its program is there again",
            )
        done = optimizer.done()
    finally:
        optimizer.close()
        server.close()
    (died,) = server.events("slot_died")
    assert f"simulator '{simulator}', trial seed " in died["reason"]
    assert (
        ": its program was killed by signal 9 (SIGKILL; the machine may have run out of memory); "
        in died["reason"]
    )
    assert done["requeued"] > 0
    return str(done["history_hash"])


def test_c_evolves_as_the_bundled_simulator_does_though_it_is_killed(
    tmp_path: Path, in_c: Path
) -> None:
    """It plays whole trials in the stadium with its own network."""
    assert evolve_and_kill(tmp_path, in_c, "emergency-exit-c", STADIUM) == history(
        tmp_path, STADIUM
    )


@pytest.mark.long
def test_java_evolves_as_the_bundled_simulator_does_though_it_is_killed(
    tmp_path: Path, in_java: Path
) -> None:
    """The program plays in turns on random fields."""
    assert evolve_and_kill(tmp_path, in_java, "emergency-exit-java", RANDOM) == history(
        tmp_path, RANDOM
    )


@pytest.mark.long
@pytest.mark.parametrize("language", ["c", "java"])
@pytest.mark.parametrize("field", ["random", "stadium"])
def test_whole_runs_have_the_same_history(
    language: str, field: str, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    """The experiments are the examples with fewer generations."""
    trials = 10 if field == "random" else 1
    size = {
        "generations": 4,
        "trials": trials,
        "population": 20,
        "settings": f'field = "{field}"\nseed = 7',
    }
    programs = request.getfixturevalue(f"in_{language}")
    simulator = f"emergency-exit-{language}"
    arguments = [
        "run",
        str(write(tmp_path, simulator, size)),
        "--json",
        "--servers",
        "local",
        "--set",
        "cluster.local_slots=2",
    ]
    done = Optimizer(tmp_path, "ot", arguments, ZSWARM_SIMULATORS=str(programs)).done()
    assert done["history_hash"] == history(tmp_path, size)


@pytest.mark.faults
def test_a_program_whose_controllers_stay_at_the_optimizer_has_the_same_history(
    in_c: Path, tmp_path: Path
) -> None:
    """Though it could decide for them itself."""
    size = RANDOM | {"generations": 2, "trials": 1}
    arguments = [
        "run",
        str(write(tmp_path, "emergency-exit-c", size)),
        "--json",
        "--servers",
        "local",
    ]
    asked = ["--set", "cluster.controller='optimizer'", "--set", "cluster.local_slots=2"]
    done = Optimizer(
        tmp_path, "ot", [*arguments, *asked], ZSWARM_SIMULATORS=str(in_c)
    ).done()
    assert done["history_hash"] == history(tmp_path, size)


def rough(folder: Path, each: tuple[str, ...]) -> Path:
    """Write the manifest of a program that acts differently in each trial."""
    folder.mkdir()
    shutil.copy(ROUGH, folder)
    command = [sys.executable, ROUGH.name, ",".join(each)]
    (folder / "rough.toml").write_text(
        f'command = {json.dumps(command)}\nfiles = ["{ROUGH.name}"]\n'
    )
    return folder


@pytest.mark.long
def test_a_misbehaving_program_affects_only_its_own_trials(tmp_path: Path) -> None:
    """Count a wrong answer as the trial's outcome, and an end or a hang as a fault, three times.

    When its files are not those any more that the server began with, no slot goes on with it.
    """
    each = (*NAN, "floods", *FAULTS, "fine")
    mine, theirs = rough(tmp_path / "mine", each), rough(tmp_path / "theirs", each)
    (tmp_path / "rough.toml").write_text(OF_ROUGH.format(trials=len(each)))
    server = Server(
        tmp_path, "ss", capacity=1, ZSWARM_SIMULATORS=str(theirs), ZSWARM_PLAIN="1"
    ).ready()
    arguments = [
        "run",
        "rough.toml",
        "--json",
        "--no-multicast",
        "--servers",
        "1",
        "--connect",
        server.endpoint,
    ]
    optimizers: list[Optimizer] = []

    def start(name: str, *more: str) -> Optimizer:
        optimizers.append(
            Optimizer(
                tmp_path,
                name,
                [*arguments, *more],
                ZSWARM_SIMULATORS=str(mine),
                ZSWARM_PLAIN="1",
            )
        )
        return optimizers[-1]

    try:
        done = start("ot").done()
        with (theirs / ROUGH.name).open("a") as changed:
            changed.write("# a version later\n")
        later = start("later", "--set", "problem.settings.steps=4")
        refused = wait_until(
            lambda: [
                line
                for line in later.err.read_text().splitlines()
                if " refused: " in line
            ],
            "it is told",
        )
    finally:
        for program in (*optimizers, server):
            program.close()
    fitness = np.full(2 * len(each), np.inf)
    for trials, values in query(
        tmp_path / "runs" / "rough", "SELECT trials, fitness FROM outcomes"
    ):
        fitness[np.frombuffer(trials, "<u4")] = np.frombuffer(values, "<f8")
    for candidate in np.isfinite(fitness).reshape(2, -1):
        assert {what for what, fine in zip(each, candidate, strict=True) if fine} == set(
            HARMLESS
        )
    assert done["faulted"] == 2 * len(FAULTS)
    told = [
        text
        for (text,) in query(
            tmp_path / "runs" / "rough", "SELECT text FROM events WHERE event = 'fault'"
        )
    ]
    for what, words in FAULTS.items():
        mine_ = [text for text in told if re.search(words, text)]
        assert len(mine_) == 6, (what, told)
    assert len(refused) == 1
    assert refused[0].endswith(
        "files of rough, fully-meshed or zswarm changed after the server was started; start the "
        "server again, for a run must not continue with other code"
    )


@pytest.mark.parametrize(
    "network", NETWORKS, ids=lambda network: str(network["activation"])
)
def test_the_network_in_c_has_the_bits_of_the_kernel(
    network: dict[str, Any], in_c: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All activations are compared, with more and with fewer neurons."""
    monkeypatch.setenv("ZSWARM_SIMULATORS", str(in_c))
    theirs = outcomes("emergency-exit-c", network)
    assert theirs == outcomes("emergency-exit", network)


def outcomes(simulator: str, network: dict[str, Any], **settings: Any) -> bytes:
    built = evaluate.build(simulator, settings, "fully-meshed", network)
    genomes = built[1].random(12, Stream(2))
    played = evaluate.evaluate(
        *built, genomes, np.arange(12).reshape(-1, 1), np.arange(12, dtype=np.uint64)
    )
    assert not played.error
    assert len({*played.fitness[:, 0].tolist()}) > 6
    return played.fitness.tobytes() + played.metrics.tobytes()


@pytest.mark.parametrize(("theirs", "compiled"), BOTH)
def test_a_program_plays_turns_with_unknown_networks(
    theirs: str,
    compiled: str,
    request: pytest.FixtureRequest,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The fitness equals that of the bundled simulator."""
    monkeypatch.setenv("ZSWARM_SIMULATORS", str(request.getfixturevalue(compiled)))
    fitness = []
    for simulator in (theirs, "emergency-exit"):
        built, network = evaluate.build(simulator, {"agents": 3}, "ctrnn", {})
        assert getattr(built, "hosted", None) is None
        genomes = network.random(3, Stream(2))
        played = evaluate.evaluate(
            built,
            network,
            genomes,
            np.arange(3).reshape(-1, 1),
            np.array([1, 2, 2**64 - 1], np.uint64),
        )
        fitness.append(played.fitness.tobytes() + played.metrics.tobytes())
    assert fitness[0] == fitness[1]


@pytest.mark.parametrize(("simulator", "compiled"), BOTH)
def test_the_settings_are_those_of_the_bundled_simulator(
    simulator: str,
    compiled: str,
    request: pytest.FixtureRequest,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Names, defaults, and what is refused."""
    monkeypatch.setenv("ZSWARM_SIMULATORS", str(request.getfixturevalue(compiled)))
    theirs, ours = plugins.load("simulator", simulator), emergency_exit.EmergencyExit
    assert asdict(theirs.settings_type()) == asdict(ours.settings_type())
    built = theirs(theirs.settings_type(seed=9))
    assert (built.sensors, built.actuators, built.metrics) == (
        ours.sensors,
        ours.actuators,
        ours.metrics,
    )
    assert list(built.fixed_seeds(2)) == [9, 10]
    for refused in ({"width": 30}, {"agents": 400}):
        with pytest.raises(
            experiment.ConfigError, match=r"width must not exceed height|do not fit on"
        ):
            theirs(theirs.settings_type(**refused))


def test_the_stadium_is_that_of_the_bundled_simulator() -> None:
    said = (EXAMPLES / "stadium.txt").read_text().split()
    assert said == [*exit_fields.STADIUM, *exit_fields.STADIUM_AGENTS]
