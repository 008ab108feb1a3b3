"""``zswarm-ot attach``: follow a detached run."""

import time
from pathlib import Path

import click

from zswarm.errors import ConfigError
from zswarm.ot.commands.shared import options, suggestions
from zswarm.system.text import clean

MENU = ("Evolve", 5)
LOOK_S = 0.2  # between two looks at the log
EARLIER = 4000  # bytes of the log that are shown first


@click.command("attach")
@click.argument(
    "folder", type=options.PATH, metavar="RUN|STUDY", shell_complete=suggestions.runs
)
def command(folder: Path) -> None:
    """Follow a run or a study that was started with --detach.

    Prints its last lines and each new one until it ends. Ctrl-C leaves it alone.

    \b
      zswarm-ot run stadium --detach
      zswarm-ot attach runs/stadium
    """
    from zswarm.ot.commands.shared.detaching import LOG, is_detached

    path = folder / LOG
    if not path.is_file():
        raise ConfigError(
            f"{clean(str(folder))}: no {LOG} to follow; only what was started with --detach has "
            "one (zswarm-ot dashboard shows others)"
        )
    with path.open("rb") as log:
        size = log.seek(0, 2)
        log.seek(max(0, size - EARLIER))
        if size > EARLIER:
            log.readline()  # the rest of a line
        while True:
            lives = is_detached(
                folder
            )  # before the look: its last lines are written then
            while text := log.read(65536):
                click.echo(text, nl=False)
            if not lives:
                return
            time.sleep(LOOK_S)
