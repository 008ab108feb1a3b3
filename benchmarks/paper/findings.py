"""What the measurements say: the paper's constants as they are here, and each of its claims beside what was measured.

Nothing is said that the numbers do not bear out: whether a claim agrees is computed from ``results.json``.
"""

import statistics
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

from paper.names import FILES, LOCAL, NODELAY, PAPER_STEP_S, STOCK, ZENOH
from zswarm.ot.cost_model import TABLE_I, TABLE_I_GENERATIONS, TABLE_I_POPULATION, Constants, Plan, crossing, ratio

Results = dict[str, Any]
Row = dict[str, Any]

# From where on a claim agrees.
ENOUGH = 1.1  # times as fast: more servers are of use
TWO = 1.2  # times as fast: "much faster"
DRASTIC = 2.0  # times as fast
MOSTLY = 0.9  # of a time
MOST = 0.5  # of the messages
LINEAR = 0.99  # R^2
ALIKE = 2.0  # times as much, or its inverse: another machine's times
SAME = 0.01  # of the ratio


class Fit(NamedTuple):
    """Seconds of a simulation as ``a + steps (b + c agents)``, by least squares."""

    a: float
    b: float
    c: float
    r2: float  # share of the variance that it explains


class Claim(NamedTuple):
    """Of the paper, beside what was found."""

    says: str
    paper: str
    here: str
    agrees: bool
    why: str  # where it does not agree


def rows(results: Results, **wanted: object) -> list[Row]:
    """Rows in which these keys have these values."""
    return [row for row in results["rows"] if all(row.get(key) == value for key, value in wanted.items())]


def median(results: Results, what: str, **wanted: object) -> float | None:
    """Of the rows that are so; None where there are none."""
    found = [row[what] for row in rows(results, **wanted)]
    return statistics.median(found) if found else None


# ---- constants ----------------------------------------------------------------------------------------------------


def message_s(results: Results, design: str, agents: int) -> float:
    """t_msg of minisim: what longer simulations take more, without their computing, by the messages that they have more."""
    here, alone = (
        {row["steps"]: row for row in rows(results, part="messages", design=each, agents=agents)} for each in (design, LOCAL)
    )
    short, long = min(here), max(here)
    seconds = (here[long]["s"] - here[short]["s"]) - (alone[long]["s"] - alone[short]["s"])
    counted = "turns" if design == ZENOH["turn"] else "decisions"
    return float(seconds / (2 * (alone[long][counted] - alone[short][counted])))


def build(results: Results) -> str:
    """How the file-based design compiled: as the paper where that was possible."""
    return FILES["catkin"] if FILES["catkin"] not in results["missing"] else FILES["cc"]


def constants(results: Results, design: str) -> Constants:
    """Table I as it is here; steps are paced as the paper's were.

    t_msg is the one that explains the optimizations of minisim in real time best, by equation 7.
    """
    spent = {
        each: median(results, each, part="designs", design=build(results)) or 0.0
        for each in ("export_s", "compile_s", "fitness_s")
    }
    grid = rows(results, part="grid", design=design)
    messages = np.array([5 + 2 * row["steps"] * row["agents"] for row in grid], float)
    rest = np.array([row["s"] / row["simulations"] - row["steps"] * row["step_s"] for row in grid])
    each = float((messages * rest).sum() / (messages * messages).sum())
    (evolve,) = rows(results, part="evolve")
    return Constants(evolve_s=evolve["s"], message_s=each, busy_s=each, step_s=PAPER_STEP_S, **spent)


def fit(results: Results, design: str) -> Fit:
    """Of the simulations in real time."""
    grid = rows(results, part="grid", design=design)
    seconds = np.array([row["s"] / row["simulations"] for row in grid])
    columns = np.array([[1.0, row["steps"], row["steps"] * row["agents"]] for row in grid])
    solved, *_ = np.linalg.lstsq(columns, seconds, rcond=None)
    left = seconds - columns @ solved
    r2 = 1 - float((left**2).sum()) / float(((seconds - seconds.mean()) ** 2).sum())
    return Fit(*(float(number) for number in solved), r2)


def table_i(agents: int = 8, steps: int = 1) -> Plan:
    """An optimization of Table I."""
    return Plan(generations=TABLE_I_GENERATIONS, population=TABLE_I_POPULATION, steps=steps, agents=agents)


# ---- more servers -------------------------------------------------------------------------------------------------


def rounds(row: Row, servers: int) -> int:
    """Of simulations one after another: each generation waits for its last, and all but the first have equally many."""
    first = row["population"] * row["trials"]
    later = (row["simulations"] - first) // max(1, row["generations"] - 1)
    return -(-first // servers) - (-later // servers) * (row["generations"] - 1)


def ideal_s(row: Row, servers: int) -> float:
    """The time of nothing but steps."""
    return float(rounds(row, servers) * row["steps"] * row["step_s"])


def times(results: Results, part: str, design: str, steps: int) -> dict[int, Row]:
    """By servers."""
    found = rows(results, part=part, design=design, steps=steps)
    return {row["servers"]: row for row in sorted(found, key=lambda row: row["servers"])}


def useful(by_servers: dict[int, Row]) -> int:
    """The number of servers, of those measured, beyond which no number of them saves a tenth of the time."""
    return next(
        servers for servers, row in by_servers.items() if row["s"] <= ENOUGH * min(more["s"] for more in by_servers.values())
    )


def longest(results: Results, part: str) -> int:
    """Steps of the longest simulations of a part."""
    return max(row["steps"] for row in rows(results, part=part))


# ---- claims -------------------------------------------------------------------------------------------------------


def claims(results: Results) -> list[Claim]:
    """Each in the order of the paper."""
    return [claim for each in CLAIMS for claim in each(results)]


def _messages(results: Results) -> Iterator[Claim]:
    found = rows(results, part="messages", design=STOCK, world="minisim")
    right = [row for row in found if row["messages"] == row["simulations"] * (5 + 2 * row["steps"] * row["agents"])]
    yield Claim(
        "Messages of a simulation (equation 4)",
        "5 + 2 steps x agents",
        f"the same in {len(right)} of {len(found)} optimizations with one server",
        right == found,
        "servers that are idle answer a discovery, too: 4 + servers + 2 steps x agents.",
    )


def _message_time(results: Results) -> Iterator[Claim]:
    here, nodelay, paper = constants(results, STOCK).message_s, constants(results, NODELAY).message_s, TABLE_I.message_s
    crowd = max(row["agents"] for row in rows(results, part="messages"))
    (one, stock), (_, quick) = ([message_s(results, design, agents) for agents in (1, crowd)] for design in (STOCK, NODELAY))
    held = (
        f" Of {crowd} agents, which all send at once, a message takes {us(stock)}, with TCP_NODELAY {us(quick)}; of a single one "
        f"{us(one)}. So it is not the broker's work that takes the time: TCP holds a small message back until the one before it "
        "is acknowledged."
    )
    yield Claim(
        "Time of a message, t_msg",
        ms(paper),
        f"{ms(here)}, and {ms(nodelay)} with TCP_NODELAY",
        paper / ALIKE <= here <= paper * ALIKE,
        "between the paper's programs there may have been a network and two machines, here there is one kernel."
        + (held if stock > DRASTIC * max(one, quick) else ""),
    )


def _compile_time(results: Results) -> Iterator[Claim]:
    found = constants(results, STOCK)
    share, paper = (each.compile_s / (each.export_s + each.compile_s + each.fitness_s) for each in (found, TABLE_I))
    yield Claim(
        "Compiling is nearly all that exporting costs",
        f"{ms(TABLE_I.compile_s)}, {paper:.1%}",
        f"{ms(found.compile_s)}, {share:.1%} ({build(results)})",
        share > MOSTLY,
        "compiling takes so little here that writing the files shows beside it.",
    )


def _linear(results: Results) -> Iterator[Claim]:
    for design in (STOCK, NODELAY):
        found = fit(results, design)
        yield Claim(
            f"Time grows linearly with steps ({design})",
            "linear",
            f"R^2 = {found.r2:.4f}",
            found.r2 > LINEAR,
            "a plane over steps and agents does not explain the times: something else took some of them.",
        )


def _crossing(results: Results) -> Iterator[Claim]:
    wanted = crossing(table_i(), TABLE_I)
    yield Claim(
        "With 8 agents and Table I exporting is faster",
        "with more than 18 steps",
        since(wanted),
        wanted == 19,
        "the model is wrong.",
    )
    here, nodelay = (crossing(table_i(), constants(results, design)) for design in (STOCK, NODELAY))
    there, ratio_here = (each.compile_s / each.message_s for each in (TABLE_I, constants(results, STOCK)))
    yield Claim(
        "The same with the times measured here",
        "with more than 18 steps",
        f"{since(here)}; with TCP_NODELAY {since(nodelay)}",
        here is not None and wanted is not None and wanted / ALIKE <= here <= wanted * ALIKE,
        "the crossing is where a simulation's messages take as long as compiling, and moves with t_compile / t_msg: "
        f"{there:.0f} there, {ratio_here:.0f} here.",
    )


def _threads(_results: Results) -> Iterator[Claim]:
    change = ratio(table_i(1, 1), TABLE_I, 50) / ratio(table_i(1, 1), TABLE_I) - 1
    yield Claim(
        "The ratio of figure 3 does not depend on threads",
        "independent",
        f"it changes by {change:.1%} from 1 to 50 threads, with 1 agent and 1 step",
        abs(change) < SAME,
        "the time between generations has no threads; with 100 steps it is less than a thousandth.",
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
            "most of the time went into what both share: the broker, the optimization tool, this machine's cores.",
        )


def _ceiling(results: Results) -> Iterator[Claim]:
    for design in (STOCK, NODELAY):
        found = times(results, "scaling", design, longest(results, "scaling"))
        one, best = found[1], found[2]["s"] / min(row["s"] for row in found.values())
        possible = rounds(one, 2) / rounds(one, max(found))
        crowded = _crowded(results, design)
        enough = useful(crowded)
        many = f"it gains up to {enough}, the most measured" if enough == max(crowded) else f"more than {enough} are of no use"
        yield Claim(
            f"More than two servers are of no use ({design})",
            "not for figure 4",
            f"more are {best:.2f} times as fast as two, of {possible:.2f} possible",
            best < ENOUGH,
            "what its servers wait for here, they wait for side by side; the paper's ceiling is there where a message keeps "
            "broker or tool from others for as long as it takes (the model, below). One generation has 4 candidates to "
            "simulate and the others 2, so its rounds of simulations allow no design much more. With enough simulations for "
            f"all servers {many}.",
        )


def _discovery(results: Results) -> Iterator[Claim]:
    row = max(rows(results, part="scaling", design=STOCK), key=lambda row: (row["servers"], -row["steps"]))
    others = row["simulations"] * (3 + 2 * row["steps"] * row["agents"])  # parameters, control, fitness, sensors, actuators
    share = (row["messages"] - others) / row["messages"]
    yield Claim(
        "Discovery and its answers are most of the traffic",
        "most",
        f"{share:.1%} of the messages with {row['servers']} servers, {row['agents']} agents, {row['steps']} steps",
        share > MOST,
        "a simulation has one discovery and at most one answer from each server, beside two messages for each agent and step.",
    )


def _one_optimization(results: Results) -> Iterator[Claim]:
    found = rows(results, part="designs", world="emergency-exit")
    histories, ways = ({row[key] for row in found} for key in ("history", "design"))
    yield Claim(
        "Where the controller is changes times only",
        "assumed",
        f"{len(ways)} ways, {len(histories)} history hash{'es' if len(histories) > 1 else ''}",
        len(histories) == 1,
        "some way computed another fitness: its times may not be compared.",
    )


def _parameters(results: Results) -> Iterator[Claim]:
    found = {name: design_s(results, name, "emergency-exit") for name in designs(results) if name != LOCAL}
    ours = found.pop(ZENOH["blob"])
    nearest = min(found, key=found.__getitem__)
    yield Claim(
        "Parameters in a message are drastically faster (its section VI)",
        "expected",
        f"{found[nearest] / ours:.1f} times as fast as the next ({nearest})",
        found[nearest] / ours > DRASTIC,
        "an optimization as short as this is mostly its start, and zswarm's has a record on disk.",
    )


def _scales(results: Results) -> Iterator[Claim]:
    found = _crowded(results, ZENOH["blob"])
    most = max(found)
    gain, possible = found[1]["s"] / found[most]["s"], rounds(found[1], 1) / rounds(found[1], most)
    yield Claim(
        "With one discovery more than two servers are of use (its section VI)",
        "expected",
        f"with {most} servers {found[2]['s'] / found[most]['s']:.1f} times as fast as with 2, and {gain:.1f} times as with one, "
        f"of {possible:.1f} possible",
        useful(found) > 2,
        "what is beside the steps takes most of its time with two servers already.",
    )


def _crowded(results: Results, design: str) -> dict[int, Row]:
    return times(results, "crowded", design, longest(results, "crowded"))


def designs(results: Results) -> list[str]:
    """All that were measured side by side."""
    return list(dict.fromkeys(row["design"] for row in rows(results, part="designs")))


def design_s(results: Results, design: str, world: str) -> float:
    """Median seconds of the optimization that all designs ran; NaN where it did not run in that world."""
    found = median(results, "s", part="designs", design=design, world=world)
    return float("nan") if found is None else found


def ms(seconds: float) -> str:
    """In milliseconds."""
    return f"{1e3 * seconds:,.3g} ms" if abs(seconds) < 1 else f"{1e3 * seconds:,.0f} ms"


def us(seconds: float) -> str:
    """In microseconds."""
    return f"{1e6 * seconds:,.0f} us"


def since(steps: int | None) -> str:
    """The steps of a crossing, in words."""
    return "never" if steps is None else f"from {steps:,} on"


CLAIMS: tuple[Callable[[Results], Iterator[Claim]], ...] = (
    _messages, _message_time, _compile_time, _linear, _crossing, _threads, _two_beat_one, _ceiling, _discovery,
    _one_optimization, _parameters, _scales,
)  # fmt: skip
