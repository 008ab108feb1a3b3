"""Options that several commands share."""

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import click

from zswarm import experiment, screen
from zswarm.errors import ConfigError
from zswarm.experiment import Experiment
from zswarm.extras import need

DASHBOARD = ("starlette", "uvicorn", "websockets")  # packages of the extra


def _json_alone(context: click.Context, _: click.Parameter, as_json: bool) -> bool:
    """Until the command ends."""
    if as_json and not context.resilient_parsing:
        context.with_resource(screen.json_alone())
    return as_json


json_option = click.option("--json", "as_json", is_flag=True, callback=_json_alone, help="JSON on stdout.")
json_lines_option = click.option(
    "--json", "as_json", is_flag=True, callback=_json_alone, help="JSON on stdout, an object a line."
)


def _dashboard_there(_context: click.Context, _: click.Parameter, wanted: bool) -> bool:
    """Before anything begins."""
    for package in DASHBOARD if wanted else ():
        need(package, "dashboard", "--dashboard")
    return wanted


dashboard_option = click.option(
    "--dashboard",
    "with_dashboard",
    is_flag=True,
    callback=_dashboard_there,
    help="Show it in the browser, too, live: the address is printed.",
)
set_option = click.option(
    "--set",
    "overrides",
    multiple=True,
    metavar="KEY=VALUE",
    help="Set something of the experiment, such as optimizer.population=100; may be repeated.",
)
out_option = click.option(
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    default=Path("runs"),
    show_default=True,
    help="Where the run's folder is made.",
)
CLUSTER = [
    click.option(
        "--servers",
        metavar="auto|local|N",
        help="auto: this machine's slots and every server found; local: this machine only; N: wait for N servers.",
    ),
    click.option("--realm", help="Use the servers of this realm."),
    click.option(
        "--connect",
        multiple=True,
        metavar="EP",
        help="Server or router to dial, such as tcp/192.168.1.5:7467; may be repeated.",
    ),
    click.option("--multicast/--no-multicast", default=None, help="Find servers by multicast.  [default: multicast]"),
    click.option(
        "--through-router/--no-through-router",
        default=None,
        help="Reach all servers through a router: one named by --connect, or found by multicast.",
    ),
    click.option(
        "--require",
        multiple=True,
        metavar="LABEL=VALUE",
        help="What servers must be, such as gpu=yes, room=b12|b13, name!=lab-3 or cores>=8; may be repeated.",
    ),
    click.option(
        "--rank",
        multiple=True,
        metavar="LABEL",
        help="Servers to prefer: gpu=yes, or cores for the higher number, -cores for the lower; may be repeated.",
    ),
    click.option("--max-slots", type=int, metavar="N", help="Slots to hold at the same time, at most; 0: all there are."),
]

LOOKING = [
    click.option("--realm", default="default", show_default=True, help="Realm to look in."),
    click.option("--connect", multiple=True, metavar="EP", help="Server or router to dial; may be repeated."),
    click.option("--multicast/--no-multicast", default=True, help="Find servers by multicast.  [default: multicast]"),
    click.option("--through-router", is_flag=True, help="Look through a router: one named by --connect, or found by multicast."),
]


@contextlib.contextmanager
def named(overrides: Sequence[str], path: Path) -> Iterator[None]:
    """What is wrong by a ``--set`` is told with that option, not with the file, which is not at fault."""
    try:
        yield
    except ConfigError as error:
        key, text = ".".join(error.path), str(error)
        for override in overrides:
            if f"{key}.".startswith(f"{override.partition('=')[0].strip()}.") and text.startswith(f"{path}: "):
                raise type(error)(f"--set {override}{text.removeprefix(str(path))}", error.path) from error
        raise


def cluster_options(command: Any) -> Any:
    """The options that change an experiment's ``[cluster]``."""
    return _with(CLUSTER, command)


def looking_options(command: Any) -> Any:
    """The options that say where to look for servers, without an experiment."""
    return _with(LOOKING, command)


def check_looking(realm: str, connect: Sequence[str]) -> None:
    """Refuse a realm or an endpoint that is none.

    Raises:
        ConfigError: naming the option.
    """
    from zswarm import endpoint
    from zswarm.protocol import keys

    if not keys.is_id(realm):
        raise ConfigError(f"--realm: expected {keys.ID_RULE}, not {realm!r}")
    endpoint.check(connect, "--connect")


def _with(options: Sequence[Any], command: Any) -> Any:
    for option in reversed(options):
        command = option(command)
    return command


def one_stdout(csv: str | None, *, as_json: bool) -> None:
    """Whoever reads stdout gets one thing.

    Raises:
        ConfigError: CSV and JSON are to go there.
    """
    if csv == "-" and as_json:
        raise ConfigError("--csv - and --json would both write to stdout: name a file for the CSV, or leave one out")


def with_cluster(loaded: Experiment, given: dict[str, Any]) -> Experiment:
    """The experiment with the command line's ``[cluster]`` options.

    Raises:
        ConfigError: an impossible one.
    """
    changes = {key: value for key, value in given.items() if value not in (None, ())}
    changes = {key: list(value) if isinstance(value, tuple) else value for key, value in changes.items()}
    if (text := changes.get("servers", "auto")) not in ("auto", "local"):
        if not text.isdigit() or int(text) < 1:
            raise ConfigError(f"--servers {text}: expected auto, local or a number of servers")
        changes["servers"] = int(text)
    return experiment.with_cluster(loaded, changes)
