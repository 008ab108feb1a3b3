"""The paper's claims, each with what was measured here.

Whether a claim agrees is computed from ``results.json``.
"""

from collections.abc import Callable, Iterator
from typing import NamedTuple

from paper.equations import crossing, ratio
from paper.findings import (
    ALIKE,
    DRASTIC,
    ENOUGH,
    TWO,
    Results,
    Row,
    build,
    constants,
    design_s,
    designs,
    fit,
    longest,
    message_s,
    ms,
    rounds,
    rows,
    table_i,
    times,
    us,
    useful,
)
from paper.names import LOCAL, NODELAY, STOCK, ZENOH
from zswarm.ot.estimate.cost_model import TABLE_I

# From where on a claim agrees; see findings.py for those that the page names.
MOSTLY = 0.9  # of a time
MOST = 0.5  # of the messages
LINEAR = 0.99  # R^2
SAME = 0.01  # of the ratio


class Claim(NamedTuple):
    """A claim of the paper, and the measured result."""

    says: str
    paper: str
    here: str
    agrees: bool
    why: str  # reason if it does not agree


def _messages(results: Results) -> Iterator[Claim]:
    found = rows(results, part="messages", design=STOCK, world="minisim")
    right = [
        row
        for row in found
        if row["messages"] == row["simulations"] * (5 + 2 * row["steps"] * row["agents"])
    ]
    yield Claim(
        "Messages of a simulation (equation 4)",
        "5 + 2 steps x agents",
        f"the same in {len(right)} of {len(found)} optimizations with one server",
        right == found,
        "idle servers also answer a discovery: 4 + servers + 2 steps x agents.",
    )


def _message_time(results: Results) -> Iterator[Claim]:
    here, nodelay, paper = (
        constants(results, STOCK).message_s,
        constants(results, NODELAY).message_s,
        TABLE_I.message_s,
    )
    crowd = max(row["agents"] for row in rows(results, part="messages"))
    (one, stock), (_, quick) = (
        [message_s(results, design, agents) for agents in (1, crowd)]
        for design in (STOCK, NODELAY)
    )
    held = (
        f" If {crowd} agents send at once, a message takes {us(stock)}, and {us(quick)} with "
        f"TCP_NODELAY; from a single agent it takes {us(one)}. So the time is not the broker's "
        "work: TCP delays a small message until the previous one is acknowledged."
    )
    yield Claim(
        "Time of a message, t_msg",
        ms(paper),
        f"{ms(here)}, and {ms(nodelay)} with TCP_NODELAY",
        paper / ALIKE <= here <= paper * ALIKE,
        "the paper's programs may have run on two machines with a network; here they run on one "
        "machine." + (held if stock > DRASTIC * max(one, quick) else ""),
    )


def _compile_time(results: Results) -> Iterator[Claim]:
    found = constants(results, STOCK)
    share, paper = (
        each.compile_s / (each.export_s + each.compile_s + each.fitness_s)
        for each in (found, TABLE_I)
    )
    yield Claim(
        "Compiling is nearly all of the cost of exporting",
        f"{ms(TABLE_I.compile_s)}, {paper:.1%}",
        f"{ms(found.compile_s)}, {share:.1%} ({build(results)})",
        share > MOSTLY,
        "compiling is so fast here that writing the files is a visible share.",
    )


def _linear(results: Results) -> Iterator[Claim]:
    for design in (STOCK, NODELAY):
        found = fit(results, design)
        yield Claim(
            f"Time grows linearly with steps ({design})",
            "linear",
            f"R^2 = {found.r2:.4f}",
            found.r2 > LINEAR,
            "a plane over steps and agents does not explain the times.",
        )


def _crossing(results: Results) -> Iterator[Claim]:
    wanted = crossing(table_i(), TABLE_I)
    yield Claim(
        "With 8 agents and Table I, exporting is faster",
        "with more than 18 steps",
        _since(wanted),
        wanted == 19,
        "the model is wrong.",
    )
    here, nodelay = (
        crossing(table_i(), constants(results, design)) for design in (STOCK, NODELAY)
    )
    there, ratio_here = (
        each.compile_s / each.message_s for each in (TABLE_I, constants(results, STOCK))
    )
    yield Claim(
        "The same with the times measured here, without TCP_NODELAY",
        "with more than 18 steps",
        f"{_since(here)}; with TCP_NODELAY {_since(nodelay)}",
        here is not None
        and wanted is not None
        and wanted / ALIKE <= here <= wanted * ALIKE,
        "at the crossing a simulation's messages take as long as compiling, so it depends on "
        f"t_compile / t_msg: {there:.0f} in the paper, {ratio_here:.0f} here.",
    )


def _threads(_results: Results) -> Iterator[Claim]:
    change = ratio(table_i(1, 1), TABLE_I, 50) / ratio(table_i(1, 1), TABLE_I) - 1
    yield Claim(
        "The ratio of figure 3 does not depend on threads",
        "independent",
        f"it changes by {change:.1%} from 1 to 50 threads, with 1 agent and 1 step",
        abs(change) < SAME,
        "the time between generations does not depend on threads; with 100 steps it is less than a "
        "thousandth.",
    )


def _two_beat_one(results: Results) -> Iterator[Claim]:
    for design in (STOCK, NODELAY):
        found = times(results, "scaling", design, longest(results, "scaling"))
        gain = found[1]["s"] / found[2]["s"]
        yield Claim(
            f"Two servers are much faster than one ({design})",
            "yes",
            f"{gain:.2f} times as fast",
            gain > TWO,
            "most of the time was spent in shared parts: the broker, the optimization tool, this "
            "machine's cores.",
        )


def _ceiling(results: Results) -> Iterator[Claim]:
    for design in (STOCK, NODELAY):
        found = times(results, "scaling", design, longest(results, "scaling"))
        one, best = found[1], found[2]["s"] / min(row["s"] for row in found.values())
        possible = rounds(one, 2) / rounds(one, max(found))
        crowded = _crowded(results, design)
        enough = useful(crowded)
        many = (
            f"it gains from up to {enough} servers, the most measured"
            if enough == max(crowded)
            else f"more than {enough} servers give no gain"
        )
        yield Claim(
            f"More than two servers are not useful ({design})",
            "not for figure 4",
            f"more servers are {best:.2f} times as fast as two; {possible:.2f} is possible",
            best < ENOUGH,
            "here the servers wait in parallel; the paper's limit appears if each message keeps "
            "the broker or the tool busy for its whole duration (see the model below). One "
            "generation has 4 candidates to simulate and the others 2, so no design can gain much "
            f"more. With enough simulations for all servers, {many}.",
        )


def _discovery(results: Results) -> Iterator[Claim]:
    row = max(
        rows(results, part="scaling", design=STOCK),
        key=lambda row: (row["servers"], -row["steps"]),
    )
    # Parameters, control, fitness; sensors, actuators.
    others = row["simulations"] * (3 + 2 * row["steps"] * row["agents"])
    share = (row["messages"] - others) / row["messages"]
    yield Claim(
        "Discovery and its answers are most of the traffic",
        "most",
        f"{share:.1%} of the messages with {row['servers']} servers, {row['agents']} agents, "
        f"{row['steps']} steps",
        share > MOST,
        "a simulation has one discovery and at most one answer from each server, in addition to "
        "two messages for each agent and step.",
    )


def _one_optimization(results: Results) -> Iterator[Claim]:
    found = rows(results, part="designs", world="emergency-exit")
    histories, ways = ({row[key] for row in found} for key in ("history", "design"))
    yield Claim(
        "The place of the controller affects times only",
        "assumed",
        f"{len(ways)} designs, {len(histories)} history hash{'es' if len(histories) > 1 else ''}",
        len(histories) == 1,
        "some design computed another fitness: its times cannot be compared.",
    )


def _parameters(results: Results) -> Iterator[Claim]:
    found = {
        name: design_s(results, name, "emergency-exit")
        for name in designs(results)
        if name != LOCAL
    }
    ours = found.pop(ZENOH["blob"])
    nearest = min(found, key=found.__getitem__)
    yield Claim(
        "Parameters in a message are drastically faster (its section VI)",
        "expected",
        f"{found[nearest] / ours:.1f} times as fast as the second fastest ({nearest})",
        found[nearest] / ours > DRASTIC,
        "most of the time of so short an optimization is its start, and zswarm writes a record.",
    )


def _scales(results: Results) -> Iterator[Claim]:
    found = _crowded(results, ZENOH["blob"])
    most = max(found)
    gain, possible = (
        found[1]["s"] / found[most]["s"],
        rounds(found[1], 1) / rounds(found[1], most),
    )
    yield Claim(
        "With one discovery, more than two servers are useful (its section VI)",
        "expected",
        f"{most} servers are {found[2]['s'] / found[most]['s']:.1f} times as fast as 2, and "
        f"{gain:.1f} times as fast as one; {possible:.1f} is possible",
        useful(found) > 2,
        "with two servers, most of the time is already spent outside the steps.",
    )


def _crowded(results: Results, design: str) -> dict[int, Row]:
    return times(results, "crowded", design, longest(results, "crowded"))


def _since(steps: int | None) -> str:
    """Format the steps of a crossing."""
    return "never" if steps is None else f"from {steps:,} on"


CLAIMS: tuple[Callable[[Results], Iterator[Claim]], ...] = (
    _messages,
    _message_time,
    _compile_time,
    _linear,
    _crossing,
    _threads,
    _two_beat_one,
    _ceiling,
    _discovery,
    _one_optimization,
    _parameters,
    _scales,
)


def claims(results: Results) -> list[Claim]:
    """Return the claims in the paper's order."""
    return [claim for each in CLAIMS for claim in each(results)]
