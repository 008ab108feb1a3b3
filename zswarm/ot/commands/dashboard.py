"""``zswarm-ot dashboard``: runs in the browser, live."""

import os
from pathlib import Path

import click

from zswarm.errors import ConfigError
from zswarm.extras import need
from zswarm.ot.commands import suggestions
from zswarm.ot.commands.options import DASHBOARD
from zswarm.protocol.codec import clean


@click.command()
@click.argument("folders", nargs=-1, type=click.Path(path_type=Path), metavar="[RUNS]...", shell_complete=suggestions.runs)
@click.option("--host", default="127.0.0.1", show_default=True, metavar="ADDRESS", help="Where it listens.")
@click.option("--port", type=click.IntRange(1, 65535), metavar="N", help="Port.  [default: 8467, or the next free one]")
@click.option(
    "--allow-host", "allowed", multiple=True, metavar="NAME", help="A name by which browsers call this machine; may be repeated."
)
@click.option("--until-stdin-closes", is_flag=True, hidden=True)
def dashboard(folders: tuple[Path, ...], host: str, port: int | None, allowed: tuple[str, ...], until_stdin_closes: bool) -> None:
    """Show runs in the browser, live, until Ctrl-C.

    RUNS are folders of runs, or folders that hold such; without one: runs. Those that go on, finished ones and copied ones are
    shown alike.

    \b
      zswarm-ot dashboard
      zswarm-ot dashboard runs/stadium
    """  # noqa: D301  click's mark for text that is not to be wrapped
    for package in DASHBOARD:
        need(package, "dashboard", "dashboard")
    os.environ["ZSWARM_PLAIN"] = "1"  # this program draws networks; what computes is another one
    from zswarm.ot.dashboard import serve
    from zswarm.ot.record import RUNS

    for folder in folders:
        if not folder.is_dir():
            raise ConfigError(f"{clean(str(folder))}: expected a folder of runs, or a run's")
    serve.serve(folders or (RUNS,), host=host, port=port, allowed=allowed, until_stdin_closes=until_stdin_closes)
