"""The command ``zswarm-ot``: parses and calls."""

import contextlib
import os
import signal
import sqlite3
import sys
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

import click

from zswarm import experiment
from zswarm.errors import ConfigError, NoServers, ZswarmError
from zswarm.experiment import Experiment

if TYPE_CHECKING:
    from zswarm.ot.local import LocalServer
    from zswarm.ot.record import Record
    from zswarm.session import Reach

DEFAULT_EXAMPLE = "emergency-exit"
EXIT_FAILED, EXIT_MISTAKE, EXIT_NO_SERVERS, EXIT_INTERRUPTED, EXIT_TERMINATED = 1, 2, 4, 130, 143

cluster_options = [
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
]
json_option = click.option("--json", "as_json", is_flag=True, help="JSON on stdout.")


def _with_cluster_options(command: Any) -> Any:
    for option in reversed(cluster_options):
        command = option(command)
    return command


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="zswarm", prog_name="zswarm-ot")
def command() -> None:
    """Evolve swarm-robot controllers on this machine and on every zswarm-ss server of the network."""


@command.command()
@click.argument("name", default=DEFAULT_EXAMPLE, metavar="[EXPERIMENT.toml|EXAMPLE]")
@click.option(
    "--set",
    "overrides",
    multiple=True,
    metavar="KEY=VALUE",
    help="Set something of the experiment, such as optimizer.population=100; may be repeated.",
)
@click.option("--seed", type=click.IntRange(0, 2**63 - 2), help="Seed of the run.")
@_with_cluster_options
@click.option(
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    default=Path("runs"),
    show_default=True,
    help="Where the run's folder is made.",
)
@json_option
def run(name: str, overrides: tuple[str, ...], seed: int | None, out: Path, as_json: bool, **cluster: Any) -> None:
    """Evolve a controller; without an argument, the built-in example."""
    path = experiment.find(name)
    more = [f"seed={seed}"] if seed is not None else []
    loaded = _with_cluster(experiment.load(path, [*overrides, *more]), cluster)
    _evaluate_nothing()
    with _local_server(loaded) as local:
        from zswarm.ot import run as runs
        from zswarm.ot.record import Record
        from zswarm.version_hash import version_hash

        complete = experiment.complete(loaded, str(path))
        parts = runs.build(complete)
        code = version_hash(complete.problem.simulator, complete.representation.kind)
        reach = runs.reach(complete.cluster)
        with Record.create(out, complete, code) as record:
            _evolve(complete, parts, record, local, reach, as_json)


@command.command()
@click.argument("folder", type=click.Path(path_type=Path), metavar="RUN")
@_with_cluster_options
@json_option
def resume(folder: Path, as_json: bool, **cluster: Any) -> None:
    """Go on with a run that was stopped, from the last thing it recorded."""
    _evaluate_nothing()
    from zswarm.ot.record import load_experiment

    with _local_server(_with_cluster(load_experiment(folder), cluster)) as local:
        from zswarm.ot import run as runs
        from zswarm.ot.record import Record
        from zswarm.version_hash import version_hash

        record, complete = Record.open(folder)
        complete = _with_cluster(complete, cluster)
        parts = runs.build(complete)
        with record:
            if not parts.optimizer.portable and (before := record.machine_changed()):
                click.echo(f"this run was made with {before}; results may differ from here on", err=True)
            if record.meta("version_hash") != version_hash(complete.problem.simulator, complete.representation.kind):
                click.echo("the code that computes was changed since this run began; results may differ from here on", err=True)
            _evolve(complete, parts, record, local, runs.reach(complete.cluster), as_json)


@command.command()
@click.option("--realm", default="default", show_default=True, help="Realm to look in.")
@click.option("--connect", multiple=True, metavar="EP", help="Server or router to dial; may be repeated.")
@click.option("--multicast/--no-multicast", default=True, help="Find servers by multicast.  [default: multicast]")
@click.option("--through-router", is_flag=True, help="Look through a router: one named by --connect, or found by multicast.")
@click.option(
    "--wait",
    "wait_s",
    type=click.FloatRange(0.1, 3600.0),
    default=3.0,
    show_default=True,
    metavar="SECONDS",
    help="How long to look.",
)
@click.option("--for", "name", metavar="EXPERIMENT", help="Say which servers match this experiment, and why others do not.")
@json_option
def servers(
    realm: str, connect: tuple[str, ...], multicast: bool, through_router: bool, wait_s: float, name: str | None, as_json: bool
) -> None:
    """Show the servers of the network, or why none is found."""
    from zswarm import endpoint
    from zswarm.ot import discovery, tables
    from zswarm.protocol import keys
    from zswarm.protocol.messages import Requirements
    from zswarm.security import keyring
    from zswarm.session import Reach
    from zswarm.version_hash import version_hash

    if not keys.is_id(realm):
        raise ConfigError(f"--realm: expected {keys.ID_RULE}, not {realm!r}")
    endpoint.check(connect, "--connect")
    requirements = Requirements()
    if name:
        loaded = experiment.load(experiment.find(name))
        simulator, representation = loaded.problem.simulator, loaded.representation.kind
        experiment.complete(loaded, name)
        requirements = Requirements(
            simulator=simulator,
            representation=representation,
            version_hash=version_hash(simulator, representation),
            trial_memory_mb=loaded.cluster.trial_memory_mb,
        )
    survey = discovery.survey(
        realm,
        Reach(connect, multicast, through_router, keyring.installed("ot")),
        requirements=requirements,
        wait_s=wait_s,
    )
    tables.servers(survey, realm, through_router=through_router, experiment_name=name or "", as_json=as_json)
    if not survey.servers:
        sys.exit(EXIT_NO_SERVERS)


@command.command("list")
@click.argument("folder", type=click.Path(path_type=Path), default=Path("runs"))
@json_option
def list_(folder: Path, as_json: bool) -> None:
    """Show the runs below a folder, and the examples, simulators, representations and optimizers there are."""
    from zswarm.ot import tables

    tables.everything(folder, as_json=as_json)


@command.command()
@click.argument("name", metavar="EXPERIMENT.toml|EXAMPLE")
@click.option("--set", "overrides", multiple=True, metavar="KEY=VALUE", help="Set something of the experiment.")
@json_option
def check(name: str, overrides: tuple[str, ...], as_json: bool) -> None:
    """Check an experiment and say what it amounts to, without running it."""
    from zswarm.ot import run as runs
    from zswarm.ot import tables

    path = experiment.find(name)
    complete = experiment.complete(experiment.load(path, overrides), str(path))
    tables.check(complete, runs.build(complete), as_json=as_json)


@command.command()
@click.argument("path", type=click.Path(path_type=Path), metavar="RUN|CHAMPION.zsc")
@click.option("--trials", type=click.IntRange(1, 1_000_000), default=100, show_default=True, help="Trials to play.")
@click.option("--seed", type=click.IntRange(0, 2**63 - 1), help="Seed of the trials: unseen ones by default.")
@json_option
def evaluate(path: Path, trials: int, seed: int | None, as_json: bool) -> None:
    """Play a run's champion on seeds it was not evolved on."""
    from zswarm.ot import tables
    from zswarm.ot.controller import load_controller

    tables.evaluated(load_controller(path), trials, seed or 0, as_json=as_json)


def main() -> None:
    """Entry point: errors that are the user's to mend end in one line."""
    try:
        command.main(standalone_mode=False)
    except (click.exceptions.Abort, KeyboardInterrupt):
        sys.exit(EXIT_INTERRUPTED)
    except BrokenPipeError:  # whoever read the output has enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(EXIT_FAILED)
    except click.ClickException as error:
        error.show()
        sys.exit(error.exit_code)
    except ConfigError as error:
        click.echo(f"zswarm-ot: {error}", err=True)
        sys.exit(EXIT_MISTAKE)
    except NoServers as error:
        click.echo(
            f"zswarm-ot: {error}; start zswarm-ss on the machines, or see which are found with: zswarm-ot servers",
            err=True,
        )
        sys.exit(EXIT_NO_SERVERS)
    except (ZswarmError, sqlite3.Error, OSError) as error:  # the last two: a full disk, a folder that was deleted
        click.echo(f"zswarm-ot: {error}", err=True)
        sys.exit(EXIT_FAILED)


def _evolve(
    complete: Experiment, parts: Any, record: "Record", local: "LocalServer | None", reach: "Reach", as_json: bool
) -> None:
    from zswarm.ot import report
    from zswarm.ot import run as runs

    signal.signal(signal.SIGTERM, _terminate)
    try:
        with report.reporter(complete.generations, as_json=as_json) as reporter:
            reporter.say(_who_computes(complete, local))
            if record.on_network:
                reporter.say(f"{record.folder} is on a network file system: the record is kept without a write-ahead log there")
            result = runs.run(complete, parts, record, local, reach, reporter)
        reporter.done(result)
    except (KeyboardInterrupt, SystemExit, ZswarmError, sqlite3.Error, OSError):
        record.close()
        click.echo(f"stopped; nothing is lost. Go on with: zswarm-ot resume {record.folder}", err=True)
        raise


def _terminate(_number: int, _frame: FrameType | None) -> None:
    raise SystemExit(EXIT_TERMINATED)


def _with_cluster(loaded: Experiment, given: dict[str, Any]) -> Experiment:
    """The experiment with the command line's ``[cluster]`` options."""
    changes = {key: value for key, value in given.items() if value not in (None, ())}
    if "connect" in changes:
        changes["connect"] = list(changes["connect"])
    if (text := changes.get("servers", "auto")) not in ("auto", "local"):
        if not text.isdigit() or int(text) < 1:
            raise ConfigError(f"--servers {text}: expected auto, local or a number of servers")
        changes["servers"] = int(text)
    return experiment.with_cluster(loaded, changes)


@contextlib.contextmanager
def _local_server(loaded: Experiment) -> Iterator["LocalServer | None"]:
    """This machine's slots, started first: they load while this program does."""
    if isinstance(loaded.cluster.servers, int):
        yield None
        return
    from zswarm.ot.local import LocalServer

    with LocalServer(experiment.local_slots(loaded), loaded.cluster.realm) as local:
        yield local


def _evaluate_nothing() -> None:
    """This program handles genomes; servers evaluate them. Without numba it starts a third of a second earlier."""
    os.environ["ZSWARM_PLAIN"] = "1"


def _who_computes(complete: Experiment, local: "LocalServer | None") -> str:
    servers, realm = complete.cluster.servers, complete.cluster.realm
    here = f"{local.slots} slot{'s' if local.slots != 1 else ''} of this machine" if local else ""
    if servers == "local":
        return f"{complete.name}: {here}"
    if servers == "auto":
        return f"{complete.name}: {here}, and every server found in realm {realm}"
    return f"{complete.name}: waiting for {servers} servers in realm {realm}"
