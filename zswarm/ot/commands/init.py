"""``zswarm-ot init``: a commented experiment file."""

import os
import shlex
from pathlib import Path

import click

from zswarm import experiment
from zswarm.errors import ConfigError
from zswarm.ot.commands import suggestions


@click.command()
@click.argument("file", type=click.Path(path_type=Path), default=Path("experiment.toml"), metavar="[FILE.toml|-]")
@click.option(
    "--from",
    "source",
    metavar="EXPERIMENT",
    help="Begin with what this example or file sets.",
    shell_complete=suggestions.experiments,
)
@click.option(
    "--simulator", metavar="NAME", help="Of the experiment.  [default: emergency-exit]", shell_complete=suggestions.simulators
)
@click.option("--representation", metavar="NAME", help="Of the controllers.  [default: fully-meshed]")
@click.option("--optimizer", metavar="NAME", help="That evolves them.  [default: nnga]")
@click.option("--force", is_flag=True, help="Replace a file that is there.")
def init(
    file: Path, source: str | None, simulator: str | None, representation: str | None, optimizer: str | None, force: bool
) -> None:
    """Write a commented experiment file.

    Every key is in it, with its type, range, default and meaning.

    \b
      zswarm-ot init                       experiment.toml, with defaults
      zswarm-ot init my.toml --from stadium
      zswarm-ot init - --simulator minisim  to the screen

    Then edit it; "zswarm-ot check FILE" says what it amounts to, "zswarm-ot run FILE" evolves.
    """  # noqa: D301  click's mark for text that is not to be wrapped
    os.environ["ZSWARM_PLAIN"] = "1"  # nothing is evaluated
    from zswarm.ot import template, terminal
    from zswarm.protocol import keys
    from zswarm.strict import read

    parts = {"simulator": simulator, "representation": representation, "optimizer": optimizer}
    if source is not None:
        if given := [name for name, value in parts.items() if value is not None]:
            raise ConfigError(f"--from says which {given[0]}: leave --{given[0]} out")
        path = experiment.find(source)
        experiment.complete(experiment.load(path), str(path))  # what is wrong is told here
        content = read(path)
    else:
        content = template.blank(
            keys.fold(file.stem) if file.stem not in ("", "-") else "experiment",
            simulator or "emergency-exit",
            representation or "fully-meshed",
            optimizer or "nnga",
        )
    text = template.write(content)
    if str(file) == "-":
        click.echo(text, nl=False)
        return
    _write(file, text, force=force)
    name = shlex.quote(str(file))
    terminal.line(f"{file}: an experiment with the simulator {content['problem']['simulator']}; every key is explained in it")
    terminal.line(f"next:  zswarm-ot check {name}\n       zswarm-ot run {name}")


def _write(file: Path, text: str, *, force: bool) -> None:
    try:
        with file.open("w" if force else "x", encoding="utf-8") as opened:
            opened.write(text)
    except FileExistsError:
        raise ConfigError(f"{file}: is there already; --force replaces it, or give another name") from None
    except OSError as error:
        raise ConfigError(f"{file}: cannot be written: {error.strerror}") from None
