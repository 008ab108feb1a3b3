"""Programs as simulators: a mistake of one is reported in one line and harms no other trial."""

import contextlib
import gc
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec
import numpy as np
import pytest

from tests.parameters import some
from zswarm import evaluate
from zswarm.config import settings_docs
from zswarm.errors import ConfigError, EvaluationError, UnknownPlugin
from zswarm.evaluate import TrialOutcomes
from zswarm.kernels.random import Stream
from zswarm.nets.representation import Representation
from zswarm.plugins import registry as plugins
from zswarm.sims.foreign import program as foreign_program
from zswarm.sims.foreign import simulator as foreign
from zswarm.sims.foreign.simulator import Foreign
from zswarm.testing import check_simulator

PROGRAM = Path(__file__).with_name("rough_program.py")
MANIFEST = 'command = [{command}]\nfiles = ["rough_program.py"]\ndescription = "a rough program"\n'
EXPECTED = "; expected turn or end"
PRINTS = "its program was ended: its standard output has {}; print to standard error only"
KILLED = "SIGKILL; the machine may have run out of memory"
LONG = "a message of 2147483648 bytes; at most 8388608 are accepted"
BROKEN = {  # in the second of three turns, where turn, end or error is expected
    "exits": f"its program ended with code 7{EXPECTED}; it wrote: cannot load map",
    "is-killed": f"its program was killed by signal 9 ({KILLED}){EXPECTED}",
    "closes": f"its program closed its input or output{EXPECTED}",
    "prints": PRINTS.format("'\\x1b[31magent 0 is here'") + EXPECTED,
    "prints-little": PRINTS.format("'1'") + EXPECTED,
    "long-frame": f"its program was ended: it sent {LONG}{EXPECTED}",
    "cut-frame": f"its program ended with code 0{EXPECTED}",
    "no-message": "its program was ended: it sent an invalid message: "
    f"Expected `int`, got `str` - at `$.agents[0]`{EXPECTED}",
    "other-message": f"its program was ended: it sent ready{EXPECTED}",
    "says-twice": "its program was ended: it sent a message unasked; "
    "expected one answer to each message",
    "leaves-a-child": f"its program ended with code 3{EXPECTED}",
}
DECIDED = {
    "error": "ProgramError: the map is\\x09closed",
    "short": "ProgramError: turn: observations: expected 4 bytes (1 agents, 1 float32 each), not 2",
    "no-agent": "ProgramError: turn: agents: expected 0 to 0, not 1",
    "two-fitnesses": "an outcome must have 1 fitness numbers and 2 metrics, not 2 and 2",
    "nan": "",
}
UNUSABLE = {
    "ends-at-once": "its program ended with code 1; expected hello; it wrote: no licence / found",
    "prints-first": PRINTS.format("'Welcome to my simulator'") + "; expected hello",
    "other-version": "its program speaks version 7 of the protocol; expected version 1",
    "ready-first": "its program was ended: it sent ready first; expected hello",
    "bad-default": "hello: setting 'steps': default: Expected `int` >= 1",
    "bad-name": "its program was ended: it sent an invalid message: Expected `str` matching regex "
    "'^[a-z][a-z0-9_]{0,62}$' - at `$.settings[0].name`; expected hello",
    "twice": "hello: setting 'steps': a keyword, or there twice",
}

Install = Callable[..., type[Foreign]]


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Install]:
    """Install the rough program that goes wrong in some way; end it with the test."""
    monkeypatch.setenv("ZSWARM_SIMULATORS", str(tmp_path))
    made: list[type[Foreign]] = []

    def write(how: str) -> type[Foreign]:
        (tmp_path / "rough_program.py").write_bytes(PROGRAM.read_bytes())
        command = ", ".join(
            f'"{part}"' for part in (sys.executable, "rough_program.py", how)
        )
        (tmp_path / f"{how}.toml").write_text(MANIFEST.format(command=command))
        made.append(plugins.load("simulator", how))
        return made[-1]

    yield write
    gc.collect()  # of instances in tracebacks
    for simulator in made:
        for program in simulator.spare:
            program.close()
    foreign.simulator_class.cache_clear()


def play(simulator: Foreign, *seeds: int) -> TrialOutcomes:
    genomes, network = genome(simulator)
    return evaluate.evaluate(
        simulator,
        network,
        genomes,
        np.zeros((len(seeds), 1), np.int64),
        np.array(seeds, np.uint64),
    )


def genome(simulator: Foreign) -> tuple[list[bytes], Representation]:
    loaded = plugins.load("representation", "fully-meshed")
    network = loaded(loaded.settings_type(), simulator.inputs, simulator.outputs)
    return network.random(1, Stream(1)), network


def members(group: int) -> list[str]:
    """Return the processes of a group that have not ended."""
    found = []
    for process in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(FileNotFoundError, ProcessLookupError):
            state, _, its_group, *_ = process.read_text().rpartition(") ")[2].split()
            if int(its_group) == group and state != "Z":
                found.append(process.parent.name)
    return found


def wait_until(condition: Callable[[], bool], what: str) -> None:
    end = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < end, what
        time.sleep(0.01)


def test_a_program_is_a_simulator_like_any_other(install: Install) -> None:
    """It keeps the contract, with the settings, names and seeds that it says."""
    loaded = install("fine")
    check_simulator(loaded)
    keys = settings_docs.keys(loaded.settings_type)
    assert [(key.name, key.type_text, key.default) for key in keys] == [
        ("steps", "int, 1 to 9", 3),
        ("speed", "float", 0.5),
        ("walls", "bool", False),
        ("task", '"none" or "sum"', "sum"),
    ]
    assert str(loaded.__doc__).startswith("Sums up.\n\nObservation")
    simulator = loaded(loaded.settings_type(steps=2))
    assert (simulator.metrics, simulator.sensors, simulator.fixed_seeds(2)) == (
        ("turns", "again"),
        ("seed",),
        None,
    )
    assert play(simulator, 4, 4).metrics[:, 0].tolist() == [2, 2]


def test_listing_starts_no_program_and_describing_does(
    install: Install, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A manifest alone is read; settings are those that the program says."""
    from zswarm.ot.commands.shared import catalog as parts

    install("fine")
    foreign.simulator_class.cache_clear()
    (part,) = (part for part in parts.installed() if part.name == "fine")
    assert (part.about, part.unstarted, part.settings) == ("a rough program", True, ())
    assert not foreign.simulator_class.cache_info().currsize
    (described,) = parts.find("fine")
    assert (described.about, [key.name for key in described.settings]) == (
        "Sums up.",
        ["steps", "speed", "walls", "task"],
    )
    assert ("inputs", 1) in described.facts


def test_settings_that_the_program_refuses_are_refused(install: Install) -> None:
    loaded = install("fine")
    with pytest.raises(ConfigError, match=r"^simulator 'fine': there is nothing to do$"):
        loaded(loaded.settings_type(task="none"))
    with pytest.raises(
        ConfigError, match=r"^problem.settings: steps: expected int <= 9$"
    ):
        evaluate.build("fine", {"steps": 10}, "fully-meshed", {})


def test_the_problem_may_fix_the_seeds(install: Install) -> None:
    loaded = install("first-seed")
    assert list(loaded(loaded.settings_type()).fixed_seeds(3)) == [5, 6, 7]


def test_a_program_that_hosts_the_network_plays_whole_trials(install: Install) -> None:
    """It gets the genome; with another network, or alone, it plays in turns."""
    install("hosts")
    simulator, network = evaluate.build("hosts", {}, "fully-meshed", {})
    assert isinstance(simulator, Foreign)
    genomes = network.random(1, Stream(1))
    once = (
        simulator,
        network,
        genomes,
        np.zeros((1, 1), np.int64),
        np.array([3], np.uint64),
    )
    assert evaluate.evaluate(*once).fitness.tolist() == [[float(len(genomes[0]))]]
    assert play(simulator, 3).metrics.tolist() == [[3.0, 1.0]]


def test_a_hosting_program_with_varied_settings_plays_whole_trials(
    install: Install,
) -> None:
    """Each is set up when its settings come, in the one program that there is."""
    loaded = install("hosts")
    simulator, network = evaluate.build(
        "hosts", {"steps": {"from": 1, "to": 9}}, "fully-meshed", {}
    )
    genomes, seeds = network.random(1, Stream(1)), np.arange(6, dtype=np.uint64)
    played = evaluate.evaluate(
        simulator, network, genomes, np.zeros((6, 1), np.int64), seeds
    )
    assert played.fitness.tolist() == [[float(len(genomes[0]))]] * 6
    assert len(loaded.spare) == 1


@pytest.mark.parametrize(
    "how", some(BROKEN, "is-killed", "prints", "cut-frame", "leaves-a-child")
)
def test_a_program_that_ends_or_breaks_the_protocol_is_a_fault_and_is_replaced(
    install: Install, how: str
) -> None:
    """The line names simulator, seed and what was expected; no process remains."""
    loaded = install(how)
    simulator = loaded(loaded.settings_type())
    before = play(simulator, 2)
    process = loaded.spare[0]._process.pid
    with pytest.raises(EvaluationError) as raised:
        play(simulator, 1)
    assert str(raised.value) == f"simulator {how!r}, trial seed 1: {BROKEN[how]}"
    wait_until(lambda: not members(process), "all that the program started ends")
    assert play(simulator, 2).fitness.tobytes() == before.fitness.tobytes()


@pytest.mark.parametrize("how", DECIDED)
def test_an_invalid_answer_is_the_outcome_of_that_trial(
    install: Install, how: str
) -> None:
    """It is NaN, the text says what was expected, and the program plays on."""
    loaded = install(how)
    simulator = loaded(loaded.settings_type())
    outcomes = play(simulator, 2, 1, 2)
    assert np.isnan(outcomes.fitness[:, 0]).tolist() == [False, True, False]
    assert DECIDED[how] in outcomes.error
    assert outcomes.metrics[2].tolist() == [3.0, 3.0], (
        "turns, and trials since it was set up"
    )


@pytest.mark.parametrize("how", some(UNUSABLE, "ends-at-once", "bad-default"))
def test_a_program_that_cannot_be_used_is_named_in_one_line(
    install: Install, how: str
) -> None:
    with pytest.raises(UnknownPlugin) as refused:
        install(how)
    assert str(refused.value) == f"simulator {how!r}: {UNUSABLE[how]}"


@pytest.mark.parametrize("how", ["bad-owner", "bad-sensors"])
def test_a_world_that_does_not_fit_together_is_refused(
    install: Install, how: str
) -> None:
    loaded = install(how)
    owners, sensors = (
        "owners: expected participants 0 to 0",
        "sensors: expected 1 names or none",
    )
    told = rf"^simulator '.*': ({owners}|{sensors}), not 2$"
    with pytest.raises(ConfigError, match=told):
        loaded(loaded.settings_type())


def test_a_silent_program_is_ended(
    install: Install, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(foreign_program, "START_S", 0.2)
    with pytest.raises(
        UnknownPlugin,
        match=r"its program was ended: it sent nothing for 0\.2 s; expected hello$",
    ):
        install("silent")


def test_output_to_standard_error_does_not_stop_a_trial(install: Install) -> None:
    """The program writes a million characters and more."""
    loaded = install("floods")
    assert np.isfinite(play(loaded(loaded.settings_type()), 1, 1).fitness).all()


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (
            'command = ["./nowhere"]\nfiles = ["here"]',
            r"\./nowhere cannot be started: No such file or directory$",
        ),
        (
            'command = ["./here"]\nfiles = ["here"]',
            r"\./here cannot be started: Permission denied$",
        ),
        (
            'command = ["./here"]\nfiles = ["there"]',
            r"bad\.toml: files: .*there is missing, or not a file$",
        ),
        ('command = ["./here"]', r"bad\.toml: key files is missing$"),
        (
            'command = []\nfiles = ["here"]',
            r"bad\.toml: command: expected array of length >= 1$",
        ),
        (
            'command = "here"\nfiles = ["here"]\nspeed = 1',
            r"bad\.toml: unknown key 'speed'; known are: command, files, description$",
        ),
        ("command", r"bad\.toml: not TOML: "),
    ],
)
def test_a_wrong_manifest_affects_no_other_simulator(
    text: str, told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is listed and hashed all the same; who uses it is told what is wrong."""
    monkeypatch.setenv("ZSWARM_SIMULATORS", str(tmp_path))
    (tmp_path / "here").write_text("")
    (tmp_path / "bad.toml").write_text(text)
    assert "bad" in plugins.names("simulator")
    assert (tmp_path / "bad.toml") in plugins.source_files("simulator", "bad")
    with pytest.raises(UnknownPlugin, match=f"^simulator 'bad': .*{told}"):
        plugins.load("simulator", "bad")


def test_the_version_hash_covers_manifest_files_and_protocol_code(
    install: Install, tmp_path: Path
) -> None:
    install("fine")
    assert {path.name for path in plugins.source_files("simulator", "fine")} == {
        "__init__.py",
        "fine.toml",
        "rough_program.py",
        "messages.py",
        "program.py",
        "simulator.py",
    }


def test_a_program_cannot_take_a_bundled_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(
        "ZSWARM_SIMULATORS", os.pathsep.join([str(tmp_path / "nowhere"), str(tmp_path)])
    )
    (tmp_path / "minisim.toml").write_text('command = ["true"]\nfiles = ["minisim.toml"]')
    (tmp_path / "my simulator.toml").write_text("")
    assert plugins.load("simulator", "minisim").__module__ == "zswarm.sims.minisim"
    assert plugins.foreign("simulator") == {}


def test_trials_one_after_the_other_have_one_program(install: Install) -> None:
    """Several instances share it, too; trials at the same time have two programs."""
    loaded = install("fine")
    first, second = loaded(loaded.settings_type()), loaded(loaded.settings_type(steps=1))
    (program,) = loaded.spare
    assert [play(simulator, 2).metrics[0, 0] for simulator in (first, second, first)] == [
        3,
        1,
        3,
    ]
    assert loaded.spare == [program]
    first.reset(1)
    second.reset(1)
    assert first._program() is program
    assert second._program() is not program
    del second
    gc.collect()
    assert len(loaded.spare) == 1
    os.kill(loaded.spare[0]._process.pid, signal.SIGKILL)
    wait_until(lambda: not loaded.spare[0].is_there(), "its end is seen")
    assert play(loaded(loaded.settings_type()), 2).error == ""


def test_a_program_and_its_children_end_with_their_parent(tmp_path: Path) -> None:
    """It is ended by SIGKILL if necessary, even if it ignores that its reader is gone."""
    code = (
        "import sys; from pathlib import Path; from zswarm.plugins.manifests import Manifest\n"
        "from zswarm.sims.foreign.program import Program\n"
        "command = ['sh', '-c', 'sleep 1000 & exec \"$0\" \"$@\"', sys.executable, *sys.argv[1:]]\n"
        "manifest = Manifest(command=command, files=['x'])\n"
        "program = Program(manifest, Path()); print(program._process.pid, flush=True); input()"
    )
    starter = subprocess.Popen(
        [sys.executable, "-c", code, str(PROGRAM), "stays"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        cwd=tmp_path,
        env=os.environ | {"ZSWARM_PLAIN": "1"},
    )
    assert starter.stdout
    program = int(starter.stdout.readline())
    assert len(members(program)) == 2
    starter.kill()
    starter.communicate()
    wait_until(lambda: not members(program), "the program and its child end")


def test_a_message_that_is_too_long_is_not_sent(install: Install) -> None:
    loaded = install("hosts")
    simulator = loaded(loaded.settings_type())
    with pytest.raises(ValueError, match=r"^a message to a simulator's program has 8388"):
        simulator.play_alone([bytes(8 << 20)], 1)
    assert msgspec.msgpack.encode(play(simulator, 3).fitness.tolist())
