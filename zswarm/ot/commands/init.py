"""``zswarm-ot init``: write a commented experiment file."""

import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from zswarm import experiment
from zswarm.config.decode import read
from zswarm.errors import ConfigError
from zswarm.ot.commands.shared import options, suggestions
from zswarm.ot.display import tables
from zswarm.protocol import keys

MENU = ("Begin", 1)
DEFAULTS = {
    "simulator": "emergency-exit",
    "representation": "fully-meshed",
    "optimizer": "nnga",
}


def _part(kind: str, **more: Any) -> Callable[[options.F], options.F]:
    text = f"Name of the {kind}.  [default: {DEFAULTS[kind]}]"
    return click.option(f"--{kind}", metavar="NAME", help=text, **more)


@click.command("init")
@click.argument(
    "file", type=options.PATH, default=Path("experiment.toml"), metavar="[FILE.toml|-]"
)
@click.option(
    "--from",
    "source",
    metavar="EXPERIMENT",
    shell_complete=suggestions.experiments,
    help="Begin with the settings of this example or file.",
)
@_part("simulator", shell_complete=suggestions.simulators)
@_part("representation")
@_part("optimizer")
@click.option("--force", is_flag=True, help="Replace an existing file.")
def command(file: Path, source: str | None, force: bool, **parts: str | None) -> None:
    """Write a commented experiment file.

    It lists every key with its type, range, default and meaning.

    \b
      zswarm-ot init                       experiment.toml, with defaults
      zswarm-ot init my.toml --from stadium
      zswarm-ot init - --simulator minisim  to the screen

    Edit it; then "zswarm-ot check FILE" explains it, and "zswarm-ot run FILE" evolves.
    """
    from zswarm.ot.commands.shared import template

    given = {kind: name for kind, name in parts.items() if name is not None}
    if source is not None:
        if given:
            raise ConfigError(
                f"--from names the {next(iter(given))}: omit --{next(iter(given))}"
            )
        path = experiment.find(source)
        # Raises what is wrong with it.
        experiment.complete(experiment.load(path), str(path))
        content = read(path)
    else:
        name = keys.fold(file.stem) if file.stem not in ("", "-") else "experiment"
        content = template.blank(name, **(DEFAULTS | given))
    text = template.write(content)
    if str(file) == "-":
        click.echo(text, nl=False)
        return
    with (
        options.writing(file, "use --force to replace it, or another name"),
        file.open("w" if force else "x", encoding="utf-8") as opened,
    ):
        opened.write(text)
    simulator, name = content["problem"]["simulator"], shlex.quote(str(file))
    tables.line(
        f"{file}: an experiment with the simulator {simulator}; it explains every key"
    )
    tables.line(f"next:  zswarm-ot check {name}\n       zswarm-ot run {name}")
