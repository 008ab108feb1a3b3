"""The command ``zswarm-router``: a zenoh session in router mode, which works by itself; this program only waits."""

import signal
import sys
import tomllib
from pathlib import Path
from typing import Any

import click
import msgspec
import structlog

import zswarm
from zswarm import log, notify, session
from zswarm.errors import ConfigError
from zswarm.strict import convert

EXIT_MISTAKE, EXIT_DAMAGED_CONFIG = 2, 78


class Options(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a router is told at its start: command line or ``--config`` file."""

    listen: list[str] = []  # empty: session.ROUTER
    multicast: bool = True


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option(
    "--listen",
    multiple=True,
    metavar="EP",
    help=f"Endpoint such as tcp/192.168.1.5:7466; may be repeated.  [default: {session.ROUTER}]",
)
@click.option("--multicast/--no-multicast", default=None, help="Be found by multicast.  [default: multicast]")
@click.option(
    "--config",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="TOML file with these options; the command line wins.",
)
@click.option("--log-level", type=click.Choice(log.LEVELS), default="info", show_default=True)
@click.version_option(package_name="zswarm", prog_name="zswarm-router")
def command(config: Path | None, log_level: str, **given: Any) -> None:
    """Bring servers and optimizers together where multicast does not reach.

    Start it on a machine that all can dial, then

    \b
      zswarm-ss  --connect tcp/ROUTER:7466                      on the servers
      zswarm-ot run --connect tcp/ROUTER:7466                   on the workstation
      zswarm-ot run --connect tcp/ROUTER:7466 --through-router  where it cannot dial the servers

    Without --through-router the optimizer learns the servers' addresses here and dials them; no evaluation passes the
    router, and runs go on when it ends. SIGTERM or Ctrl-C ends it.
    """  # noqa: D301  click's mark for text that is not to be wrapped
    log.set_up(log_level)
    try:
        mapping: dict[str, Any] = tomllib.loads(config.read_text(encoding="utf-8")) if config else {}
        convert(mapping, Options, str(config))  # what is wrong in the file is wrong even where the command line overrides it
        mapping |= {
            key: list(value) if isinstance(value, tuple) else value for key, value in given.items() if value not in (None, ())
        }
        code = serve(convert(mapping, Options, str(config or "zswarm-router")))
    except (ConfigError, OSError, tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        where = f"{config}: " if config and not isinstance(error, ConfigError) else ""
        click.echo(f"zswarm-router: {where}{error}", err=True)
        sys.exit(EXIT_DAMAGED_CONFIG if config else EXIT_MISTAKE)
    sys.exit(code)


def serve(options: Options) -> int:
    """Route until SIGTERM or SIGINT; the program's exit code.

    Raises:
        ConfigError: an endpoint cannot be listened on, or is none.
    """
    logger = structlog.get_logger()
    told = notify.Notify()
    listen = options.listen or [session.ROUTER]
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM, signal.SIGINT})  # before zenoh's threads, which inherit it
    if options.multicast and (fault := session.multicast_fault()):
        logger.warning("multicast_unavailable", reason=fault)
    opened = session.open_router(listen, multicast=options.multicast)
    try:
        logger.info("router_ready", listen=listen, multicast=options.multicast, program=zswarm.__version__)
        told.ready()
        number = signal.sigwait({signal.SIGTERM, signal.SIGINT})
        told.stopping()
    finally:
        session.close(opened)
    logger.info("router_stopped")
    return 128 + number


def main() -> None:
    """Entry point."""
    command()


if __name__ == "__main__":
    main()
