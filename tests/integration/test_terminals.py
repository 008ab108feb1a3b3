"""Output of all programs: on 80 columns, without colour, in any locale, as JSON; and hints."""

import os
import pty
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from zswarm import router
from zswarm.ot import cli as ot
from zswarm.ot.display import tables as terminal
from zswarm.security import cli as security
from zswarm.ss import cli as ss
from zswarm.system import terminal as screen

DEADLINE_S = 60.0
PROGRAMS = {
    "zswarm-ot": ot.command,
    "zswarm-ss": ss.command,
    "zswarm-router": router.command,
    "zswarm-keys": security.command,
}
WITHOUT_JSON = {
    "init": "writes a file",
    "dashboard": "serves",
    "simulator": "writes a folder",
    "completion": "prints a script",
    "zswarm-ss": "serves",
    "zswarm-router": "serves",
    "zswarm-keys": "is a list of commands",
    "drain": "has an exit code",
    "attach": "prints a log",
    "join": "installs files",
    "request": "writes a file",
    "stop": "has an exit code",
}


def walk(name: str, command: click.Command) -> Iterator[tuple[str, click.Command]]:
    yield name, command
    if isinstance(command, click.Group):
        context = click.Context(command)
        for each in command.list_commands(context):
            inner = command.get_command(context, each)
            assert inner is not None
            yield from walk(f"{name} {each}", inner)


COMMANDS = dict(
    pair for program, command in PROGRAMS.items() for pair in walk(program, command)
)


def program(
    *arguments: str, cwd: Path, **environment: str
) -> "subprocess.CompletedProcess[bytes]":
    clean = {
        name: value
        for name, value in os.environ.items()
        if name not in ("NO_COLOR", "FORCE_COLOR", "COLUMNS")
    }
    command = [sys.executable, "-m", *arguments]
    return subprocess.run(
        command,
        cwd=cwd,
        capture_output=True,
        check=False,
        timeout=DEADLINE_S,
        env=clean | {"TERM": "xterm-256color"} | environment,
    )


def on_a_terminal(arguments: Sequence[str], cwd: Path, **environment: str) -> bytes:
    """Return what a program writes to a terminal."""
    ours, its = pty.openpty()
    done = subprocess.Popen(
        [sys.executable, "-m", *arguments],
        cwd=cwd,
        stdin=its,
        stdout=its,
        stderr=its,
        env=os.environ | {"TERM": "xterm-256color", "COLUMNS": "80"} | environment,
    )
    os.close(its)
    seen = b""
    try:
        while some := os.read(ours, 4096):
            seen += some
    except OSError:  # it ended
        pass
    assert done.wait(DEADLINE_S) is not None
    os.close(ours)
    return seen


# ---- help


@pytest.mark.parametrize("columns", [80, 40])
@pytest.mark.parametrize("name", COMMANDS)
def test_help_fits_the_terminal(name: str, columns: int) -> None:
    """A long word or example may exceed 40 columns."""
    done = CliRunner().invoke(
        COMMANDS[name], ["--help"], prog_name=name, terminal_width=columns
    )
    assert done.exit_code == 0
    assert "\x1b" not in done.output
    if columns == 80:
        assert [line for line in done.output.splitlines() if len(line) > 80] == []


@pytest.mark.parametrize(
    "name",
    [
        "zswarm-ot",
        "zswarm-ot run",
        "zswarm-ot check",
        "zswarm-ot init",
        "zswarm-ot resume",
        "zswarm-ss",
    ],
)
def test_every_help_text_has_an_example(name: str) -> None:
    assert f"\n    {name} " in CliRunner().invoke(
        COMMANDS[name], ["--help"], prog_name=name
    ).output.replace("\n      ", "\n    ")


def test_commands_are_listed_in_the_order_of_use() -> None:
    shown = (
        CliRunner()
        .invoke(ot.command, ["--help"], prog_name="zswarm-ot", terminal_width=80)
        .output
    )
    places = [
        shown.index(f"\n  {name} ")
        for name in ("init", "check", "run", "resume", "list", "evaluate", "completion")
    ]
    assert places == sorted(places)
    assert all(
        shown.count(f"\n  {name} ") == 1
        for name in ot.command.list_commands(click.Context(ot.command))
    )
    assert "...\n" not in shown.split("Begin:")[1], "sentences are folded, not cut"
    assert shown.index("\nBegin:") < shown.index("\nEvolve:")


@pytest.mark.parametrize(
    ("name", "typed", "meant"),
    [
        ("zswarm-ot", ["rnu"], "run"),
        ("zswarm-ot", ["run", "--sed", "3"], "--seed"),
        ("zswarm-ss", ["statsu"], "status"),
        ("zswarm-ss", ["--capcity", "3"], "--capacity"),
        ("zswarm-router", ["--lisen", "x"], "--listen"),
        ("zswarm-keys", ["isue"], "issue"),
    ],
)
def test_the_nearest_word_is_suggested(name: str, typed: list[str], meant: str) -> None:
    done = CliRunner().invoke(PROGRAMS[name], typed)
    assert done.exit_code == 2
    assert meant in done.output.lower().split("did you mean")[1]


@pytest.mark.parametrize(
    ("typed", "line"),
    [
        (
            ["zswarm-ot", "run", "--seed", "abc"],
            "zswarm-ot: invalid value for '--seed': 'abc' is not a valid integer "
            "(see zswarm-ot run --help)",
        ),
        (
            ["zswarm-ss", "--capacity", "x"],
            "zswarm-ss: invalid value for '--capacity': 'x' is not a valid integer "
            "(see zswarm-ss --help)",
        ),
        (
            ["zswarm-router", "--log-level", "x"],
            "zswarm-router: invalid value for '--log-level': 'x' is not one of 'debug', 'info', "
            "'warning', 'error' (see zswarm-router --help)",
        ),
        (
            ["zswarm-ot", "run", "--servers"],
            "zswarm-ot: option '--servers' requires an argument (see zswarm-ot run --help)",
        ),
        (
            ["zswarm-keys", "issue", "--days"],
            "zswarm-keys: option '--days' requires an argument (see zswarm-keys issue --help)",
        ),
        (
            ["zswarm-keys", "join"],
            "zswarm-keys: missing argument 'BUNDLE' (see zswarm-keys join --help)",
        ),
    ],
)
def test_a_command_line_is_refused_in_one_line(typed: list[str], line: str) -> None:
    program = Path(sys.executable).with_name(typed[0])
    done = subprocess.run(
        [program, *typed[1:]], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (2, "", f"{line}\n")


# ---- JSON


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_that_prints_data_prints_json(name: str) -> None:
    command = COMMANDS[name]
    if (isinstance(command, click.Group) and name != "zswarm-ss") or name.split()[
        -1
    ] in WITHOUT_JSON:
        return
    assert any("--json" in option.opts for option in command.params), (
        f"{name}: add --json, or a reason to WITHOUT_JSON"
    )


# ---- colour, locales


@pytest.mark.parametrize(
    ("environment", "on_terminal", "elsewhere"),
    [
        ({}, True, False),
        ({"NO_COLOR": "1"}, False, False),
        ({"NO_COLOR": ""}, True, False),
        ({"TERM": "dumb"}, False, False),
        ({"FORCE_COLOR": "1"}, True, True),
        ({"FORCE_COLOR": "1", "NO_COLOR": "1", "TERM": "dumb"}, True, True),
        ({"FORCE_COLOR": "0"}, False, False),
        ({"FORCE_COLOR": "", "NO_COLOR": "1"}, False, False),
    ],
)
def test_colour_follows_the_environment(
    environment: dict[str, str],
    on_terminal: bool,
    elsewhere: bool,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    for name, value in (
        {"TERM": "xterm", "NO_COLOR": "", "FORCE_COLOR": ""} | environment
    ).items():
        monkeypatch.setenv(name, value)
    ours, its = pty.openpty()
    with os.fdopen(its, "w") as terminal_stream, (tmp_path / "file").open("w") as file:
        assert screen.coloured(terminal_stream) == on_terminal
        assert screen.coloured(file) == elsewhere
        assert screen.moves(terminal_stream) == (environment.get("TERM") != "dumb")
        assert not screen.moves(file)
    os.close(ours)


@pytest.mark.parametrize("environment", [{"NO_COLOR": "1"}, {"TERM": "dumb"}])
def test_a_terminal_without_colour_gets_no_escape_byte(
    environment: dict[str, str], tmp_path: Path
) -> None:
    seen = on_a_terminal(["zswarm.ot", "list"], tmp_path, **environment)
    assert b"minisim" in seen
    assert b"\x1b" not in seen


QUIET = [
    ["list"],
    ["check", "minisim"],
    ["evaluate", "runs/none"],
    ["resume", "runs/none"],
    ["init"],
    ["completion", "fish"],
    ["servers", "--no-multicast", "--wait", "0.1"],
    [
        "run",
        "minisim",
        "--set",
        "generations=1",
        "--set",
        "problem.trials=1",
        "--servers",
        "local",
    ],
]


@pytest.mark.parametrize("arguments", QUIET, ids=" ".join)
def test_output_to_a_pipe_has_no_escape_byte(
    arguments: list[str], tmp_path: Path
) -> None:
    done = program("zswarm.ot", *arguments, cwd=tmp_path)
    assert done.stdout or done.stderr
    assert b"\x1b" not in done.stdout + done.stderr
    assert b"Traceback" not in done.stderr


def test_colour_can_be_forced_into_a_pipe(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    terminal.fact("warning", "clock", "not synchronised", "set it")
    assert "\x1b[33mwarning" in capfd.readouterr().out


def test_a_locale_without_some_characters_does_not_end_a_program(tmp_path: Path) -> None:
    """The boxes of tables, and names from elsewhere."""
    (tmp_path / "runs" / "größe-日本").mkdir(parents=True)
    (tmp_path / "runs" / "größe-日本" / "run.sqlite").write_text("no record")
    ascii_only = {
        "LC_ALL": "C",
        "PYTHONUTF8": "0",
        "PYTHONCOERCECLOCALE": "0",
        "PYTHONIOENCODING": "ascii",
    }
    done = program("zswarm.ot", "list", cwd=tmp_path, **ascii_only)
    assert done.returncode == 0, done.stderr
    assert done.stdout.isascii()
    assert b"gr" in done.stdout


@pytest.mark.parametrize("columns", [80, 40])
def test_facts_are_folded_into_the_terminal(
    columns: int, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    terminal.fact(
        "broken", "runs", "runs cannot be written at all, " * 6, "go somewhere else, " * 6
    )
    terminal.entry("problem", "robots leave a room, " * 9)
    lines = capfd.readouterr().out.splitlines()
    assert len(lines) > 6
    assert max(map(len, lines)) <= columns


# ---- mistakes


def test_a_typo_in_an_experiment_names_file_line_key_and_the_fix(tmp_path: Path) -> None:
    program("zswarm.ot", "init", cwd=tmp_path)
    path = tmp_path / "experiment.toml"
    text = path.read_text().replace("#population = 50", "populaton = 50")
    path.write_text(text)
    line = text[: text.index("populaton")].count("\n") + 1
    done = program("zswarm.ot", "run", "experiment.toml", cwd=tmp_path)
    assert done.returncode == 2
    told = done.stderr.decode()
    assert told.startswith(
        f"zswarm-ot: experiment.toml:{line}: optimizer: unknown key 'populaton' "
        "(did you mean 'population'?)"
    )
    assert told.count("\n") == 1


def test_a_table_becomes_blocks_on_a_narrow_terminal(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """Nothing is lost, and no name is broken; where there is room it stays a table."""
    made = terminal.table("run", ">generations", ">best", "last at", "history")
    for name in ("runs/emergency-exit", "runs/stadium-2"):
        terminal.row(made, name, 50, "-65.7928", "2026-11-22 01:42", "")
    shown = {}
    for columns in (80, 40):
        monkeypatch.setenv("COLUMNS", str(columns))
        terminal.show(made)
        shown[columns] = [line.rstrip() for line in capfd.readouterr().out.splitlines()]
        assert max(map(len, shown[columns])) <= columns
    assert any(
        "runs/stadium-2" in line and "2026-11-22 01:42" in line for line in shown[80]
    )
    assert shown[40][:4] == [
        "runs/emergency-exit",
        "  generations  50",
        "  best         -65.7928",
        "  last at      2026-11-22 01:42",
    ]
    assert shown[40][4] == "runs/stadium-2"
