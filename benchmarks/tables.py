"""Format the scripts' results as Markdown tables, a function for each script."""

from collections.abc import Callable, Iterable, Sequence
from typing import Any

Found = dict[str, Any]  # what a script left: see machine.py
Row = dict[str, Any]

FLAGSHIP = "arena-aggregation"  # the kernel that is measured beside all others
# Simulations per second, quoted: measured elsewhere, on two cores of an EPYC.
FREVO = {"stadium": 838.0, "random": 12_740.0}
TASKS = ("stadium", "xor", "aggregation")  # on which methods are compared
ARGOS = 107_000.0  # agent-steps per second and core, quoted: ARGoS 3, diffusion of 8 foot-bots


def markdown(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Format a table."""
    lines = [head, ["---"] * len(head), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def figure(value: float) -> str:
    """Format three digits or more; one decimal below a hundred."""
    return f"{value:,.1f}" if abs(value) < 100 else f"{value:,.0f}"


def share(value: float) -> str:
    """Format a share as .957."""
    return f"{value:.3f}".removeprefix("0")


def spread(row: Row, what: str, written: Callable[[float], str]) -> str:
    """Format a median with its range."""
    least, most = written(row[what + "_least"]), written(row[what + "_most"])
    return f"{written(row[what])} ({least} to {most})"


def missing(rows: Iterable[Row], name: str) -> str:
    """Return a line for each thing not measured, with the reason."""
    reasons = dict.fromkeys(
        f"- {row[name]}: not measured: {row['missing']}\n"
        for row in rows
        if "missing" in row
    )
    return "".join(["\n", *reasons]) if reasons else ""


# ---- dispatch ----------------------------------------------------------------------------------

# Where a peer chooses how many candidates go into a message, that; else one.
ONE_BY_ONE = ("automatic", "1")
WORKS = {
    "noop": "No-op, us per candidate",
    "sleep": "Sleep 5 ms, efficiency",
    "cpu": "5 ms of a core, efficiency",
}


def peers(found: Found) -> list[str]:
    """Return the peers in order."""
    return list(dict.fromkeys(row["peer"] for row in found["rows"]))


def main_way(
    found: Found, peer: str, work: str, slots: int, population: int
) -> Row | None:
    """Return the row of a user who does not chunk by hand; None if not measured."""
    asked = {"peer": peer, "work": work, "slots": slots, "population": population}
    rows = [
        row
        for row in found["rows"]
        if asked.items() <= row.items() and row["cut"] in ONE_BY_ONE
    ]
    return min(rows, key=lambda row: ONE_BY_ONE.index(row["cut"]), default=None)


def cell(row: Row | None) -> str:
    """Return the value of a dispatch row."""
    if row is None:
        return ""
    return figure(row["us"]) if "us" in row else share(row["efficiency"])


def by_slots(found: Found, work: str) -> str:
    """Return a row per peer, a column per population and number of slots."""
    measured = [row for row in found["rows"] if row.get("work") == work]
    columns = sorted({(row["population"], row["slots"]) for row in measured})
    lines = []
    for peer in peers(found):
        cells = [
            cell(main_way(found, peer, work, slots, population))
            for population, slots in columns
        ]
        if any(cells):
            lines.append([peer, *cells])
    head = [
        f"{population}: {slots}" if slots == columns[0][1] else str(slots)
        for population, slots in columns
    ]
    return markdown(["candidates: slots", *head], lines)


def ways(found: Found, slots: int = 4, population: int = 400) -> str:
    """Return all ways of all peers for one number of slots and candidates."""
    here = [
        row
        for row in found["rows"]
        if (row.get("slots"), row.get("population")) == (slots, population)
    ]
    ours = main_way(found, "zswarm", "noop", slots, population)
    lines, before = [], ""
    for peer, form, cut in dict.fromkeys(
        (row["peer"], row["form"], row["cut"]) for row in here
    ):
        values = {
            row["work"]: row
            for row in here
            if (row["peer"], row["form"], row["cut"]) == (peer, form, cut)
        }
        noop = values.get("noop")
        lines.append(
            [
                peer if peer != before else "",
                form,
                cut,
                spread(noop, "us", figure) if noop else "",
                figure(noop["us"] / ours["us"]) if noop and ours else "",
                *(
                    spread(values[work], "efficiency", share) if work in values else ""
                    for work in ("sleep", "cpu")
                ),
            ]
        )
        before = peer
    head = [
        "",
        "form",
        "candidates per message",
        "no-op, us per candidate",
        "relative to zswarm",
    ]
    return markdown(
        [*head, "sleep 5 ms, efficiency", "5 ms of a core, efficiency"], lines
    )


def dispatch(found: Found) -> str:
    """Format all tables of dispatch."""
    parts = [f"{words}:\n\n{by_slots(found, work)}" for work, words in WORKS.items()]
    parts.append(f"Every way, 400 candidates, 4 slots:\n\n{ways(found)}")
    return "\n".join(parts) + missing(found["rows"], "peer")


# ---- the others --------------------------------------------------------------------------------


def kernels(found: Found) -> str:
    """Return a row per kernel and variant, per core."""
    rows = [row for row in found["rows"] if "missing" not in row]
    lines = []
    for kernel in dict.fromkeys(row["kernel"] for row in rows):
        sizes = sorted({row["agents"] for row in rows if row["kernel"] == kernel})
        rate = {
            (row["variant"], row["agents"]): row["agent_steps_per_s"]
            for row in rows
            if row["kernel"] == kernel and "agent_steps_per_s" in row
        }
        seconds = {
            row["variant"]: row.get("seconds_per_simulation")
            for row in rows
            if row["kernel"] == kernel
        }
        for variant in dict.fromkeys(variant for variant, _ in rate):
            cells = []
            for agents in sizes:
                mine, ours = rate.get((variant, agents)), rate.get(("numba", agents))
                times = (
                    f", zswarm {ours / mine:,.2f}x"
                    if mine and ours and variant != "numba"
                    else ""
                )
                cells.append(f"{agents}: {mine / 1e3:,.0f} k{times}" if mine else "")
            each = (
                figure(1 / seconds[variant])
                if len(sizes) == 1 and seconds[variant]
                else ""
            )
            lines.append(
                [kernel, named(variant, rows), "; ".join(filter(None, cells)), each]
            )
    head = [
        "model",
        "variant",
        "agents: agent-steps per second and core; speed of zswarm relative to it",
        "simulations/s",
    ]
    return markdown(head, lines) + missing(
        ({**row, "of": f"{row['kernel']}, {row['variant']}"} for row in found["rows"]),
        "of",
    )


def named(variant: str, rows: Iterable[Row]) -> str:
    """Return a variant's name, marked when its figure is quoted."""
    return (
        f"{variant} (quoted)"
        if any(row.get("quoted") for row in rows if row["variant"] == variant)
        else variant
    )


def many_servers(found: Found) -> str:
    """Format the processor time of each kind of event, by the number of servers."""
    kinds = {
        "answer_us": "a batch is answered",
        "verified_answer_us": "with `verify`",
        "join_us": "a server joins",
        "renewal_us": "a lease is renewed",
        "tick_us": "time passes",
    }
    return markdown(
        ["servers", *(f"{words}, us" for words in kinds.values())],
        [
            [f"{row['servers']:,}", *(f"{row[kind]:.0f}" for kind in kinds)]
            for row in found["rows"]
        ],
    )


def startup(found: Found) -> str:
    """Format first results, then memory."""
    first = [row for row in found["rows"] if row["what"] == "first result" and "s" in row]
    used = [row for row in found["rows"] if row["what"] == "memory"]
    return (
        markdown(
            ["first result", "", "s"],
            [[row["of"], row["how"], spread(row, "s", "{:.2f}".format)] for row in first],
        )
        + missing((row for row in found["rows"] if row["what"] == "first result"), "of")
        + "\n"
        + markdown(
            [
                "memory of a",
                "private, MiB",
                "including its share of shared memory (PSS), MiB",
            ],
            [
                [row["of"], f"{mib(row['own_mb']):.1f}", f"{mib(row['pss_mb']):.1f}"]
                for row in used
            ],
        )
    )


def commands(found: Found) -> str:
    """Format the time of commands."""
    return markdown(
        ["`zswarm-ot`, from return to prompt", "s"],
        [[row["of"], spread(row, "s", "{:.2f}".format)] for row in found["rows"]],
    )


def questions(found: Found) -> str:
    """Format the time of questions to controllers at the optimizer."""
    return markdown(
        ["a question and its answer", "us"],
        [[row["of"], spread(row, "us", figure)] for row in found["rows"]],
    )


def mib(megabytes: float) -> float:
    """Convert MB to MiB."""
    return megabytes * 1e6 / 2**20


def scaling(found: Found) -> str:
    """Return a row per number of servers."""
    by = {(row["work"], row["servers"]): row for row in found["rows"]}
    lines = []
    for servers in sorted({row["servers"] for row in found["rows"]}):
        sleeps, real = by["sleep", servers], by["real", servers]
        lines.append(
            [
                str(servers),
                spread(sleeps, "s", "{:.2f}".format),
                share(sleeps["efficiency"]),
                spread(real, "s", "{:.2f}".format),
            ]
        )
    return markdown(
        [
            "servers",
            "evaluations that sleep 20 ms, s",
            "efficiency",
            "real evaluations, s",
        ],
        lines,
    )


def runs(found: Found) -> str:
    """Format simulations per second of whole runs."""
    return markdown(
        [
            "field",
            "simulations/s",
            "relative to FREVO",
            "simulations/s including the start of the slots",
        ],
        [
            [
                row["field"],
                spread(row, "per_s", figure),
                f"{row['per_s'] / FREVO[row['field']]:.1f}",
                spread(row, "whole_per_s", figure),
            ]
            for row in found["rows"]
        ],
    )


def populations(found: Found) -> str:
    """Format the optimizer's time of a generation by the size of the population."""
    return markdown(
        ["population", "s per generation", "memory of the optimizer, MB"],
        [
            [f"{row['population']:,}", f"{row['generation_s']:.3f}", figure(row["mb"])]
            for row in found["rows"]
        ],
    )


def scale(found: Found) -> str:
    """Format discovery, and the use of many slots."""

    def routed(row: dict[str, Any]) -> str:
        return ", with a router" if row["routed"] else ""

    servers = [row for row in found["rows"] if "ready_s" in row]
    slots = [row for row in found["rows"] if "efficiency" in row]
    return (
        markdown(
            [
                "servers",
                "all slots ready, s",
                "optimizer's CPU, s",
                "memory, MB",
                "messages to and from a server",
            ],
            [
                [
                    f"{row['servers']:,}{routed(row)}",
                    f"{row['ready_s']:.2f}",
                    f"{row['cpu_s']:.2f}",
                    f"{row['mb']:.0f}",
                    ", ".join(
                        f"{row['messages'][side]:.1f}" for side in ("received", "sent")
                    ),
                ]
                for row in servers
            ],
        )
        + "\n"
        + markdown(
            [
                "slots",
                "trial, s",
                "efficiency",
                "us of CPU time per evaluation: optimizer, servers, router",
            ],
            [
                [
                    f"{row['slots']:,}{routed(row)}",
                    f"{row['trial_s']:g}",
                    share(row["efficiency"]),
                    f"{row['optimizer_us']:.0f}, {row['servers_us']:.0f}"
                    + (f", {row['router_us']:.0f}" if row["routed"] else ""),
                ]
                for row in slots
            ],
        )
    )


# ---- methods -----------------------------------------------------------------------------------


def methods(found: Found) -> str:
    """Return a row per method: final fitness by task, and speed against random search."""
    rows = {(row["task"], row["method"]): row for row in found["rows"]}
    tasks, names = (list(dict.fromkeys(key[part] for key in rows)) for part in (0, 1))
    lines = []
    for name in names:
        cells = []
        for task in tasks:
            row, random = rows[task, name], rows.get((task, "random"))
            at = {
                "median": row["median"][-1],
                "median_least": row["q25"][-1],
                "median_most": row["q75"][-1],
            }
            cells += [
                spread(at, "median", "{:.3g}".format),
                soonest(row, random["median"][-1]) if random else "",
            ]
        lines.append([name, *cells])
    head = [
        cell
        for task in tasks
        for cell in (
            f"{task}, {rows[task, names[0]]['evaluations'][-1]:,}",
            "random's after",
        )
    ]
    return markdown(["method", *head], lines)


def noise(found: Found) -> str:
    """Return what runs report and what their champions do, and what racing saves."""
    lines, raced = [], []
    for row in found["rows"]:
        lines.append(
            [
                f"{row['task']}, {row['simulations']:,}",
                row["mode"],
                *(f"{row[name]:.3g}" for name in ("search_reported", "search")),
                f"{row['search_gap']:+.0%}",
                *(f"{row[name]:.3g}" for name in ("assessed_reported", "assessed")),
                f"{row['assessed_gap']:+.1%} ({row['assessed_error']:.1%})",
                f"{row['assessed_beats_search']:.2f}",
                f"{row['assessed_beats_fixed']:.2f}",
            ]
        )
        if choice := row.get("choice"):
            names = ("right_raced", "right_equal", "right_fewer")
            right = (share(choice[name]) for name in names)
            raced.append([row["task"], f"{choice['saved']:.0%}", *right])
    head = [
        "problem, simulations",
        "seeds",
        "in search",
        "held-out",
        "difference",
        "assessed",
        "held-out",
        "difference",
        "beats search's",
        "beats fixed",
    ]
    last = [
        "problem",
        "simulations saved",
        "right: racing",
        "right: all trials",
        "right: as many trials as racing",
    ]
    return f"{markdown(head, lines)}\n{markdown(last, raced)}"


def soonest(row: Row, fitness: float) -> str:
    """Return the evaluations after which the median is that good."""
    return next(
        (
            f"{at:,}"
            for at, median in zip(row["evaluations"], row["median"], strict=True)
            if median >= fitness
        ),
        "",
    )
