"""``zswarm-ot init``: the file it writes is whole, says what it should, and explains the rest."""

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from zswarm import experiment
from zswarm.config import settings_docs
from zswarm.errors import ConfigError
from zswarm.ot.cli import command
from zswarm.ot.commands.shared import template
from zswarm.plugins import registry as plugins

EXAMPLES = sorted(path.stem for path in experiment.examples_folder().glob("*.toml"))
COMMENTED_OUT = re.compile(r"^#(?=\S)", re.M)


def completed(text: str, folder: Path) -> experiment.Experiment:
    path = folder / "written.toml"
    path.write_text(text)
    return experiment.complete(experiment.load(path), str(path))


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def init(*arguments: str) -> str:
    done = CliRunner().invoke(command, ["init", *arguments], catch_exceptions=False)
    assert done.exit_code == 0
    return done.output


@pytest.mark.parametrize("simulator", plugins.names("simulator"))
def test_a_new_file_has_the_defaults_whether_they_are_commented_out_or_not(
    simulator: str, tmp_path: Path
) -> None:
    text = template.write(template.blank("new", simulator, "fully-meshed", "nnga"))
    whole = completed(text, tmp_path)
    assert whole.problem.simulator == simulator
    assert completed(COMMENTED_OUT.sub("", text), tmp_path) == whole
    assert tomllib.loads(text)["problem"] == {"simulator": simulator, "settings": {}}


def test_a_new_file_has_every_key_with_its_description(tmp_path: Path) -> None:
    text = template.write(template.blank("new", "minisim", "fully-meshed", "nnga"))
    flat = " ".join(text.replace("\n# ", " ").split())
    structs = [
        *experiment.TABLES.values(),
        plugins.load("simulator", "minisim").settings_type,
    ]
    structs += [
        plugins.load("optimizer", "nnga").settings_type,
        plugins.load("representation", "fully-meshed").settings_type,
    ]
    for struct in structs:
        for key in settings_docs.keys(struct):
            assert key.name == "settings" or re.search(
                rf"^#?{key.name} = ", text, re.M
            ), key.name
            assert key.name == "settings" or settings_docs.plain(key.meaning) in flat, (
                key.name
            )
    assert max(len(line) for line in text.splitlines()) < 80


@pytest.mark.parametrize("name", EXAMPLES)
def test_a_file_from_an_example_has_exactly_its_settings(name: str, here: Path) -> None:
    text = init("-", "--from", name)
    # Those that it does not have.
    empty: dict[str, Any] = {table: {} for table in experiment.TABLES}
    example = empty | tomllib.loads(experiment.find(name).read_text())
    example["problem"].setdefault("settings", {})
    assert tomllib.loads(text) == example
    assert completed(text, here) == completed(experiment.find(name).read_text(), here)


def test_init_names_the_file_and_the_next_two_commands(here: Path) -> None:
    said = init("my swarm.toml")
    assert "zswarm-ot check 'my swarm.toml'" in said
    assert "zswarm-ot run 'my swarm.toml'" in said
    assert experiment.load(here / "my swarm.toml").name == "my-swarm"
    assert init().startswith("experiment.toml: ")


def test_an_existing_file_is_replaced_only_with_force(here: Path) -> None:
    (here / "experiment.toml").write_text("precious")
    with pytest.raises(
        ConfigError, match=r"^experiment.toml: exists already; use --force to replace it"
    ):
        init()
    assert (here / "experiment.toml").read_text() == "precious"
    init("--force")
    assert experiment.load(here / "experiment.toml")


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["no/such.toml"], "no/such.toml: cannot be written: No such file or directory"),
        (
            ["--simulator", "minisin"],
            "unknown simulator 'minisin' (did you mean 'minisim'?)",
        ),
        (
            ["--from", "stadion"],
            "stadion: no such file or example (did you mean 'stadium'?)",
        ),
        (
            ["--from", "stadium", "--simulator", "minisim"],
            "--from names the simulator: omit --simulator",
        ),
    ],
)
def test_unwritable_files_are_refused_in_one_line(
    arguments: list[str], text: str, here: Path
) -> None:
    with pytest.raises(ConfigError) as refused:
        init(*arguments)
    assert str(refused.value).startswith(text)
    assert list(here.iterdir()) == []


def test_texts_of_a_plugin_cannot_break_out_of_their_comment(
    here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    loaded = plugins.load("simulator", "minisim")
    monkeypatch.setattr(loaded, "__doc__", 'Evil\x1b[2J\rname = "other"\nseed = 5')
    text = template.write(template.blank("new", "minisim", "fully-meshed", "nnga"))
    assert "\x1b" not in text
    assert tomllib.loads(text)["name"] == "new"


def test_ranges_are_explained_once() -> None:
    """Before the settings of the problem, which alone can have them."""
    flat = " ".join(
        template.write(template.blank("new", "minisim", "fully-meshed", "nnga"))
        .replace("\n# ", " ")
        .split()
    )
    assert flat.count("{ from = 5, to = 15 }") == 1
    assert "or { choice = [5, 10] }. [problem.settings]" in flat


def test_ranges_survive_a_round_trip(tmp_path: Path) -> None:
    mapping = {**template.blank("new", "minisim", "fully-meshed", "nnga")}
    mapping["problem"] = {
        "simulator": "minisim",
        "settings": {"robots": {"from": 5, "to": 9}, "reach": {"choice": [1, 2]}},
    }
    assert tomllib.loads(template.write(mapping))["problem"] == mapping["problem"]
