"""``zswarm-ot servers``: who is there, who matches, and why nobody is found."""

import sys
import textwrap
from typing import TYPE_CHECKING, Any

import click
import msgspec

from zswarm import __version__, experiment
from zswarm.ot.commands import suggestions
from zswarm.ot.commands.options import check_looking, json_option, looking_options
from zswarm.ot.exits import EXIT_NO_SERVERS

if TYPE_CHECKING:
    from zswarm.ot.discovery import Found, Survey
    from zswarm.ot.matching import Choice
    from zswarm.protocol.messages import Offer

NAME_WIDTH = 40  # of a server: with the other columns it fits into 80


@click.command()
@looking_options
@click.option(
    "--wait",
    "wait_s",
    type=click.FloatRange(0.1, 3600.0),
    default=3.0,
    show_default=True,
    metavar="SECONDS",
    help="How long to look.",
)
@click.option(
    "--for",
    "name",
    metavar="EXPERIMENT",
    help="Say which servers match this experiment, and why others do not.",
    shell_complete=suggestions.experiments,
)
@json_option
def servers(
    realm: str, connect: tuple[str, ...], multicast: bool, through_router: bool, wait_s: float, name: str | None, as_json: bool
) -> None:
    """Show the servers of the network.

    With their slots, versions and simulators; or why none is found.

    \b
      zswarm-ot servers
      zswarm-ot servers --for my.toml
    """  # noqa: D301  click's mark for text that is not to be wrapped
    from zswarm.ot import discovery, matching
    from zswarm.protocol.messages import Requirements
    from zswarm.security import keyring
    from zswarm.session import Reach

    check_looking(realm, connect)
    requirements, choice = Requirements(), matching.Choice()
    if name:
        complete = experiment.complete(experiment.load(experiment.find(name)), name)
        requirements, choice = matching.requirements(complete, complete.cluster), matching.choice(complete.cluster)
    survey = discovery.survey(
        realm,
        Reach(connect, multicast, through_router, keyring.installed("ot")),
        requirements=requirements,
        wait_s=wait_s,
    )
    show(survey, realm, choice, through_router=through_router, experiment_name=name or "", as_json=as_json)
    if not survey.servers:
        sys.exit(EXIT_NO_SERVERS)


def show(
    survey: "Survey", realm: str, choice: "Choice", *, through_router: bool, experiment_name: str = "", as_json: bool
) -> None:
    """Servers with what they have, and why one is of no use; or why there are none.

    Args:
        choice: what the experiment says of servers: the preferred ones are shown first.
        experiment_name: the experiment that the servers were asked about; "": about none.
    """
    from zswarm.ot import terminal

    found = survey.servers
    if experiment_name:
        found = sorted(found, key=lambda server: (bool(server.mismatch(choice)), _place(server, choice)))
    for server in found if as_json else []:
        offer = {} if server.offer is None else _offer(server.offer, choice)
        terminal.print_json({"server": server.server, **offer, "address": server.address, "reason": server.reason})
    if found and not as_json:
        _server_table(found, realm, choice, through_router=through_router, experiment_name=experiment_name)
    if not found:
        terminal.line(f"no server found in realm {realm}", stderr=as_json)
        for finding in survey.findings:
            terminal.paragraph(f"- {finding}", stderr=as_json)
    elif survey.elsewhere:
        others = ", ".join(f"{name} ({count})" for name, count in survey.elsewhere.items())
        terminal.paragraph(f"servers of other realms, seen with --realm: {others}", stderr=as_json)


def _place(server: "Found", choice: "Choice") -> tuple[float, ...]:
    return (float("inf"),) if server.offer is None else choice.place(server.offer)


def _server_table(found: "list[Found]", realm: str, choice: "Choice", *, through_router: bool, experiment_name: str) -> None:
    from zswarm.ot import terminal

    offers = [server.offer for server in found if server.offer is not None]
    slots, free = sum(offer.capacity for offer in offers), sum(offer.free for offer in offers)
    terminal.line(
        f"realm {realm}: {len(found)} server{'s' if len(found) != 1 else ''}, {terminal.plural(slots, 'slot')}, {free} free\n"
    )
    columns = ("server", "slots", "free", "runs", "zswarm", *(["matches"] if experiment_name else []))
    table = terminal.table(*columns, box=None, padding=(0, 2, 0, 0))
    reasons: dict[str, list[str]] = {}
    said: dict[str, dict[str, list[str]]] = {"simulators": {}, "labels": {}, "limits": {}}  # in words, and by whom
    for server in found:
        address = server.address or ("through the router" if through_router else "")
        name = "\n".join(textwrap.wrap(server.server, NAME_WIDTH) + [f"  {address}"] * bool(address))
        mismatch = server.mismatch(choice)
        matches = ["no" if mismatch else "yes"] if experiment_name else []
        if mismatch:
            other = server.offer is not None and server.offer.program != __version__
            versions = f" (that is zswarm {server.offer.program}, this is {__version__})" if server.offer and other else ""
            reasons.setdefault(mismatch + versions, []).append(server.server)
        if (offer := server.offer) is None:
            terminal.row(table, name, "", "", "", "", *matches)
            continue
        terminal.row(table, name, offer.capacity, offer.free, offer.leases, offer.program, *matches)
        said["simulators"].setdefault(", ".join(offer.simulators), []).append(server.server)
        given = {label: value for label, value in offer.labels.items() if label != "name"}
        said["labels"].setdefault(", ".join(f"{label}={value}" for label, value in given.items()), []).append(server.server)
        said["limits"].setdefault(", ".join(offer.limits), []).append(server.server)
    terminal.show(table)
    terminal.line("")
    of_experiment = f" for {experiment_name}" if experiment_name else ""
    for reason, names in reasons.items():
        terminal.paragraph(f"not used{of_experiment}: {', '.join(names)}: {reason}")
    for about, by_words in said.items() if not experiment_name else ():
        for words, names in by_words.items():
            where = "" if len(by_words) == 1 else f" on {', '.join(names)}"
            if words:
                terminal.paragraph(f"{about}{where}: {words}")


def _offer(offer: "Offer", choice: "Choice") -> dict[str, Any]:
    values: dict[str, Any] = msgspec.to_builtins(offer)
    return {key: value for key, value in values.items() if key not in ("type", "v", "server")} | {
        "mismatch": choice.mismatch(offer)
    }
