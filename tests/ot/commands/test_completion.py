"""Real shells complete real lines."""

import os
import pty
import select
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from zswarm import experiment
from zswarm.plugins import registry as plugins

EXAMPLES = {path.stem for path in experiment.examples_folder().glob("*.toml")}
DEADLINE_S = 30.0
ENTRIES = {
    "zswarm-ot": "zswarm.ot.cli",
    "zswarm-ss": "zswarm.ss.cli",
    "zswarm-router": "zswarm.router",
    "zswarm-keys": "zswarm.security.cli",
}


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the programs, two runs and an experiment; the environment finds them."""
    (tmp_path / "bin").mkdir()
    for program, module in ENTRIES.items():
        path = tmp_path / "bin" / program
        path.write_text(f"#!{sys.executable}\nfrom {module} import main\nmain()\n")
        path.chmod(0o755)
    for run in ("stadium", "study/seed-3"):
        (tmp_path / "runs" / run).mkdir(parents=True)
        (tmp_path / "runs" / run / "run.sqlite").touch()
    (tmp_path / "mine.toml").touch()
    monkeypatch.setenv("PATH", f"{tmp_path}/bin{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("TERM", "dumb")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def script(shell: str) -> str:
    return subprocess.run(
        ["zswarm-ot", "completion", shell], check=True, capture_output=True, text=True
    ).stdout


class Typist:
    """Type into an interactive shell on a separate terminal."""

    def __init__(self, *command: str) -> None:
        self._terminal, other = pty.openpty()
        self._shell = subprocess.Popen(
            command, stdin=other, stdout=other, stderr=other, start_new_session=True
        )
        os.close(other)
        self._seen = ""

    def type(self, text: str, until: str) -> str:
        """Type a text; return what the terminal shows from then on, up to ``until``."""
        self._seen = ""
        os.write(self._terminal, text.encode())
        end = time.monotonic() + DEADLINE_S
        while until not in self._seen:
            assert time.monotonic() < end, f"no {until!r} in {self._seen!r}"
            if select.select([self._terminal], [], [], 0.1)[0]:
                self._seen += os.read(self._terminal, 4096).decode(errors="replace")
        return self._seen

    def close(self) -> None:
        self._shell.kill()
        self._shell.wait(DEADLINE_S)
        os.close(self._terminal)


@pytest.fixture(params=["bash", "zsh"])
def typist(request: pytest.FixtureRequest, home: Path) -> Iterator[Typist]:
    shell = str(request.param)
    if shutil.which(shell) is None:
        pytest.skip(f"{shell} is not installed")
    (home / "script").write_text(script(shell))
    started = Typist(
        *{"bash": ["bash", "--norc", "--noprofile", "-i"], "zsh": ["zsh", "-f", "-i"]}[
            shell
        ]
    )
    try:
        prepare = {
            "bash": "bind 'set enable-bracketed-paste off'",
            "zsh": "autoload -U compinit && compinit -u -D",
        }[shell]
        started.type(f"{prepare}; . ./script; echo rea''dy\n", "ready")
        yield started
    finally:
        started.close()


def test_a_shell_completes_what_is_typed(typist: Typist) -> None:
    """Commands, options, examples, experiment files, runs; of the other programs, too."""
    for typed, completed in (
        ("zswarm-ot run sta", "stadium"),
        ("zswarm-ot run mine", "mine.toml"),
        ("zswarm-ot resume runs/sta", "runs/stadium"),
        ("zswarm-ss --cap", "--capacity"),
    ):
        assert completed in typist.type(typed + "\t", completed)
        typist.type("\x15echo go''ne\n", "gone")


def test_fish_completes_what_is_typed(home: Path) -> None:
    if shutil.which("fish") is None:
        pytest.skip("fish is not installed")
    (home / "script").write_text(script("fish"))
    for typed, completed in (
        ("zswarm-ot run sta", "stadium"),
        ("zswarm-ot res", "resume"),
        ("zswarm-keys jo", "join"),
    ):
        line = f"source script; complete -C '{typed}'"
        done = subprocess.run(
            ["fish", "--no-config", "-c", line],
            check=True,
            capture_output=True,
            text=True,
        )
        assert completed in done.stdout, done.stderr


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("zswarm-ot run ", {*EXAMPLES, "mine.toml"}),
        ("zswarm-ot resume ", {"runs/stadium", "runs/study/seed-3"}),
        ("zswarm-ot init --simulator ", set(plugins.names("simulator"))),
        (
            "zswarm-ot servers --for m",
            {"mine.toml", *(name for name in EXAMPLES if name.startswith("m"))},
        ),
        ("zswarm-ot completion ", {"bash", "zsh", "fish"}),
    ],
)
def test_names_are_suggested(words: str, expected: set[str], home: Path) -> None:
    environment = os.environ | {
        "COMP_WORDS": words,
        "COMP_CWORD": str(len(words.split(" ")) - 1),
    }
    environment["_ZSWARM_OT_COMPLETE"] = "bash_complete"
    done = subprocess.run(
        ["zswarm-ot"], env=environment, check=True, capture_output=True, text=True
    )
    assert {
        line.removeprefix("plain,")
        for line in done.stdout.splitlines()
        if line.startswith("plain,")
    } == expected


def test_the_script_is_valid_for_its_shell(home: Path) -> None:
    for shell in ("bash", "zsh", "fish"):
        text = script(shell)
        assert all(program in text for program in ENTRIES)
        if shutil.which(shell):
            subprocess.run([shell, "-n"], input=text, text=True, check=True)
