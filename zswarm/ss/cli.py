"""The command ``zswarm-ss``. Slots' processes import this file, so it imports little."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
from click import option

from zswarm.system.version import VERSION

CONTEXT = {"help_option_names": ["-h", "--help"]}
COUNT = click.IntRange(1, 65_535)
LEVELS = click.Choice(["debug", "info", "warning", "error"])
FILE = click.Path(path_type=Path)
CAPACITY = "Number of slots (parallel processes).  [default: one per core]"
LISTEN = "Endpoint to listen on; may be repeated.  [default: first free port from 7467]"
LABEL = "What experiments may require or prefer, such as gpu=yes; may be repeated."
MEMORY = (
    "Memory of a slot's process.  [default: 80 % of the machine's, divided by the slots]"
)
METRICS = "Serve metrics for Prometheus on this port of 127.0.0.1.  [default: none]"
SIMULATORS = "Simulators to offer.  [default: all installed]"
KEYS = "Refuse to start without keys.  [default: no-require-keys]"


def _split(_context: click.Context, _option: click.Parameter, text: str | None) -> Any:
    return text if text is None else text.split(",")


@click.group(invoke_without_command=True, context_settings=CONTEXT)
@option("--capacity", type=COUNT, help=CAPACITY)
@option("--name", help="Name shown to optimizers.  [default: the host's name]")
@option("--realm", help="Serve only optimizers of this realm.  [default: default]")
@option("--listen", multiple=True, metavar="EP", help=LISTEN)
@option("--connect", multiple=True, metavar="EP", help="Router to dial; may be repeated.")
@option(
    "--multicast/--no-multicast",
    default=None,
    help="Announce this server by multicast.  [default: multicast]",
)
@option("--require-keys/--no-require-keys", default=None, help=KEYS)
@option("--simulators", metavar="A,B", callback=_split, help=SIMULATORS)
@option("--label", "labels", multiple=True, metavar="NAME=VALUE", help=LABEL)
@option("--slot-memory", "slot_memory_mb", type=int, metavar="MB", help=MEMORY)
@option("--metrics", type=COUNT, metavar="PORT", help=METRICS)
@option(
    "--config", type=FILE, help="TOML file with these options; the command line wins."
)
@option("--log-level", type=LEVELS, default="info", show_default=True)
@option(
    "--until-stdin-closes", is_flag=True, hidden=True, help="End with the parent program."
)
@click.version_option(VERSION, prog_name="zswarm-ss")
def command(
    config: Path | None, log_level: str, until_stdin_closes: bool, **given: Any
) -> None:
    """Serve simulations: evaluate controllers for the optimizers of this network.

    \b
      zswarm-ss                             one slot per core
      zswarm-ss --capacity 4 --realm lab7

    Optimizers (zswarm-ot run) find this server by themselves. SIGTERM or Ctrl-C finishes
    what runs and exits; a second one exits at once. SIGHUP reads keys and settings again,
    without stopping what runs.
    """
    if (subcommand := click.get_current_context().invoked_subcommand) is not None:
        if config or any(value not in (None, ()) for value in given.values()):
            expected = f"expected the options of {subcommand} after its name"
            raise click.UsageError(f"{expected}, and none of the daemon's")
        return
    from zswarm.ss.workers import parent
    from zswarm.system.starting import Starting

    starting = None if until_stdin_closes else Starting()
    try:
        parent.start_fork_server()  # it loads numba in parallel with the imports below
    except OSError as error:  # no folder for temporary files, or no processes left
        click.echo(f"zswarm-ss: {error}", err=True)
        sys.exit(1)
    from zswarm.errors import ConfigError
    from zswarm.ss import options
    from zswarm.ss.server import Server
    from zswarm.system import log

    log.set_up(log_level)
    try:
        server = Server(
            lambda: options.load(config, given), until_stdin_closes=until_stdin_closes
        )
        code = server.run(starting)
    except ConfigError as error:
        click.echo(f"zswarm-ss: {error}", err=True)
        sys.exit(78 if config else 2)
    finally:
        if starting is not None:
            starting.end()
    sys.exit(code)


name_option = option(
    "--name", default="", help="Name or id, if several daemons run here."
)


@command.command()
@name_option
@option("--json", "as_json", is_flag=True, help="One JSON object a line on stdout.")
def status(name: str, as_json: bool) -> None:
    """Show the daemons of this machine: slots, leases, trials, faults."""
    from zswarm.ss.local import status

    _try(lambda: status.show(name, as_json=as_json))


@command.command()
@name_option
@option("--wait", is_flag=True, help="Wait until it has ended.")
def drain(name: str, wait: bool) -> None:
    """Tell this machine's daemon to finish running work and end; for its own user and root."""
    from zswarm.ss.local import status

    _try(lambda: status.drain(name, wait=wait))


def _try(call: Callable[[], None]) -> None:
    from zswarm.errors import ZswarmError

    try:
        call()
    except (ZswarmError, OSError) as error:
        click.echo(f"zswarm-ss: {error}", err=True)
        sys.exit(1)


def main() -> None:
    """Entry point."""
    from zswarm.system import program, start

    start.prepare("zswarm-ss")
    program.run_command(command)
