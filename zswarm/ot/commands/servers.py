"""``zswarm-ot servers``: list the servers of the network, or explain why none is found."""

import sys
import textwrap
from collections import defaultdict
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import click
import msgspec

from zswarm.ot.commands.shared import options, suggestions
from zswarm.ot.commands.shared.exits import EXIT_NO_SERVERS
from zswarm.ot.display import tables
from zswarm.protocol.messages import Requirements
from zswarm.system.format import plural
from zswarm.system.version import VERSION

if TYPE_CHECKING:
    from zswarm.ot.cluster.discovery import Found, Survey
    from zswarm.ot.cluster.matching import Choice

MENU = ("Evolve", 3)
NAME_WIDTH = 40  # of a server: with the other columns it fits into 80


@click.command("servers")
@options.search_options
@click.option(
    "--wait",
    "wait_s",
    type=click.FloatRange(0.1, 3600.0),
    default=3.0,
    show_default=True,
    metavar="SECONDS",
    help="How long to search.",
)
@click.option(
    "--for",
    "name",
    metavar="EXPERIMENT",
    shell_complete=suggestions.experiments,
    help="Say which servers match this experiment, and why the others do not.",
)
@options.json_option
def command(wait_s: float, name: str | None, as_json: bool, **search: Any) -> None:
    """Show the servers of the network.

    Lists their slots, versions, simulators, labels and limits; or explains why none is found.

    \b
      zswarm-ot servers
      zswarm-ot servers --for my.toml
    """
    from zswarm.ot.cluster import discovery, matching

    realm, reach = search["realm"], options.reach(**search, keys=True)
    requirements, choice = Requirements(), matching.Choice()
    if name:
        complete = options.complete(name, (), {})
        requirements = matching.requirements(complete, complete.cluster)
        choice = matching.choice(complete.cluster)
    survey = discovery.survey(realm, reach, requirements=requirements, wait_s=wait_s)
    if name:
        survey = ranked(survey, choice)
    show(
        survey,
        realm,
        choice,
        name or "",
        as_json=as_json,
        through_router=reach.through_router,
    )
    if not survey.servers:
        sys.exit(EXIT_NO_SERVERS)


def ranked(survey: "Survey", choice: "Choice") -> "Survey":
    """Sort the servers: those that match first, and these by the experiment's rank."""

    def place(server: "Found") -> tuple[bool, tuple[float, ...]]:
        rank = choice.place(server.offer) if server.offer else (float("inf"),)
        return bool(server.mismatch(choice)), rank

    return survey._replace(servers=sorted(survey.servers, key=place))


def show(
    survey: "Survey",
    realm: str,
    choice: "Choice",
    name: str = "",
    *,
    as_json: bool = False,
    through_router: bool = False,
) -> None:
    """Print servers with what they have, and why one is not used; or why there are none.

    ``name`` is that of the experiment which the servers were asked about, if there is one.
    """
    if not survey.servers:
        tables.line(f"no server found in realm {realm}", stderr=as_json)
        for finding in survey.findings:
            tables.paragraph(f"- {finding}", stderr=as_json)
        return
    if as_json:
        for server in survey.servers:
            _print_json(server, choice)
    else:
        _show_table(
            survey.servers, realm, choice if name else None, through_router=through_router
        )
        for line in _not_used(survey.servers, choice, name):
            tables.paragraph(line)
        for line in () if name else _details(survey.servers):
            tables.paragraph(line)
    for finding in survey.findings:
        tables.paragraph(f"- {finding}", stderr=as_json)
    if survey.elsewhere:
        others = ", ".join(
            f"{realm} ({count})" for realm, count in survey.elsewhere.items()
        )
        tables.paragraph(
            f"servers of other realms, seen with --realm: {others}", stderr=as_json
        )


def _print_json(server: "Found", choice: "Choice") -> None:
    values: dict[str, Any] = {"server": server.server}
    if server.offer is not None:
        offer = msgspec.structs.asdict(server.offer)
        values = offer | values  # which has the server's id, too
        values["mismatch"] = choice.mismatch(server.offer)
    tables.print_json({**values, "address": server.address, "reason": server.reason})


def _show_table(
    servers: "Sequence[Found]",
    realm: str,
    choice: "Choice | None",
    *,
    through_router: bool,
) -> None:
    offers = [server.offer for server in servers if server.offer is not None]
    slots = sum(offer.capacity for offer in offers)
    free = sum(offer.free for offer in offers)
    counts = f"{plural(len(servers), 'server')}, {plural(slots, 'slot')}, {free} free"
    tables.line(f"realm {realm}: {counts}\n")
    columns = [
        "server",
        ">slots",
        ">free",
        ">runs",
        "zswarm",
        *["matches"] * (choice is not None),
    ]
    table = tables.table(*columns, box=None, padding=(0, 2, 0, 0))
    for server in servers:
        address = server.address or ("through the router" if through_router else "")
        name = textwrap.wrap(server.server, NAME_WIDTH) + [f"  {address}"] * bool(address)
        cells: list[object] = [""] * 4
        if (offer := server.offer) is not None:
            cells = [offer.capacity, offer.free, offer.leases, offer.program]
        if choice is not None:
            cells.append("no" if server.mismatch(choice) else "yes")
        tables.row(table, "\n".join(name), *cells)
    tables.show(table)
    tables.line("")


def _not_used(servers: "Sequence[Found]", choice: "Choice", name: str) -> Iterator[str]:
    """Yield a line for each reason why servers are not used."""
    reasons = defaultdict(list)
    for server in servers:
        if mismatch := server.mismatch(choice):
            if server.offer is not None and server.offer.program != VERSION:
                mismatch += f" (it has zswarm {server.offer.program}, this is {VERSION})"
            reasons[mismatch].append(server.server)
    purpose = f" for {name}" if name else ""
    for reason, names in reasons.items():
        yield f"not used{purpose}: {', '.join(names)}: {reason}"


def _details(servers: "Sequence[Found]") -> Iterator[str]:
    """Yield a line for each set of simulators, labels and limits, with the servers that have it."""
    offers = [server.offer for server in servers if server.offer is not None]
    details = {
        "simulators": [offer.simulators for offer in offers],
        "labels": [
            [
                f"{label}={value}"
                for label, value in offer.labels.items()
                if label != "name"
            ]
            for offer in offers
        ],
        "limits": [offer.limits for offer in offers],
    }
    for about, lists in details.items():
        names = defaultdict(list)
        for offer, words in zip(offers, lists, strict=True):
            names[", ".join(words)].append(offer.server)
        for text, having in names.items():
            where = "" if len(names) == 1 else f" on {', '.join(having)}"
            if text:
                yield f"{about}{where}: {text}"
