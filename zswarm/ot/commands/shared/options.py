"""Arguments and options that several commands share."""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from zswarm import experiment
from zswarm.config.overrides import blamed
from zswarm.errors import ConfigError
from zswarm.experiment import Experiment
from zswarm.ot.commands.shared import suggestions
from zswarm.protocol import endpoint
from zswarm.protocol.keys import ID_RULE, is_id
from zswarm.system import terminal
from zswarm.system.extras import need

if TYPE_CHECKING:
    from zswarm.session import Reach

F = TypeVar("F", bound=Callable[..., Any])

DASHBOARD = ("starlette", "uvicorn", "websockets")  # packages of the extra
PATH = click.Path(path_type=Path)
TRIALS = click.IntRange(1, 1_000_000)
number_option = partial(click.option, type=int, metavar="N")


def _from_zero(_: click.Context, __: click.Parameter, given: int | None) -> int | None:
    """Return a generation as the record counts it, from 0; people count from 1."""
    return None if given is None else given - 1


generation_option = partial(number_option, callback=_from_zero)


def _json_only(context: click.Context, _: click.Parameter, as_json: bool) -> bool:
    """Keep everything but JSON off stdout until the command ends."""
    if as_json and not context.resilient_parsing:
        context.with_resource(terminal.json_alone())
    return as_json


def _need_dashboard(_context: click.Context, _: click.Parameter, wanted: bool) -> bool:
    """Refuse before anything begins."""
    if wanted:
        check_dashboard("--dashboard")
    return wanted


def check_dashboard(what: str) -> None:
    """Refuse a dashboard whose packages are not installed."""
    for package in DASHBOARD:
        need(package, "dashboard", what)


def together(*options: Callable[[F], F]) -> Callable[[F], F]:
    """Make several options one, which lists them in this order."""

    def add(command: F) -> F:
        for option in reversed(options):
            command = option(command)
        return command

    return add


def set_option_of(what: str, example: str, limits: str = "") -> Callable[[F], F]:
    """Make a ``--set`` option."""
    text = f"Change a setting of the {what}, such as {example}{limits}; may be repeated."
    return click.option(
        "--set", "overrides", multiple=True, metavar="KEY=VALUE", help=text
    )


def output_option(text: str) -> Callable[[F], F]:
    """Make an ``--output`` option, for one file."""
    return click.option("-o", "--output", type=PATH, metavar="FILE", help=text)


experiment_argument = click.argument(
    "name", metavar="EXPERIMENT.toml|EXAMPLE", shell_complete=suggestions.experiments
)
champion_argument = click.argument(
    "path", type=PATH, metavar="RUN|CHAMPION.zsc", shell_complete=suggestions.runs
)
paths_argument = click.argument(
    "paths",
    nargs=-1,
    required=True,
    type=PATH,
    metavar="RUN|STUDY...",
    shell_complete=suggestions.runs,
)
json_option, json_lines_option = (
    click.option("--json", "as_json", is_flag=True, callback=_json_only, help=text)
    for text in ("Print JSON on stdout.", "Print JSON on stdout, one object per line.")
)
dashboard_option = click.option(
    "--dashboard",
    "with_dashboard",
    is_flag=True,
    callback=_need_dashboard,
    help="Show it live in the browser as well; the address is printed.",
)
detach_option = click.option(
    "--detach",
    is_flag=True,
    help="Continue without this terminal, also when it is closed; see attach, status and stop.",
)
set_option = set_option_of("experiment", "optimizer.population=100")
out_option = click.option(
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    default=suggestions.RUNS,
    show_default=True,
    help="Folder in which the run's folder is made.",
)
csv_option = click.option(
    "--csv", metavar="FILE", help="Also write the numbers as CSV; - is stdout."
)
measure_option = click.option(
    "--measure",
    metavar="search|held-out|fitness|METRIC",
    help="search: best fitness in search; held-out: the champion's, as assessed at the end of "
    "the run; fitness, or a metric of the simulator: the champion's, as evaluate played it.  "
    "[default: held-out if all runs are finished and assessed, else search]",
)
label_option = click.option(
    "--label",
    "labels",
    multiple=True,
    metavar="GROUP=NAME",
    help="Another name for a group; may be repeated.",
)
candidate_option = number_option(
    "--candidate",
    help="Candidate of the generation, from 0.  [default: the best; without "
    "--generation, the champion]",
)
MULTICAST = "Find servers by multicast.  [default: multicast]"
# Those that change an experiment's ``[cluster]``: where its servers are, and all of them.
network_options = together(
    click.option("--realm", help="Use the servers of this realm."),
    click.option(
        "--connect",
        multiple=True,
        metavar="EP",
        help="Connect to this server or router, such as tcp/192.168.1.5:7467; may be repeated.",
    ),
    click.option("--multicast/--no-multicast", default=None, help=MULTICAST),
    click.option(
        "--through-router/--no-through-router",
        default=None,
        help="Reach all servers through a router, given by --connect or found by multicast.",
    ),
)
cluster_options = together(
    click.option(
        "--servers",
        metavar="auto|local|N",
        help="auto: this machine's slots and all servers found; local: this machine only; N: wait "
        "up to 10 s for N servers.",
    ),
    network_options,
    click.option(
        "--require",
        multiple=True,
        metavar="LABEL=VALUE",
        help="Use only servers with this label, such as gpu=yes, room=b12|b13, name!=lab-3 or "
        "cores>=8; may be repeated.",
    ),
    click.option(
        "--rank",
        multiple=True,
        metavar="LABEL",
        help="Prefer servers: gpu=yes, or cores for the higher number, -cores for the lower; may "
        "be repeated.",
    ),
    number_option(
        "--max-slots", help="Hold at most this many slots at a time; 0: no limit."
    ),
)
# Those that say where to search for servers, without an experiment.
search_options = together(
    click.option(
        "--realm", default="default", show_default=True, help="Realm to search."
    ),
    click.option(
        "--connect",
        multiple=True,
        metavar="EP",
        help="Connect to this server or router; may be repeated.",
    ),
    click.option("--multicast/--no-multicast", default=True, help=MULTICAST),
    click.option(
        "--through-router",
        is_flag=True,
        help="Search through a router, given by --connect or found by multicast.",
    ),
)


@contextlib.contextmanager
def writing(path: Path, if_it_exists: str) -> Iterator[None]:
    """Report why a new file or folder cannot be written, in one line."""
    try:
        yield
    except FileExistsError:
        raise ConfigError(f"{path}: exists already; {if_it_exists}") from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}") from None


def given_by_set(overrides: Sequence[str]) -> list[tuple[str, str]]:
    """Return the keys of ``--set`` options, and the options, for ``blamed``."""
    return [
        (override.partition("=")[0].strip(), f"--set {override}")
        for override in overrides
    ]


def complete(name: str, overrides: Sequence[str], cluster: dict[str, Any]) -> Experiment:
    """Load an experiment with the command line's options, and complete it.

    Raises:
        ConfigError: something in the file or an option is impossible.
    """
    return loaded_and_complete(name, overrides, cluster)[1]


def loaded_and_complete(
    name: str, overrides: Sequence[str], cluster: dict[str, Any]
) -> tuple[Experiment, Experiment]:
    """Return an experiment as its file has it, and complete; errors as ``complete``."""
    path = experiment.find(name)
    with blamed(given_by_set(overrides), str(path)):
        loaded = with_cluster(experiment.load(path, overrides), cluster)
        return loaded, experiment.complete(loaded, str(path))


def reach(
    realm: str,
    connect: Sequence[str],
    multicast: bool,
    through_router: bool,
    *,
    keys: bool,
) -> "Reach":
    """Return how to reach the servers that the search options name.

    Raises:
        ConfigError: not a realm or an endpoint.
    """
    from zswarm.security import keyring
    from zswarm.session import Reach

    if not is_id(realm):
        raise ConfigError(f"--realm: expected {ID_RULE}, not {realm!r}")
    endpoint.check(connect, "--connect")
    return Reach(
        connect, multicast, through_router, keyring.installed("ot") if keys else None
    )


def check_stdout(csv: str | None, *, as_json: bool) -> None:
    """Refuse CSV and JSON on the same stdout.

    Raises:
        ConfigError: both were asked for.
    """
    if csv == "-" and as_json:
        raise ConfigError(
            "--csv - and --json would both write to stdout: name a file for the CSV, or omit one"
        )


def with_cluster(loaded: Experiment, given: dict[str, Any]) -> Experiment:
    """Apply the command line's ``[cluster]`` options to an experiment.

    Raises:
        ConfigError: an option is impossible.
    """
    changes: dict[str, Any] = {
        key: list(value) if isinstance(value, tuple) else value
        for key, value in given.items()
        if value not in (None, ())
    }
    if (text := changes.get("servers", "auto")) not in ("auto", "local"):
        if not text.isdigit() or int(text) < 1:
            raise ConfigError(
                f"--servers {text}: expected auto, local or a number of servers"
            )
        changes["servers"] = int(text)
    return experiment.with_cluster(loaded, changes)
