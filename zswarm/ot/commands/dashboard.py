"""``zswarm-ot dashboard``: show runs in the browser, live."""

from pathlib import Path
from typing import Any

import click

from zswarm.errors import ConfigError
from zswarm.ot.commands.shared import options, suggestions
from zswarm.system.text import clean

MENU = ("Results", 2)


@click.command("dashboard")
@click.argument(
    "folders",
    nargs=-1,
    type=options.PATH,
    metavar="[RUNS]...",
    shell_complete=suggestions.runs,
)
@click.option(
    "--host",
    default="127.0.0.1",
    show_default=True,
    metavar="ADDRESS",
    help="Address to listen on.",
)
@click.option(
    "--port",
    type=click.IntRange(1, 65535),
    metavar="N",
    help="Port.  [default: 8467, or the next free one]",
)
@click.option(
    "--allow-host",
    "allowed",
    multiple=True,
    metavar="NAME",
    help="Also accept this name of the machine from browsers; may be repeated.",
)
@click.option("--until-stdin-closes", is_flag=True, hidden=True)
def command(folders: tuple[Path, ...], **serving: Any) -> None:
    """Show runs in the browser, live, until Ctrl-C.

    RUNS are folders of runs, or folders that contain some; the default is the folder "runs".
    Running, finished and copied runs are shown alike.

    \b
      zswarm-ot dashboard
      zswarm-ot dashboard runs/stadium
    """
    options.check_dashboard("dashboard")
    from zswarm.ot.dashboard import serve
    from zswarm.ot.record.folder import RUNS

    for folder in folders:
        if not folder.is_dir():
            raise ConfigError(
                f"{clean(str(folder))}: expected the folder of a run or of runs"
            )
    serve.serve(folders or (RUNS,), **serving)
