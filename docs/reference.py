"""Writes the parts of the documents that are made from the code: `make reference`.

docs/help.md: what each command says with --help. docs/experiment.md and docs/profiles.md: the tables of keys,
from the structs, and that of profiles. A test compares.
"""

import re
import sys
from collections.abc import Iterator
from pathlib import Path

import click

from zswarm import experiment, plugins, router, settings_sheet
from zswarm.ot import cli as ot
from zswarm.ros import profiles
from zswarm.security import cli as security
from zswarm.ss import cli as ss

DOCS = Path(__file__).parent
PROGRAMS = {"zswarm-ot": ot.command, "zswarm-ss": ss.command, "zswarm-router": router.command, "zswarm-keys": security.command}
COLUMNS = 80
HELP = """# Help

What each program and command says with `--help`. This page is made from them by `make reference`; more about each stands in
[commands.md](commands.md).
"""
PROFILES = re.compile(r"^\| profile \| ROS \|.*\n(?:\|.*\n)+", re.M)
TABLE = re.compile(r"^\| key \| type \| default \| meaning \|\n(?:\|.*\n)+", re.M)


def helps(command: click.Command, name: str, parent: click.Context | None = None) -> Iterator[tuple[str, str]]:
    """The full name and the help of a command, then those of its own commands."""
    context = click.Context(
        command, parent, info_name=name, terminal_width=COLUMNS, max_content_width=COLUMNS, **command.context_settings
    )
    yield context.command_path, command.get_help(context)
    if isinstance(command, click.Group):
        for child in command.list_commands(context):
            found = command.get_command(context, child)
            if found and not found.hidden:
                yield from helps(found, child, context)


def help_page() -> str:
    """docs/help.md."""
    parts = [HELP]
    for program, command in PROGRAMS.items():
        for name, said in helps(command, program):
            lines = "\n".join(line.rstrip() for line in said.splitlines())
            parts.append(f"{'##' if name == program else '###'} {name}\n\n```text\n{lines}\n```\n")
    return "\n".join(parts)


def experiment_page() -> str:
    """docs/experiment.md, its tables made anew."""
    sheets = {("## Top level",): experiment.top_level()}
    for name in ("problem", "cluster", "study"):
        if name in experiment.Experiment.__struct_fields__:
            sheets[f"## `[{name}]`",] = settings_sheet.keys(getattr(experiment, name.title()))
    for kind, bundled in plugins.BUNDLED.items():
        for name in bundled:
            sheets[f"## Settings of the {kind}s", f"### {name}"] = settings_sheet.keys(plugins.load(kind, name).settings_type)
    text = (DOCS / "experiment.md").read_text(encoding="utf-8")
    for headings, keys in ((headings, keys) for headings, keys in sheets.items() if keys):
        before, after = "", text
        for heading in headings:
            passed, found, after = after.partition(f"\n{heading}\n")
            if not found:
                sys.exit(f"docs/experiment.md has no section {' / '.join(headings)!r}")
            before += passed + found
        text = before + TABLE.sub(lambda _, keys=keys: settings_sheet.markdown(keys), after, count=1)
    return text


def profiles_page() -> str:
    """docs/profiles.md, its tables made anew."""
    sheets = {
        "## Keys": [key for key in settings_sheet.keys(profiles.Profile) if key.type_text != "value"],  # but for tables
        "### Topics": settings_sheet.keys(profiles.Topic),
        "### `[velocity]`": settings_sheet.keys(profiles.VelocityTopic)[-1:],
        "### `[reset]`": settings_sheet.keys(profiles.ResetTopic)[-1:],
    }
    text = (DOCS / "profiles.md").read_text(encoding="utf-8")
    for heading, keys in sheets.items():
        before, found, after = text.partition(f"\n{heading}\n")
        text = before + found + TABLE.sub(lambda _, keys=keys: settings_sheet.markdown(keys), after, count=1)
    return PROFILES.sub(lambda _: profile_table(), text, count=1)


def profile_table() -> str:
    """The bundled profiles: what a robot among several has."""
    lines = ["| profile | ROS | velocity | scan | odometry | ground truth | clock | m/s, rad/s |", "| --- " * 8 + "|"]
    for name in profiles.names():
        profile = profiles.read(name)
        kind = "TwistStamped" if profile.velocity.stamped else "Twist"
        topics = {channel: f"`{profile.topic(channel, 0, 2)}`" for channel in profile.channels}
        shown = [topics.get(channel, "") for channel in ("scan", "odometry", "ground_truth", "clock")]
        limits = f"{profile.speed:g}, {profile.turn:g}"
        cells = [f"`{name}`", f"{profile.ros} {profile.distribution}", f"{topics['velocity']} {kind}", *shown, limits]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def pages() -> dict[Path, str]:
    """What the pages should be."""
    made = {"help.md": help_page(), "experiment.md": experiment_page(), "profiles.md": profiles_page()}
    return {DOCS / name: text for name, text in made.items()}


if __name__ == "__main__":
    for path, text in pages().items():
        path.write_text(text, encoding="utf-8")
