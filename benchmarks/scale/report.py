"""The tables and charts of what was measured."""

import os
import statistics
import textwrap
from pathlib import Path
from typing import NamedTuple

import numpy as np

from scale.ideal import Schedule
from scale.life import Run
from scale.pretended import CAPACITY

GOAL_EFFICIENCY, GOAL_FOUND_S, GOAL_FOUND_SERVERS = 0.90, 1.0, 256


class Fleet(NamedTuple):
    """How many servers, and whether a router carries all messages."""

    servers: int
    routed: bool = False

    def __str__(self) -> str:
        return f"{self.servers:,}{', router' if self.routed else ''}"


class Results(NamedTuple):
    """All that was measured."""

    opened: dict[Fleet, float]  # MB per server
    found: dict[Fleet, list[Run]]
    used: dict[tuple[Fleet, float], Run]  # by servers and seconds of a trial
    tails: dict[str, tuple[Run, Schedule]]


def table(head: list[str], rows: list[list[str]]) -> None:
    """Format a Markdown table."""
    for row in (head, ["---"] * len(head), *rows):
        print("| " + " | ".join(row) + " |")
    print(flush=True)


def median(runs: list[Run], what: str) -> float:
    """Return the median of a field of discoveries."""
    return statistics.median(getattr(run.found, what) for run in runs)


def mean(run: Run, what: str) -> float:
    """Return the mean of a field of generations."""
    return statistics.mean(getattr(use, what) for use in run.uses)


def cpu(run: Run) -> tuple[float, float]:
    """Return microseconds per evaluation of the optimizer and of all servers."""
    mine, theirs = (sum(use.cpu[side] for use in run.uses) for side in (0, 1))
    evaluations = sum(use.evaluations for use in run.uses)
    return mine / evaluations * 1e6, theirs / evaluations * 1e6


def print_tables(results: Results) -> None:
    """Print the tables of docs/benchmarks.md."""
    print("Finding servers, seconds from before the session is opened; medians\n")
    table(
        [
            "servers",
            "never found",
            "all offered, s",
            "all leased, s",
            "all slots ready, s",
            "optimizer's CPU, s",
            "memory, MB",
            "threads",
            "open files",
            "leaving, s",
            "MB per server",
        ],
        [
            [
                str(fleet),
                ", ".join(str(fleet.servers - run.found.servers) for run in runs),
                *(
                    f"{median(runs, what):.2f}"
                    for what in ("offered_s", "leased_s", "ready_s", "cpu_s")
                ),
                *(
                    f"{median(runs, what):.0f}"
                    for what in ("mb", "threads", "descriptors")
                ),
                f"{statistics.median(run.leave_s for run in runs):.2f}",
                f"{results.opened[fleet]:.2f}",
            ]
            for fleet, runs in results.found.items()
        ],
    )
    print(
        "Messages per server of a run that evaluates nothing; received and sent by the server\n"
    )
    kinds = sorted(
        {kind for runs in results.found.values() for run in runs for kind in run.messages}
    )
    table(
        ["servers", *kinds],
        [
            [
                str(fleet),
                *(
                    f"{statistics.mean(run.messages.get(kind, 0) for run in runs):.2f}"
                    for kind in kinds
                ),
            ]
            for fleet, runs in results.found.items()
        ],
    )
    print(
        "Generations; shares of slot time lost, CPU in cores and in us per evaluation: optimizer, "
        "all servers\n"
    )
    table(
        [
            "slots",
            "a trial, s",
            "evaluations",
            "efficiency",
            "lost at the start",
            "between",
            "in the tail",
            "cores",
            "us each",
            "sent to a server, kB",
            "optimizer, MB",
        ],
        [
            [
                str(Fleet(fleet.servers * CAPACITY, fleet.routed)),
                f"{mean_s:g}",
                f"{run.uses[0].evaluations:,}",
                f"{mean(run, 'efficiency'):.3f}",
                *(f"{mean(run, what):.3f}" for what in ("start", "gaps", "tail")),
                ", ".join(
                    f"{each * mean(run, 'evaluations') / 1e6 / mean(run, 'wall_s'):.2f}"
                    for each in cpu(run)
                ),
                ", ".join(f"{each:.0f}" for each in cpu(run)),
                f"{run.kilobytes[0]:.0f}",
                f"{run.rss_mb:.0f}",
            ]
            for (fleet, mean_s), run in results.used.items()
        ],
    )
    print(
        "Tails: from the first slot that gets no more work to the end of the generation\n"
    )
    table(
        [
            "trial times",
            "efficiency",
            "tail, s: mean, longest",
            "slots idle in it: mean, most",
            "slot time lost in it",
            "generation, s",
            "by the schedule",
            "no trial bound to a server",
            "and stragglers started twice",
        ],
        [
            [
                name,
                f"{mean(run, 'efficiency'):.3f}",
                f"{mean(run, 'tail_s'):.2f}, {max(u.tail_s for u in run.uses):.2f}",
                f"{mean(run, 'idle'):.2f}, {max(u.idle for u in run.uses):.2f}",
                f"{mean(run, 'tail'):.3f}",
                f"{mean(run, 'wall_s'):.2f}",
                *(f"{seconds:.2f}" for seconds in schedule),
            ]
            for name, (run, schedule) in results.tails.items()
        ],
    )


def handshake(run: Run) -> dict[str, float]:
    """Return messages to and from a server until it is used; renewals' answers are leases, too."""
    told = run.messages
    received = told.get("received offer", 0.0) + told.get("received reserve", 0.0)
    sent = (
        told.get("sent offer", 0.0)
        + told.get("sent lease", 0.0)
        - told.get("received renew", 0.0)
    )
    return {"received": received, "sent": sent}


def rows(results: Results) -> list[dict[str, object]]:
    """Return the rows of docs/benchmarks.md: discovery, then use of slots."""
    found: list[dict[str, object]] = [
        {
            "servers": fleet.servers,
            "routed": fleet.routed,
            "ready_s": median(runs, "ready_s"),
            "cpu_s": median(runs, "cpu_s"),
            "mb": median(runs, "mb"),
            "never_found": max(fleet.servers - run.found.servers for run in runs),
            "messages": {
                side: statistics.mean(handshake(run)[side] for run in runs)
                for side in ("received", "sent")
            },
        }
        for fleet, runs in results.found.items()
    ]
    for (fleet, mean_s), run in results.used.items():
        optimizer_us, servers_us = cpu(run)
        found.append(
            {
                "slots": fleet.servers * CAPACITY,
                "routed": fleet.routed,
                "trial_s": mean_s,
                "evaluations": run.uses[0].evaluations,
                "efficiency": mean(run, "efficiency"),
                "optimizer_us": optimizer_us,
                "servers_us": servers_us,
                "router_us": run.router_s
                / sum(use.evaluations for use in run.uses)
                * 1e6,
            }
        )
    return found


def draw(results: Results, file: Path) -> None:
    """Draw the charts."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    plt.rcParams.update(
        {"font.size": 10, "axes.grid": True, "grid.alpha": 0.3, "axes.axisbelow": True}
    )
    figure, ((found, use), (load, tails)) = plt.subplots(
        2, 2, figsize=(12, 9), layout="constrained"
    )
    sizes = [fleet.servers for fleet in results.found if not fleet.routed]
    for what, style, routed, label in (
        ("offered_s", "o-", False, "all have offered"),
        ("leased_s", "o-", False, "all have given a lease"),
        ("ready_s", "o-", False, "all slots ready"),
        ("ready_s", "s--", True, "all slots ready, with a router"),
    ):
        fleets = [fleet for fleet in results.found if fleet.routed == routed]
        found.loglog(
            [fleet.servers for fleet in fleets],
            [median(results.found[fleet], what) for fleet in fleets],
            style,
            label=label,
        )
    found.plot(
        [GOAL_FOUND_SERVERS],
        [GOAL_FOUND_S],
        "kx",
        markersize=10,
        label="goal: below 1 s for 256 servers",
    )
    found.set(
        title="Finding servers", xlabel="servers", ylabel="s from opening the session"
    )
    found.set_xticks(sizes, [f"{size:,}" for size in sizes])
    found.minorticks_off()

    kinds = dict.fromkeys((mean_s, fleet.routed) for fleet, mean_s in results.used)
    for mean_s, routed in kinds:
        points = [
            (fleet.servers * CAPACITY, run)
            for (fleet, s), run in results.used.items()
            if (s, fleet.routed) == (mean_s, routed)
        ]
        slots_ = [size for size, _ in points]
        trials = f"trials of {mean_s:g} s{', with a router' if routed else ''}"
        use.semilogx(
            slots_,
            [mean(run, "efficiency") for _, run in points],
            "s--" if routed else "o-",
            label=trials,
        )
        load.loglog(
            [run.uses[0].evaluations / mean(run, "wall_s") for _, run in points],
            [
                cpu(run)[0] * mean(run, "evaluations") / 1e6 / mean(run, "wall_s")
                for _, run in points
            ],
            "o-",
            label=f"optimizer, {trials}",
        )
        load.loglog(
            [run.uses[0].evaluations / mean(run, "wall_s") for _, run in points],
            [
                cpu(run)[1] * mean(run, "evaluations") / 1e6 / mean(run, "wall_s")
                for _, run in points
            ],
            "s--",
            label=f"all servers, {trials}",
        )
    use.axhline(
        GOAL_EFFICIENCY,
        color="k",
        linestyle=":",
        label=f"goal at 4,096 slots: {GOAL_EFFICIENCY:.2f}",
    )
    ticks = sorted({fleet.servers * CAPACITY for fleet, _ in results.used})
    use.set_xticks(ticks, [f"{tick:,}" for tick in ticks])
    use.minorticks_off()
    use.set(
        title="Use of the slots",
        xlabel="slots",
        ylabel="ideal time / time of a generation",
        ylim=(0, 1.02),
    )
    load.axhline(
        os.cpu_count() or 1,
        color="k",
        linestyle=":",
        label=f"this machine, both sides: {os.cpu_count()} cores",
    )
    load.set(title="What it costs", xlabel="evaluations per second", ylabel="cores busy")

    names = list(results.tails)
    place = np.arange(len(names))
    bars = [("measured", [mean(run, "wall_s") for run, _ in results.tails.values()])]
    bars += [
        (label, [schedule[i] for _, schedule in results.tails.values()])
        for i, label in (
            (0, "same schedule, free network"),
            (1, "no trial bound to a server"),
            (2, "and stragglers started twice"),
        )
    ]
    for i, (label, seconds) in enumerate(bars):
        tails.bar(place + (i - 1.5) * 0.2, seconds, 0.2, label=label)
    tails.set_xticks(place, [textwrap.fill(name, 15) for name in names], fontsize=8)
    tails.set(title="Tails: seconds per generation", ylabel="s")
    for axes in (found, use, load, tails):
        axes.legend(fontsize=8)
    figure.savefig(file, dpi=110)
