"""Every page of the site is listed, every link resolves, generated parts are current."""

import importlib.util
import os
import re
import shutil
import subprocess
import sys
import types
from pathlib import Path

import click
import pytest

import zswarm
from tests.docs.documents import DOCUMENTS, REPOSITORY
from zswarm import errors

DOCS = REPOSITORY / "docs"
PAGES = sorted(DOCS.glob("*.md"))
CODE = re.compile(r"^```.*?^```$|`[^`\n]*`", re.S | re.M)


def module(name: str) -> types.ModuleType:
    spec = importlib.util.spec_from_file_location(f"docs_{name}", DOCS / f"{name}.py")
    assert spec
    assert spec.loader
    loaded = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(loaded)
    return loaded


reference = module("reference")


def toctrees() -> list[str]:
    """Return the pages that index.md names, in their order."""
    blocks = re.findall(
        r"^```\{toctree\}\n(.*?)^```$",
        (DOCS / "index.md").read_text(encoding="utf-8"),
        re.S | re.M,
    )
    lines = [
        line
        for block in blocks
        for line in block.splitlines()
        if line and not line.startswith(":")
    ]
    return [re.sub(r"^.* <(.*)>$", r"\1", line) for line in lines]


def anchors(document: Path) -> set[str]:
    """Return the anchors of a document's headings, as forges and the site make them."""
    found: set[str] = set()
    for heading in re.findall(
        r"^#+ (.*)$",
        re.sub(
            r"^```.*?^```$", "", document.read_text(encoding="utf-8"), flags=re.S | re.M
        ),
        re.M,
    ):
        words = re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")
        found.add(words)
    return found


def test_every_page_is_in_one_toctree() -> None:
    named = toctrees()
    assert sorted(named) == sorted(page.stem for page in PAGES if page.stem != "index")


def test_the_site_is_strict_and_has_the_version_of_the_package() -> None:
    conf = module("conf")
    assert conf.nitpicky
    assert conf.release == conf.zswarm.__version__
    assert "--fail-on-warning" in (REPOSITORY / "Makefile").read_text()


def test_files_of_the_repository_are_pages_with_a_link_in_plain_markdown() -> None:
    for name, page in module("conf").FROM_THE_REPOSITORY.items():
        assert (DOCS / f"{page}.md").read_text() == f"[{name}.md](../{name}.md)\n"


def test_links_named_after_a_file_show_the_title_of_its_page() -> None:
    source = [
        "see [record.md](record.md#meta), [docs/keys.md](keys.md) and [its tables](record.md)"
    ]
    module("conf").within_the_site(None, "commands", source)
    assert source == ["see [](record.md#meta), [](keys.md) and [its tables](record.md)"]


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_every_link_has_its_target(document: Path) -> None:
    """Links within the page and to a heading of another page are checked, too."""
    for target in re.findall(
        r"\]\(([^)\s]+)\)", CODE.sub("", document.read_text(encoding="utf-8"))
    ):
        if "://" in target:
            continue
        file, _, anchor = target.partition("#")
        path = (document.parent / file).resolve() if file else document
        assert path.exists(), f"{document.name}: {target} is not there"
        if anchor:
            assert anchor in anchors(path), f"{document.name}: {target}: no such heading"


def test_generated_parts_are_up_to_date(tmp_path: Path) -> None:
    """Generate the reference in a fresh process, as `make reference` does."""
    for page in (*DOCS.glob("*.md"), DOCS / "reference.py"):
        shutil.copy(page, tmp_path)
    subprocess.run(
        [sys.executable, tmp_path / "reference.py"],
        check=True,
        env=os.environ | {"ZSWARM_PLAIN": "1"},
    )
    for page in ("help.md", "experiment.md"):
        assert (DOCS / page).read_text(encoding="utf-8") == (tmp_path / page).read_text(
            encoding="utf-8"
        ), "run: make reference"


def test_every_public_name_is_in_the_reference() -> None:
    """The errors are documented by their module."""
    text = (DOCS / "api.md").read_text(encoding="utf-8")
    named = set(re.findall(r"^\.\. auto\w+:: zswarm\.(\w+)$", text, re.M))
    assert named | set(vars(errors)) >= set(zswarm.__all__)
    assert ".. automodule:: zswarm.errors" in text


def commands() -> list[tuple[str, str]]:
    """Return our commands named within a line, such as `zswarm-ot resume RUN`, by document."""
    found = []
    for document in DOCUMENTS:
        text = re.sub(
            r"^```.*?^```$", "", document.read_text(encoding="utf-8"), flags=re.S | re.M
        )
        found += [
            (document.name, " ".join(said.split()))
            for said in re.findall(r"`(zswarm-(?:ot|ss|router|keys) [^`]*)`", text)
        ]
    return sorted(set(found))


@pytest.mark.parametrize(("document", "said"), commands())
def test_commands_within_sentences_exist(document: str, said: str) -> None:
    """Their options exist, too; words in capitals are placeholders."""
    program, *words = said.replace(" ...", "").split()
    command = reference.PROGRAMS[program]
    while isinstance(command, click.Group) and words and not words[0].startswith("-"):
        found = command.get_command(click.Context(command), words[0])
        assert found is not None, f"{document}: {said}"
        command, words = found, words[1:]
    known = {
        spelling
        for option in command.params
        for spelling in [*option.opts, *option.secondary_opts]
    }
    for word in words:
        if word.startswith("-"):
            assert word.partition("=")[0] in known | {"--help", "--version", "-h"}, (
                f"{document}: {said}: {word}"
            )


def defaults() -> list[tuple[str, str, str]]:
    """Command, option and default of each option that has a plain one."""
    found = []
    for program, command in reference.PROGRAMS.items():
        context = click.Context(command)
        names = command.list_commands(context) if isinstance(command, click.Group) else ()
        children = [(child, command.get_command(context, child)) for child in names]  # type: ignore[attr-defined]
        for name, one in (
            (program, command),
            *((f"{program} {child}", found_) for child, found_ in children),
        ):
            found += [
                (name, option.opts[-1], f"{option.default}")
                for option in one.params
                if isinstance(option, click.Option)
                and isinstance(option.default, str | int | float)
                if not option.is_flag and not option.multiple and option.default
            ]
    return found


def table_rows(text: str, heading: str, option: str) -> list[list[str]]:
    """Return the cells of the rows about an option, in the tables below a heading."""
    level = heading.index(" ")
    section = re.search(rf"^{heading}$\n(.*?)(?=^#{{1,{level}}} |\Z)", text, re.S | re.M)
    assert section, heading
    rows = [
        re.split(r"(?<!\\)\|", line)[1:-1]
        for line in section[1].splitlines()
        if line.startswith("|")
    ]
    return [cells for cells in rows if re.search(rf"`{option}`", cells[0])]


@pytest.mark.parametrize(("command", "option", "default"), defaults())
def test_every_documented_default_is_the_real_default(
    command: str, option: str, default: str
) -> None:
    """It stands in the command's table in commands.md, or in the table above that it refers to."""
    text = (DOCS / "commands.md").read_text(encoding="utf-8")
    program, _, name = command.partition(" ")
    heading = (
        f"### {name}"
        if program == "zswarm-ot" and name
        else f"### {command}"
        if name
        else f"## {program}"
    )
    rows = table_rows(text, heading, option)
    if any("as above" in cells[-1] for cells in rows):
        rows = [
            cells
            for cells in table_rows(text, f"## {program}", option)
            if "as above" not in cells[-1]
        ]
    assert rows, f"{command} {option}"
    assert all(default in cells[1] or "the file's" in cells[1] for cells in rows), (
        f"{command} {option}: {default}"
    )
