"""Calculate from the measurements what the paper has: constants, times and servers of use."""

import statistics
from typing import Any, NamedTuple

import numpy as np

from paper.names import FILES, LOCAL, PAPER_STEP_S, ZENOH
from zswarm.ot.estimate.cost_model import (
    TABLE_I_GENERATIONS,
    TABLE_I_POPULATION,
    Constants,
    Plan,
)

Results = dict[str, Any]
Row = dict[str, Any]

# From where on a claim agrees.
ENOUGH = 1.1  # times as fast: more servers are of use
TWO = 1.2  # times as fast: "much faster"
DRASTIC = 2.0  # times as fast
ALIKE = 2.0  # times as much, or its inverse: another machine's times


class Fit(NamedTuple):
    """Seconds of a simulation as ``a + steps (b + c agents)``, by least squares."""

    a: float
    b: float
    c: float
    r2: float  # share of the variance that it explains


def rows(results: Results, **wanted: object) -> list[Row]:
    """Return rows in which these keys have these values."""
    return [
        row
        for row in results["rows"]
        if all(row.get(key) == value for key, value in wanted.items())
    ]


def median(results: Results, what: str, **wanted: object) -> float | None:
    """Return the median of matching rows; None without any."""
    found = [row[what] for row in rows(results, **wanted)]
    return statistics.median(found) if found else None


# ---- constants ---------------------------------------------------------------------------------


def message_s(results: Results, design: str, agents: int) -> float:
    """Return t_msg of minisim: extra time of longer simulations, by their extra messages."""
    here, alone = (
        {
            row["steps"]: row
            for row in rows(results, part="messages", design=each, agents=agents)
        }
        for each in (design, LOCAL)
    )
    short, long = min(here), max(here)
    seconds = (here[long]["s"] - here[short]["s"]) - (
        alone[long]["s"] - alone[short]["s"]
    )
    counted = "turns" if design == ZENOH["turn"] else "decisions"
    return float(seconds / (2 * (alone[long][counted] - alone[short][counted])))


def build(results: Results) -> str:
    """Return how the file-based design compiled: as the paper where possible."""
    return FILES["catkin"] if FILES["catkin"] not in results["missing"] else FILES["cc"]


def constants(results: Results, design: str) -> Constants:
    """Return this machine's Table I; steps are paced as the paper's were.

    t_msg is the one that explains the optimizations of minisim in real time best, by equation 7.
    """
    spent = {
        each: median(results, each, part="designs", design=build(results)) or 0.0
        for each in ("export_s", "compile_s", "fitness_s")
    }
    grid = rows(results, part="grid", design=design)
    messages = np.array([5 + 2 * row["steps"] * row["agents"] for row in grid], float)
    rest = np.array(
        [row["s"] / row["simulations"] - row["steps"] * row["step_s"] for row in grid]
    )
    each = float((messages * rest).sum() / (messages * messages).sum())
    (evolve,) = rows(results, part="evolve")
    return Constants(
        evolve_s=evolve["s"], message_s=each, busy_s=each, step_s=PAPER_STEP_S, **spent
    )


def fit(results: Results, design: str) -> Fit:
    """Fit equations 9 and 10 to simulations in real time."""
    grid = rows(results, part="grid", design=design)
    seconds = np.array([row["s"] / row["simulations"] for row in grid])
    columns = np.array(
        [[1.0, row["steps"], row["steps"] * row["agents"]] for row in grid]
    )
    solved, *_ = np.linalg.lstsq(columns, seconds, rcond=None)
    left = seconds - columns @ solved
    r2 = 1 - float((left**2).sum()) / float(((seconds - seconds.mean()) ** 2).sum())
    return Fit(*(float(number) for number in solved), r2)


def table_i(agents: int = 8, steps: int = 1) -> Plan:
    """Return the plan of an optimization of Table I."""
    return Plan(
        generations=TABLE_I_GENERATIONS,
        population=TABLE_I_POPULATION,
        steps=steps,
        agents=agents,
    )


# ---- more servers ------------------------------------------------------------------------------


def rounds(row: Row, servers: int) -> int:
    """Return the rounds of sequential simulations: each generation waits for its last."""
    first = row["population"] * row["trials"]
    later = (row["simulations"] - first) // max(1, row["generations"] - 1)
    return -(-first // servers) - (-later // servers) * (row["generations"] - 1)


def ideal_s(row: Row, servers: int) -> float:
    """Return the time of the steps alone."""
    return float(rounds(row, servers) * row["steps"] * row["step_s"])


def times(results: Results, part: str, design: str, steps: int) -> dict[int, Row]:
    """Return seconds by number of servers."""
    found = rows(results, part=part, design=design, steps=steps)
    return {row["servers"]: row for row in sorted(found, key=lambda row: row["servers"])}


def useful(by_servers: dict[int, Row]) -> int:
    """Return the measured number of servers beyond which none saves a tenth of the time."""
    return next(
        servers
        for servers, row in by_servers.items()
        if row["s"] <= ENOUGH * min(more["s"] for more in by_servers.values())
    )


def longest(results: Results, part: str) -> int:
    """Return the steps of the longest simulations of a part."""
    return max(row["steps"] for row in rows(results, part=part))


def designs(results: Results) -> list[str]:
    """Return all designs of the common optimization."""
    return list(dict.fromkeys(row["design"] for row in rows(results, part="designs")))


def design_s(results: Results, design: str, world: str) -> float:
    """Return the median seconds of the common optimization; NaN where a design did not run it."""
    found = median(results, "s", part="designs", design=design, world=world)
    return float("nan") if found is None else found


def ms(seconds: float) -> str:
    """Format milliseconds."""
    return f"{1e3 * seconds:,.3g} ms" if abs(seconds) < 1 else f"{1e3 * seconds:,.0f} ms"


def us(seconds: float) -> str:
    """Format microseconds."""
    return f"{1e6 * seconds:,.0f} us"
