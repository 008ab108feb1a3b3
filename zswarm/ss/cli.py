"""The command ``zswarm-ss``: parses and calls. Slots' processes import this file, so it imports little."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click


@click.group(invoke_without_command=True, context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--capacity", type=click.IntRange(1, 65_535), help="Slots: simulations at the same time.  [default: cores]")
@click.option("--name", help="Name shown to optimizers.  [default: the host's name]")
@click.option("--realm", help="Only optimizers of the same realm find this server.  [default: default]")
@click.option(
    "--listen",
    multiple=True,
    metavar="EP",
    help="Endpoint such as tcp/192.168.1.5:7467; may be repeated.  [default: first free port from 7467]",
)
@click.option("--connect", multiple=True, metavar="EP", help="Endpoint to dial, such as a router; may be repeated.")
@click.option("--multicast/--no-multicast", default=None, help="Be found by multicast.  [default: multicast]")
@click.option("--require-keys/--no-require-keys", default=None, help="Do not start in the clear.  [default: no-require-keys]")
@click.option("--simulators", metavar="A,B", help="Simulators to offer.  [default: all installed]")
@click.option(
    "--label",
    "labels",
    multiple=True,
    metavar="NAME=VALUE",
    help="Something that experiments may require or prefer, such as gpu=yes; may be repeated.",
)
@click.option(
    "--slot-memory",
    "slot_memory_mb",
    type=int,
    metavar="MB",
    help="Memory that the process of a slot may take.  [default: 80 % of the machine's, divided by the slots]",
)
@click.option(
    "--metrics",
    type=click.IntRange(1, 65_535),
    metavar="PORT",
    help="Serve metrics for Prometheus on this port of 127.0.0.1.  [default: none]",
)
@click.option(
    "--config",
    type=click.Path(path_type=Path),
    help="TOML file with these options; the command line wins.",
)
@click.option("--log-level", type=click.Choice(["debug", "info", "warning", "error"]), default="info", show_default=True)
@click.option("--until-stdin-closes", is_flag=True, hidden=True, help="Exit when the program that started this one ends.")
@click.version_option(package_name="zswarm", prog_name="zswarm-ss")
def command(config: Path | None, log_level: str, until_stdin_closes: bool, **given: Any) -> None:
    """Serve simulations: evaluate controllers for the optimizers of this network.

    \b
      zswarm-ss                             one slot per core
      zswarm-ss --capacity 4 --realm lab7

    Optimizers (zswarm-ot run) find this server by themselves. SIGTERM or Ctrl-C finishes what runs and exits; a second one
    exits at once. SIGHUP reads keys and settings again; what runs goes on.
    """  # noqa: D301  click's mark for text that is not to be wrapped
    if (subcommand := click.get_current_context().invoked_subcommand) is not None:
        if config or any(value not in (None, ()) for value in given.values()):
            raise click.UsageError(f"expected the options of {subcommand} after its name, and none of the daemon's")
        return
    from zswarm.ss import worker

    try:
        worker.start_fork_server()  # it loads numba while this program goes on
    except OSError as error:  # no folder for temporary files, no processes left
        click.echo(f"zswarm-ss: {error}", err=True)
        sys.exit(1)
    from zswarm import labels, log
    from zswarm.errors import ConfigError
    from zswarm.ss import options
    from zswarm.ss.server import Server

    log.set_up(log_level)
    told = {
        key: (value.split(",") if key == "simulators" else list(value) if isinstance(value, tuple) else value)
        for key, value in given.items()
        if value not in (None, ())
    }
    try:
        if "labels" in told:
            told["labels"] = labels.assigned(told["labels"], "--label")
        code = Server(lambda: options.load(config, told), until_stdin_closes=until_stdin_closes).run()
    except ConfigError as error:
        click.echo(f"zswarm-ss: {error}", err=True)
        sys.exit(78 if config else 2)
    sys.exit(code)


name_option = click.option("--name", default="", help="Of the daemon, or its id; where several run on this machine.")


@command.command()
@name_option
@click.option("--json", "as_json", is_flag=True, help="One JSON object a line on stdout.")
def status(name: str, as_json: bool) -> None:
    """Show the daemons of this machine: slots, leases, trials, faults."""
    from zswarm.ss import status

    _try(lambda: status.show(name, as_json=as_json))


@command.command()
@name_option
@click.option("--wait", is_flag=True, help="Wait until it ended.")
def drain(name: str, wait: bool) -> None:
    """Have the daemon of this machine finish what runs, take nothing new, and end; for its own user and root."""
    from zswarm.ss import status

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
    from zswarm import screen

    screen.prepare()
    command()
