"""The command ``zswarm-router``: a zenoh session in router mode, which works by itself; this program only waits."""

import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import msgspec
import structlog

import zswarm
from zswarm import log, notify, screen, session
from zswarm.errors import ConfigError
from zswarm.security import keyring, refusals
from zswarm.session import Reach
from zswarm.strict import overridden

EXIT_MISTAKE, EXIT_DAMAGED_CONFIG = 2, 78
RETURN_S = 5.0
LOOK_S = 0.5


class Options(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a router is told at its start: command line or ``--config`` file."""

    listen: list[str] = []  # empty: port 7466 of all addresses
    multicast: bool = True
    require_keys: bool = False  # do not start in the clear


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option(
    "--listen",
    multiple=True,
    metavar="EP",
    help=f"Endpoint such as tcp/192.168.1.5:7466; may be repeated.  [default: tcp/{session.ROUTER}]",
)
@click.option("--multicast/--no-multicast", default=None, help="Be found by multicast.  [default: multicast]")
@click.option("--require-keys/--no-require-keys", default=None, help="Do not start in the clear.  [default: no-require-keys]")
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
    on the servers
      zswarm-ss --connect tcp/ROUTER:7466
    on the workstation
      zswarm-ot run --connect tcp/ROUTER:7466
    where that cannot dial the servers
      zswarm-ot run --connect tcp/ROUTER:7466 --through-router

    Without --through-router the optimizer learns the servers' addresses here and dials them; no evaluation passes the
    router, and runs go on when it ends. SIGTERM or Ctrl-C ends it.
    """  # noqa: D301  click's mark for text that is not to be wrapped
    log.set_up(log_level)
    told = {key: list(value) if isinstance(value, tuple) else value for key, value in given.items() if value not in (None, ())}
    try:
        code = serve(lambda: overridden(config, told, Options, "zswarm-router"))
    except ConfigError as error:
        click.echo(f"zswarm-router: {error}", err=True)
        sys.exit(EXIT_DAMAGED_CONFIG if config else EXIT_MISTAKE)
    sys.exit(code)


def serve(read_options: Callable[[], Options]) -> int:
    """Route until SIGTERM or SIGINT; SIGHUP reads keys and settings again. The program's exit code.

    Raises:
        ConfigError: an endpoint cannot be listened on, or is none; the keys cannot be used, or are required and missing.
    """
    logger = structlog.get_logger()
    told = notify.Notify()
    signals = {signal.SIGTERM, signal.SIGINT, signal.SIGHUP}
    signal.pthread_sigmask(signal.SIG_BLOCK, signals)  # before zenoh's threads, which inherit it
    elsewhere: list[int] = []  # signals that another thread got: after a failed opening zenoh has some that do not block them
    for each in signals:
        signal.signal(each, lambda number, _frame: elsewhere.append(number))
    refusals.watch_links()
    options = read_options()
    reach = _reach(options)
    opened, listen = _open(options, reach)
    logger.info(
        "router_ready", listen=listen, keys=session.keys_in_words(reach), multicast=options.multicast, program=zswarm.__version__
    )
    told.ready()
    while (number := _next(signals, elsewhere)) == signal.SIGHUP:
        told.reloading()
        try:
            changed = read_options()
            wanted = _reach(changed)
        except ConfigError as error:
            logger.error("reload_refused", reason=str(error))
        else:
            session.close(opened, or_exit=False)
            try:
                opened, listen = _open(changed, wanted)
                options, reach = changed, wanted
                logger.info("reloaded", listen=listen, keys=session.keys_in_words(reach))
            except ConfigError as error:
                logger.error("reload_refused", reason=str(error))
                opened, listen = _return(options, reach)
        told.ready()
    told.stopping()
    session.close(opened)
    logger.info("router_stopped")
    return 128 + number


def _next(signals: set[signal.Signals], elsewhere: list[int]) -> int:
    while not elsewhere:
        if info := signal.sigtimedwait(signals, LOOK_S):
            return info.si_signo
    return elsewhere.pop(0)


def _reach(options: Options) -> Reach:
    ring = keyring.installed("router")
    if ring is None and options.require_keys:
        raise ConfigError("require_keys is set, and no keys are installed: zswarm-keys join BUNDLE")
    return Reach(multicast=options.multicast, keyring=ring)


def _open(options: Options, reach: Reach) -> tuple[session.Session, list[str]]:
    logger = structlog.get_logger()
    if reach.multicast and (fault := session.multicast_fault()):
        logger.warning("multicast_unavailable", reason=fault)
    opened, listen = session.open_router(options.listen, reach)
    if reach.keyring is None:
        logger.warning("in_the_clear", reason="whoever reaches the port can use this router; zswarm-keys lets in members only")
    else:
        refusals.watch_members(opened, reach.keyring)
    return opened, listen


def _return(options: Options, reach: Reach) -> tuple[session.Session, list[str]]:
    """Be on the network as before a reload that was refused, as soon as that can be; a signal to end does so at once."""
    while True:
        try:
            return _open(options, reach)
        except ConfigError as error:
            structlog.get_logger().error("off_the_network", reason=str(error), again_s=RETURN_S)
            if number := signal.sigtimedwait({signal.SIGTERM, signal.SIGINT}, RETURN_S):
                sys.exit(128 + number.si_signo)


def main() -> None:
    """Entry point."""
    screen.prepare()
    command()


if __name__ == "__main__":
    main()
