"""Run every command that a document shows, page by page, each in a fresh folder.

A page is one shell in a network of its own, as the machine lab-01, so programs that find each other
by multicast do, and find nobody else. What a page shows as output must come, but for what differs
from one run to the next: times, ids, slots. What cannot be run here stands in one table below, with
the reason and the test that runs it instead.
"""

import json
import os
import re
import shlex
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import platformdirs
import pytest

from tests.docs.documents import DOCUMENTS, REPOSITORY, Block, blocks
from tests.integration.programs import without_pictures
from zswarm import experiment
from zswarm.plugins import registry as plugins

INSTALLS = "installs from the outside"
DEPLOY, KEYS = (
    "tests/integration/test_machines.py",
    "tests/security/test_keys_document.py",
)
# (document, first line of the block, or * for all): why it is not run here, and where it is.
NOT_RUN: dict[tuple[str, str], tuple[str, str]] = {
    ("README.md", "make run     # sets everything up and evolves the built-in example"): (
        INSTALLS,
        ".ci/run",
    ),
    (
        "README.md",
        "pipx install '.[ot]'",
    ): (
        INSTALLS,
        ".ci/run",
    ),
    (
        "CONTRIBUTING.md",
        "make test     # creates .venv, installs everything, and runs the tests: some minutes",
    ): (INSTALLS, ".ci/run"),
    ("commands.md", '$ zswarm-ot import "Emergency Exit_g199 (0.46).zre"'): (
        "needs a file of FREVO's",
        "tests/ot/importing/test_frevo.py",
    ),
    (
        "commands.md",
        "$ zswarm-ot import gen_last_1_champ --set problem.settings.mission=foraging",
    ): ("needs a file of ARGoS's", "tests/robots/argos/test_argos.py"),
    ("studies.md", "zswarm-ot run methods.toml"): (
        "has the tutorial's study, which is run there",
        "tests/docs/test_docs_commands.py",
    ),
    ("tutorial.md", "pipx install '.[ot]'"): (INSTALLS, ".ci/run"),
    ("dashboard.md", "*"): (
        "is looked at in a browser",
        "tests/browser/test_dashboard.py",
    ),
    ("deploy.md", "*"): (
        "needs machines with systemd, of which root is the user",
        DEPLOY,
    ),
    (
        "faults.md",
        "make test                # 10 schedules; make long 1,240 more, make thorough another 750",
    ): (
        "runs tests, for minutes",
        ".ci/run",
    ),
    ("from-numpy.md", "*"): (
        "is one module for each step",
        "tests/docs/test_from_numpy.py",
    ),
    ("python.md", "*"): ("is one program", "tests/docs/test_python_document.py"),
    ("keys.md", "*"): ("is about several machines", KEYS),
    (
        "ros.md",
        "python -m zswarm.ros.simulation.node --link rospy --profile stageros --settings "
        "'{\"robots\": 2}' --seed 1 --poses poses.npy",
    ): ("needs ROS 1, and robots that answer", "tests/robots/test_packages_drive.py"),
    (
        "ros.md",
        "sudo apt install git cmake g++ libfltk1.3-dev fluid libjpeg-dev libpng-dev "
        "libltdl-dev libglu1-mesa-dev",
    ): (INSTALLS, "tests/ros/stage/build.sh"),
    ("ros.md", ". ~/stage/setup.sh"): (
        "needs Stage",
        "tests/ros/stage/test_evolution.py",
    ),
    ("ros-files.md", "*"): (
        "needs ROS 1, which it installs",
        "tests/integration/test_ros_files_runs.py",
    ),
}
# What a page takes for granted at its beginning.
GIVEN = {
    "commands.md": "mkdir -p ~/.config/fish/conf.d\n"
    "zswarm-ot run minisim --servers local --set generations=2",
    "export.md": "zswarm-ot run stadium --servers local --set generations=5",
    "figures.md": "zswarm-ot run stadium --servers local --set generations=20",
    "optimizers.md": "zswarm-ot run minisim-elites --servers local --set generations=20",
    "record.md": "zswarm-ot run minisim --servers local",
    "replay.md": "zswarm-ot run stadium --servers local --set generations=5",
    "robots.md": "zswarm-ot run turtlebot-exit --servers local --set generations=2",
}
# Pages whose runs draw pictures, which takes as long as many of these runs.
PICTURED = {"README.md", "figures.md", "optimizers.md", "own-simulator.md", "tutorial.md"}
# Instead of what a page says, what is so here.
HERE = {
    "ROUTER": "127.0.0.1",
    "--repeat 20": "--repeat 2",
    "run stadium --seed": "run stadium --set generations=20 --seed",
    "run stadium   ": "run stadium --set generations=10   ",
    "run --connect": "run --set generations=10 --connect",
    "run stadium --connect": "run stadium --set generations=10 --connect",
    "repeat = 5\nbudget = { evaluations = 300 }": "repeat = 2\nbudget = { evaluations = 60 }",
    # Its 100 generations are played in tests/integration/test_own_simulator.py.
    "run lost-robots.toml": "run lost-robots.toml --set generations=4",
    "--generations 20 --trials 40": "--generations 3 --trials 40",
    "run rendezvous.toml": "run rendezvous.toml --set generations=3",
    "run epuck-aggregation": "run epuck-aggregation --set generations=1 "
    "--set optimizer.population=4 --set problem.trials=1 --set assessment.budget=0",
}

SHELL = r"""
set -e -o pipefail
hostname lab-01
ip link set lo up
ip link add eth0 type veth peer name switch
ip link set switch up
ip address add 192.168.1.5/24 dev eth0
ip address add 192.168.1.6/24 dev eth0
ip link set eth0 up
ip route add 224.0.0.0/4 dev eth0
cd "$FOLDER"

serve() {  # a program that serves until it is stopped goes on in the background once it is ready
    case "$2" in status|drain|-h|--help|--version) command "$@"; return;; esac
    daemons=$((daemons + 1))
    command "$@" > "$STEPS/daemon-$daemons" 2>&1 &
    for _ in $(seq 600); do
        if grep -q -e _ready -e '^dashboard: http' "$STEPS/daemon-$daemons"; then return; fi
        if ! kill -0 $! 2> /dev/null; then cat "$STEPS/daemon-$daemons"; return 1; fi
        sleep 0.1
    done
    return 1
}
stop() {  # a section does not count on the programs of the one before
    local running="$(jobs -p)"
    if [ "$running" ]; then kill $running; wait $running || true; fi
}
zswarm-ss() { serve zswarm-ss "$@"; }
zswarm-router() { serve zswarm-router "$@"; }
zswarm-ot() { case "$1" in dashboard) serve zswarm-ot "$@";; *) command zswarm-ot "$@";; esac; }
pip() {  # what it would do with a package that has no more than a module, without asking an index
    case "$*" in "install -e ."|"install -e . pytest");; *) false;; esac
    python "$STEPS/install.py"
    export PYTHONPATH="$PWD:$PYTHONPATH"
}
"""
INSTALL = """
import pathlib, tomllib
project = tomllib.loads(pathlib.Path("pyproject.toml").read_text())["project"]
folder = pathlib.Path(project["name"].replace("-", "_") + "-" + project["version"] + ".dist-info")
folder.mkdir(exist_ok=True)
name, version = project["name"], project["version"]
(folder / "METADATA").write_text(f"Metadata-Version: 2.1\\nName: {name}\\nVersion: {version}\\n")
lines = []
for group, points in project["entry-points"].items():
    lines += [f"[{group}]", *(f"{name} = {target}" for name, target in points.items())]
(folder / "entry_points.txt").write_text("\\n".join(lines) + "\\n")
"""
INTERRUPT = """
import signal, subprocess, sys
program = subprocess.Popen(
    sys.argv[1:], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
)
for line in program.stdout:
    print(line, end="", flush=True)
    if line.startswith("generation 5/"):
        program.send_signal(signal.SIGINT)
assert program.wait() == 130, program.returncode
"""
VARIES = [
    (re.compile(r"\b\d+(\.\d+)? s\b"), "0 s"),
    (re.compile(r"\b\d+ slots?\b"), "0 slots"),
    (re.compile(r"-[0-9a-f]{8}\b"), "-00000000"),
    (re.compile(r"\b\d{4}-\d\d-\d\d \d\d:\d\d\b"), "2026-01-01 00:00"),
    (re.compile(r"\s+"), " "),
]
NAMESPACES = [
    "unshare",
    *(() if os.geteuid() == 0 else ("--user", "--map-root-user")),
    "--net",
    "--uts",
    "--mount",
    "--pid",
    "--fork",
    "--kill-child",
    "--mount-proc",
]


def reason(block: Block) -> tuple[str, str] | None:
    """Return why a block is not run here, if so."""
    return NOT_RUN.get((block.document, "*")) or NOT_RUN.get(
        (block.document, block.first)
    )


def typed(block: Block) -> Iterator[tuple[str, list[str] | None]]:
    """Return a block's commands with the lines they must print; None: any."""
    if not block.transcript:
        yield block.text, None
        return
    for part in re.split(r"^\$ ", block.text, flags=re.M)[1:]:
        command, *said = part.rstrip("\n").split("\n")
        yield command, said


def same(said: str) -> str:
    """Return a line without what differs from run to run."""
    for pattern, instead in VARIES:
        said = pattern.sub(instead, said)
    return said.strip()


def says(expected: list[str], output: str) -> bool:
    """Return whether an output is the expected one; ``...`` stands for any lines."""
    pattern = "".join(
        r"(?:[^\n]*\n)*"
        if line.strip() == "..."
        else re.escape(same(line)).replace("…", ".*") + "\n"
        for line in expected
    )
    return bool(
        re.fullmatch(
            pattern,
            "".join(f"{same(line)}\n" for line in output.rstrip("\n").split("\n")),
        )
    )


def script(
    page: Path, steps: Path
) -> tuple[str, list[tuple[Block, str, list[str] | None]]]:
    """Return the shell script that does what a page says, and its steps."""
    lines, done = [SHELL], []
    if page.name in GIVEN:
        lines.append(f"{GIVEN[page.name]} > {steps}/given 2>&1")

    def step(block: Block, command: str, expected: list[str] | None) -> None:
        number = len(done)
        done.append((block, command, expected))
        lines.append(
            f"echo {number} > {steps}/at\n{{\n{command}\n}} > {steps}/{number} 2>&1 < /dev/null"
        )

    section = ""
    for block in blocks(page):
        if block.section != section:
            lines.append("stop")
            section = block.section
        if block.file and block.language != "sh":
            (steps / f"file-{block.line}").write_text(block.text)
            lines.append(
                f"mkdir -p $(dirname {block.file}) && cp {steps}/file-{block.line} {block.file}"
            )
        elif block.language == "python" and not reason(block):
            (steps / f"{block.line}.py").write_text(block.text)
            step(block, f"python {steps}/{block.line}.py", None)
        elif block.has_commands and not reason(block):
            for command, expected in typed(block):
                for word, instead in HERE.items():
                    command = command.replace(word, instead)
                if expected and "^C" in expected:
                    command = f"python {steps}/interrupt.py {command}"
                    expected = [line for line in expected if line != "^C"]
                step(block, command, expected)
    return "\n".join(lines) + f"\necho end > {steps}/at\n", done


def to_run(page: Path) -> bool:
    return any(
        (block.has_commands or block.language == "python") and not reason(block)
        for block in blocks(page)
    )


@pytest.mark.docs
@pytest.mark.parametrize(
    "page", [page for page in DOCUMENTS if to_run(page)], ids=lambda page: page.name
)
def test_the_commands_of_a_page_work(page: Path, tmp_path: Path) -> None:
    """Each command ends well, and says what the page says."""
    if subprocess.run(
        [*NAMESPACES, "ip", "link"], capture_output=True, check=False
    ).returncode:
        pytest.skip(
            "no namespaces: this needs root, or users who may make them, and the programs unshare "
            "and ip"
        )
    folder, steps = tmp_path / "folder", tmp_path / "steps"
    folder.mkdir()
    steps.mkdir()
    for name in ("tests", "docs", "examples", "deploy", "benchmarks"):
        (folder / name).symlink_to(REPOSITORY / name)
    (steps / "install.py").write_text(INSTALL)
    (steps / "interrupt.py").write_text(INTERRUPT)
    text, done = script(page, steps)
    path = [str(folder), str(REPOSITORY)]
    if page.name not in PICTURED:
        path = [without_pictures(tmp_path), *path]
    cache = os.environ.get("ZSWARM_CACHE") or platformdirs.user_cache_dir("zswarm")
    environment = os.environ | {
        "FOLDER": str(folder),
        "STEPS": str(steps),
        "HOME": str(tmp_path),
        "RUNTIME_DIRECTORY": str(tmp_path),
        "ZSWARM_CACHE": cache,
        "MPLCONFIGDIR": platformdirs.user_cache_dir("matplotlib"),
        "ZSWARM_KEYS": "none",
        "COLUMNS": "100",
        "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}",
        "PYTHONPATH": os.pathsep.join(path),
        "PYTHONDONTWRITEBYTECODE": "1",
    }
    ended = subprocess.run(
        [*NAMESPACES, "bash", "-c", text],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=900,
    )
    at = (steps / "at").read_text().strip() if (steps / "at").exists() else ""
    assert at, ended.stderr
    if at != "end":
        block, command, _ = done[int(at)]
        pytest.fail(
            f"{page.name}:{block.line}: "
            f"{command}\n{(steps / at).read_text()[-3000:]}\n{ended.stderr}"
        )
    for number, (block, command, expected) in enumerate(done):
        output = (steps / str(number)).read_text()
        assert expected is None or says(expected, output), (
            f"{page.name}:{block.line}: {command} says\n{output[-3000:]}"
        )


def test_the_readme_begins_with_how_to_run_it_and_how_to_test_it() -> None:
    """The script of the checks runs the tests by the same command."""
    first = next(iter(blocks(REPOSITORY / "README.md")))
    assert re.findall(r"^make \w+", first.text, re.M) == ["make run", "make test"]
    assert re.search(
        r"^timed test make test\b", (REPOSITORY / ".ci" / "run").read_text(), re.M
    )


def test_blocks_that_are_not_run_exist() -> None:
    """The test that runs such a block instead exists, too."""
    there = {
        (block.document, name)
        for page in DOCUMENTS
        for block in blocks(page)
        for name in (block.first, "*")
    }
    assert set(NOT_RUN) <= there
    assert all((REPOSITORY / instead).exists() for _, instead in NOT_RUN.values())
    assert set(GIVEN) <= {page.name for page in DOCUMENTS}


@pytest.mark.parametrize("page", DOCUMENTS, ids=lambda page: page.name)
def test_every_block_has_the_syntax_of_its_language(page: Path, tmp_path: Path) -> None:
    """Commands are marked as such; TOML, JSON and Python can be read; an experiment is one."""
    for block in blocks(page):
        where = f"{page.name}:{block.line}"
        if block.has_commands:
            assert block.language == "sh" or block.transcript or reason(block), (
                f"{where}: mark it as sh, or begin with $"
            )
        match block.language:
            case "toml":
                problem = tomllib.loads(block.text).get("problem", {})
                if problem.get("simulator") in plugins.BUNDLED["simulator"]:
                    (tmp_path / "shown.toml").write_text(block.text)
                    experiment.load(tmp_path / "shown.toml")
            case "json":
                try:
                    json.loads(block.text)
                except ValueError:  # one object a line
                    for line in block.text.splitlines():
                        json.loads(line)
            case "python":
                compile(block.text, where, "exec")
            case "sh":
                for line in re.sub(
                    r"<<'?(\w+)'?\n.*?^\1$", "", block.text, flags=re.S | re.M
                ).splitlines():
                    shlex.split(line, comments=True)


def test_outputs_are_compared_without_variable_parts() -> None:
    assert says(
        ["a 1.5 s", "...", "lab-01-51c09a3e joined with 4 slots"],
        "a 22 s\nx\ny\nlab-01-aaaaaaaa joined with 1 slot\n",
    )
    assert says(["...", "history 7825"], "history 7825\n")
    assert not says(["history 7825"], "history 7826\n")
    assert not says(["history 7825"], "history 7825\nmore\n")
