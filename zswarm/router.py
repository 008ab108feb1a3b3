"""The command ``zswarm-router``: a zenoh session in router mode, which needs no further code."""

import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import msgspec

from zswarm import daemon, session
from zswarm.config.decode import overridden
from zswarm.errors import ConfigError
from zswarm.security import refusals
from zswarm.session import Reach
from zswarm.system import log, program, systemd
from zswarm.system.version import VERSION

EXIT_MISTAKE, EXIT_DAMAGED_CONFIG = 2, 78
RETRY_S = 5.0
POLL_S = 0.5


class RouterOptions(
    msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True
):
    """Options of the command line or of the ``--config`` file."""

    listen: list[str] = []  # empty: port 7466 of all addresses
    multicast: bool = True
    require_keys: bool = False  # refuse to start without keys


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option(
    "--listen",
    multiple=True,
    metavar="EP",
    help="Endpoint such as tcp/192.168.1.5:7466; may be repeated.  "
    f"[default: tcp/{session.ROUTER}]",
)
@click.option(
    "--multicast/--no-multicast",
    default=None,
    help="Announce this router by multicast.  [default: multicast]",
)
@click.option(
    "--require-keys/--no-require-keys",
    default=None,
    help="Refuse to start without keys.  [default: no-require-keys]",
)
@click.option(
    "--config",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="TOML file with these options; the command line wins.",
)
@click.option(
    "--log-level", type=click.Choice(log.LEVELS), default="info", show_default=True
)
@click.version_option(VERSION, prog_name="zswarm-router")
def command(config: Path | None, log_level: str, **options: Any) -> None:
    """Bring servers and optimizers together where multicast does not reach.

    Start it on a machine that all others can dial, then

    \b
    on the servers
      zswarm-ss --connect tcp/ROUTER:7466
    on the workstation
      zswarm-ot run --connect tcp/ROUTER:7466
    if the workstation cannot dial the servers
      zswarm-ot run --connect tcp/ROUTER:7466 --through-router

    Without --through-router the optimizer only learns the servers' addresses from the router and
    dials them: evaluations do not pass through it, and runs continue when it ends. SIGTERM or
    Ctrl-C ends it.
    """
    log.set_up(log_level)
    try:
        code = serve(lambda: overridden(config, options, RouterOptions, "zswarm-router"))
    except ConfigError as error:
        click.echo(f"zswarm-router: {error}", err=True)
        sys.exit(EXIT_DAMAGED_CONFIG if config else EXIT_MISTAKE)
    sys.exit(code)


def serve(read_options: Callable[[], RouterOptions]) -> int:
    """Route until SIGTERM or SIGINT, and return the exit code; SIGHUP reloads keys and options."""
    notify = systemd.Notify()
    signals = {signal.SIGTERM, signal.SIGINT, signal.SIGHUP}
    # Before zenoh's threads, which inherit it.
    signal.pthread_sigmask(signal.SIG_BLOCK, signals)
    # After a failed opening zenoh has threads that do not block signals, and may get them.
    received: list[int] = []
    for each in signals:
        signal.signal(each, lambda number, _frame: received.append(number))
    refusals.watch_links()
    options = read_options()
    reach = _reach(options)
    opened, listen = _open(options, reach)
    log.info(
        "router_ready",
        listen=listen,
        keys=daemon.keys_in_words(reach),
        multicast=options.multicast,
        program=VERSION,
    )
    notify.ready()
    while (number := _next_signal(signals, received)) == signal.SIGHUP:
        notify.reloading()
        try:
            new_options = read_options()
            new_reach = _reach(new_options)
        except ConfigError as error:
            log.error("reload_refused", reason=str(error))
        else:
            session.close(opened)
            try:
                opened, listen = _open(new_options, new_reach)
                options, reach = new_options, new_reach
                log.info("reloaded", listen=listen, keys=daemon.keys_in_words(reach))
            except ConfigError as error:
                log.error("reload_refused", reason=str(error))
                opened = _reopen(options, reach)
        notify.ready()
    notify.stopping()
    session.close(opened)
    log.info("router_stopped")
    return 128 + number


def _next_signal(signals: set[signal.Signals], received: list[int]) -> int:
    while not received:
        if info := signal.sigtimedwait(signals, POLL_S):
            return info.si_signo
    return received.pop(0)


def _reach(options: RouterOptions) -> Reach:
    return daemon.find_reach(
        "router", multicast=options.multicast, require_keys=options.require_keys
    )


def _open(options: RouterOptions, reach: Reach) -> tuple[session.Session, list[str]]:
    opened, listen = session.open_router(options.listen, reach)
    daemon.watch(opened, listen, reach, "router")
    return opened, listen


def _reopen(options: RouterOptions, reach: Reach) -> session.Session:
    """Reopen the previous session after a refused reload, as soon as possible; SIGTERM exits."""
    while True:
        try:
            return _open(options, reach)[0]
        except ConfigError as error:
            log.error("off_the_network", reason=str(error), again_s=RETRY_S)
            if number := signal.sigtimedwait({signal.SIGTERM, signal.SIGINT}, RETRY_S):
                sys.exit(128 + number.si_signo)


def main() -> None:
    """Run the program."""
    program.run_command(command)


if __name__ == "__main__":
    main()
