"""Write the parts of the documents that are made from the code: `make reference`.

docs/help.md: the help of each command. docs/experiment.md and docs/profiles.md: the
tables of keys, from the structs, and that of profiles. A test compares.
"""

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import click

import zswarm
from zswarm import experiment, router
from zswarm.config import settings_docs
from zswarm.ot import cli as ot
from zswarm.ot.replay import appearance
from zswarm.plugins import registry as plugins
from zswarm.robots.profiles import profile as profiles
from zswarm.security import cli as security
from zswarm.ss import cli as ss

DOCS = Path(__file__).parent
PROGRAMS = {
    "zswarm-ot": ot.command,
    "zswarm-ss": ss.command,
    "zswarm-router": router.command,
    "zswarm-keys": security.command,
}
COLUMNS = 80
HELP = """# Help

The `--help` of each program and command, as `make reference` writes it. [commands.md](commands.md)
explains them.
"""
PROFILES = re.compile(r"^\| profile \| ROS \|.*\n(?:\|.*\n)+", re.M)
KINDS = re.compile(r"^\| word in a kind \|.*\n(?:\|.*\n)+", re.M)
TREE = re.compile(r"^```text\nzswarm/ .*?^```\n", re.M | re.S)
TABLE = re.compile(r"^\| key \| type \| default \| meaning \|\n(?:\|.*\n)+", re.M)


def helps(
    command: click.Command, name: str, parent: click.Context | None = None
) -> Iterator[tuple[str, str]]:
    """Return the full name and the help of a command, then those of its subcommands."""
    context = click.Context(
        command,
        parent,
        info_name=name,
        terminal_width=COLUMNS,
        max_content_width=COLUMNS,
        **command.context_settings,
    )
    yield context.command_path, command.get_help(context)
    if isinstance(command, click.Group):
        for child in command.list_commands(context):
            found = command.get_command(context, child)
            if found and not found.hidden:
                yield from helps(found, child, context)


def help_page() -> str:
    """Return docs/help.md."""
    parts = [HELP]
    for program, command in PROGRAMS.items():
        for name, said in helps(command, program):
            lines = "\n".join(line.rstrip() for line in said.splitlines())
            parts.append(
                f"{'##' if name == program else '###'} {name}\n\n```text\n{lines}\n```\n"
            )
    return "\n".join(parts)


def experiment_page() -> str:
    """Return docs/experiment.md with its tables made again."""
    sheets = {("## Top level",): experiment.top_level()}
    for name in ("problem", "cluster", "stop", "study"):
        if name in experiment.Experiment.__struct_fields__:
            sheets[f"## `[{name}]`",] = settings_docs.keys(experiment.TABLES[name])
    for kind, bundled in plugins.BUNDLED.items():
        for name in bundled:
            sheets[f"## Settings of the {kind}s", f"### {name}"] = settings_docs.keys(
                plugins.load(kind, name).settings_type
            )
    text = (DOCS / "experiment.md").read_text(encoding="utf-8")
    for headings, keys in ((headings, keys) for headings, keys in sheets.items() if keys):
        before, after = "", text
        for heading in headings:
            passed, found, after = after.partition(f"\n{heading}\n")
            if not found:
                sys.exit(f"docs/experiment.md has no section {' / '.join(headings)!r}")
            before += passed + found
        text = before + TABLE.sub(
            lambda _, keys=keys: settings_docs.markdown(keys), after, count=1
        )
    return text


def profiles_page() -> str:
    """Return docs/profiles.md with its tables made again."""
    sheets = {
        # Keep everything except tables.
        "## Keys": [
            key
            for key in settings_docs.keys(profiles.Profile)
            if key.type_text != "value"
        ],
        "### Topics": settings_docs.keys(profiles.Topic),
        "### `[velocity]`": settings_docs.keys(profiles.VelocityTopic)[-1:],
        "### `[reset]`": settings_docs.keys(profiles.ResetTopic)[-1:],
    }
    text = (DOCS / "profiles.md").read_text(encoding="utf-8")
    for heading, keys in sheets.items():
        before, found, after = text.partition(f"\n{heading}\n")
        text = (
            before
            + found
            + TABLE.sub(lambda _, keys=keys: settings_docs.markdown(keys), after, count=1)
        )
    return PROFILES.sub(lambda _: profile_table(), text, count=1)


def profile_table() -> str:
    """Return the table of bundled profiles, for a robot among several."""
    lines = [
        "| profile | ROS | velocity | scan | odometry | ground truth | clock | m/s, rad/s |",
        "| --- " * 8 + "|",
    ]
    for name in profiles.names():
        profile = profiles.read(name)
        kind = "TwistStamped" if profile.velocity.stamped else "Twist"
        topics = {
            channel: f"`{profile.topic(channel, 0, 2)}`" for channel in profile.channels
        }
        shown = [
            topics.get(channel, "")
            for channel in ("scan", "odometry", "ground_truth", "clock")
        ]
        limits = f"{profile.speed:g}, {profile.turn:g}"
        cells = [
            f"`{name}`",
            f"{profile.ros} {profile.distribution}",
            f"{topics['velocity']} {kind}",
            *shown,
            limits,
        ]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def own_simulator_page() -> str:
    """Return docs/own-simulator.md with the table of kinds and colours."""
    text = (DOCS / "own-simulator.md").read_text(encoding="utf-8")
    return KINDS.sub(lambda _: kinds_table(), text, count=1)


def kinds_table() -> str:
    """Return the colours that words in a kind state, then those of the palette."""
    lines = ["| word in a kind | colour | light | dark |", "| --- " * 4 + "|"]
    words: dict[str, list[str]] = {}
    for word, name in appearance.WORDS.items():
        words.setdefault(name, []).append(f"`{word}`")
    for name, (light, dark) in appearance.COLOURS.items():
        palette = ["(palette)"] if name in appearance.PALETTE else []
        said = ", ".join(words.get(name, []) + palette)
        lines.append(f"| {said} | `{name}` | `{light}` | `{dark}` |")
    return "\n".join(lines) + "\n"


def architecture_page() -> str:
    """Return docs/architecture.md with the tree of the package."""
    text = (DOCS / "architecture.md").read_text(encoding="utf-8")
    return TREE.sub(lambda _: f"```text\n{tree()}```\n", text, count=1)


def tree() -> str:
    """Return the rooms of the package with the first sentences of their docstrings."""
    package = Path(zswarm.__file__).parent
    lines = []
    for file in sorted(package.rglob("__init__.py"), key=lambda path: path.parent.parts):
        parts = file.parent.relative_to(package.parent).parts
        title = (ast.get_docstring(ast.parse(file.read_text())) or "").splitlines()[0]
        name = "  " * (len(parts) - 1) + parts[-1] + "/"
        lines.append(f"{name:<18}{title.partition('. ')[0].removesuffix('.')}\n")
    return "".join(lines)


def pages() -> dict[Path, str]:
    """Return the pages with their generated parts."""
    made = {
        "architecture.md": architecture_page(),
        "help.md": help_page(),
        "experiment.md": experiment_page(),
        "own-simulator.md": own_simulator_page(),
        "profiles.md": profiles_page(),
    }
    return {DOCS / name: text for name, text in made.items()}


if __name__ == "__main__":
    for path, text in pages().items():
        path.write_text(text, encoding="utf-8")
