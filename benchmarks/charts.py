"""Draw the charts of docs/benchmarks.md in colours of Okabe and Ito, with markers."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tables
from aims import Results
from tables import TASKS, Found

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS = (
    "#000000",
    "#0072B2",
    "#56B4E9",
    "#009E73",
    "#D55E00",
    "#E69F00",
    "#CC79A7",
    "#8C8C8C",
    "#5D3A9B",
)
MARKERS = "os^DvPX*<"
CHARTS = {  # name: script and alternative text
    "dispatch": (
        "dispatch",
        "Cost of a candidate that does nothing, and efficiency with 5 ms of sleep, by slots",
    ),
    "kernels": ("kernels", "Agent-steps per second and core of each variant"),
    "scaling": (
        "scaling",
        "Time of an optimization by servers, with sleeps and with real evaluations",
    ),
    **{
        f"methods-{task}": (
            "methods",
            f"Learning curves on {task}: the best fitness by evaluations, a picture for each "
            "method",
        )
        for task in TASKS
    },
}
ACROSS = 4  # small pictures in a row
ASIDE = ("zswarm (TCP)", "no dispatch")


def draw(results: Results, folder: Path) -> None:
    """Draw all charts for which there are results."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    plt.rcParams.update(
        {
            "font.size": 10,
            "axes.grid": True,
            "grid.alpha": 0.3,
            "axes.axisbelow": True,
            "lines.markersize": 6,
        }
    )
    drawn: dict[str, Callable[[Found, Any], None]] = {
        "dispatch": dispatch,
        "kernels": kernels,
        "scaling": scaling,
    }
    drawn |= {f"methods-{task}": partial(methods, task=task) for task in TASKS}
    for name, (script, _) in CHARTS.items():
        if script in results:
            figure = plt.figure(figsize=(11, 4.8), layout="constrained")
            drawn[name](results[script], figure)
            figure.savefig(
                folder / f"bench-{name}.png", dpi=110, metadata={"Software": None}
            )
            plt.close(figure)


def dispatch(found: Found, figure: Any) -> None:
    """Draw the cost of 400 candidates, one in a message where the peer does not choose."""
    noop, sleep = figure.subplots(1, 2)
    slots = sorted({row["slots"] for row in found["rows"] if "work" in row})
    named = [peer for peer in tables.peers(found) if peer not in ASIDE]
    for number, peer in enumerate(named):
        for axes, work, what in ((noop, "noop", "us"), (sleep, "sleep", "efficiency")):
            rows = {size: tables.main_way(found, peer, work, size, 400) for size in slots}
            points = [(size, row[what]) for size, row in rows.items() if row]
            if points:
                line(axes, points, number, peer)
    noop.set(
        title="A candidate that does nothing",
        ylabel="us per candidate",
        xscale="log",
        yscale="log",
    )
    sleep.set(
        title="Candidates that sleep 5 ms",
        ylabel="ideal time / time",
        xscale="log",
        ylim=(0, 1.02),
    )
    for axes in (noop, sleep):
        axes.set_xticks(slots, [str(size) for size in slots])
        axes.minorticks_off()
        axes.set_xlabel("slots (worker processes)")
    figure.legend(
        *noop.get_legend_handles_labels(), loc="outside lower center", ncols=5, fontsize=9
    )
    figure.suptitle("400 distinct candidates in a generation", fontsize=11)


def line(
    axes: "Axes", points: list[tuple[float, float]], number: int, label: str
) -> None:
    """Draw a line; ours, the first, is thick."""
    x, y = zip(*points, strict=True)
    width = 2.5 if number == 0 else 1.3
    axes.plot(
        x,
        y,
        color=COLOURS[number % 9],
        marker=MARKERS[number % 9],
        linewidth=width,
        label=label,
    )


def kernels(found: Found, figure: Any) -> None:
    """Draw the flagship kernel by number of agents, and emergency-exit by field."""
    rows = [row for row in found["rows"] if "agent_steps_per_s" in row]
    rate = {
        (row["kernel"], row["agents"], row["variant"]): row["agent_steps_per_s"]
        for row in rows
    }
    flagship = sorted(
        {(kernel, agents) for kernel, agents, _ in rate if kernel == tables.FLAGSHIP}
    )
    exits = list(
        dict.fromkeys(
            (kernel, agents)
            for kernel, agents, _ in rate
            if kernel.startswith("emergency-exit")
        )
    )
    shown = [key for key in rate if key[:2] in flagship + exits]
    variants = sorted(
        dict.fromkeys(key[2] for key in shown),
        key=lambda each: -max(rate[key] for key in shown if key[2] == each),
    )
    colours = dict(zip(variants, COLOURS, strict=False))
    words = (
        [f"{agents} agents" for _, agents in flagship],
        [kernel.removeprefix("emergency-exit ") for kernel, _ in exits],
    )
    parts = [(tables.FLAGSHIP, flagship, words[0]), ("emergency-exit", exits, words[1])]
    parts = [part for part in parts if part[1]]
    ratios = [len(groups) for _, groups, _ in parts]
    for axes, (title, groups, labels) in zip(
        figure.subplots(1, len(parts), sharey=True, squeeze=False, width_ratios=ratios)[
            0
        ],
        parts,
        strict=True,
    ):
        here = [
            variant
            for variant in variants
            if any((*group, variant) in rate for group in groups)
        ]
        width = 0.9 / len(here)
        for number, variant in enumerate(here):
            places = [
                place for place, group in enumerate(groups) if (*group, variant) in rate
            ]
            values = [rate[(*groups[place], variant)] for place in places]
            middles = [place + (number - len(here) / 2 + 0.5) * width for place in places]
            label = (
                "zswarm (numba)" if variant == "numba" else tables.named(variant, rows)
            )
            bars = axes.bar(
                middles, values, width * 0.95, label=label, color=colours[variant]
            )
            said = [
                f"{value / 1e3:,.0f}k" if value < 1e6 else f"{value / 1e6:.1f}M"
                for value in values
            ]
            axes.bar_label(bars, said, fontsize=6.5)
        axes.set(
            title=f"{title}, one core",
            yscale="log",
            ylim=(1e3, 3 * max(rate[key] for key in shown)),
        )
        axes.set_xticks(range(len(groups)), labels)
        axes.grid(visible=False, axis="x")
    figure.axes[0].set_ylabel("agent-steps per second")
    entries = {
        label: bars
        for axes in figure.axes
        for bars, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    figure.legend(
        entries.values(), entries.keys(), loc="outside lower center", ncols=5, fontsize=9
    )


def scaling(found: Found, figure: Any) -> None:
    """Draw seconds over servers, with the ideal."""
    sleep, real = figure.subplots(1, 2)
    cores = found["machine"]["cores"]
    for axes, work, title in (
        (sleep, "sleep", "Evaluations that sleep 20 ms"),
        (real, "real", f"Real ones, on {cores} cores"),
    ):
        points = [
            (row["servers"], row["s"]) for row in found["rows"] if row["work"] == work
        ]
        line(axes, points, 0, "measured")
        first = points[0][1]
        limit = max(x for x, _ in points) if work == "sleep" else cores
        ideal = [(x, first / min(x, limit)) for x, _ in points]
        axes.plot(
            *zip(*ideal, strict=True),
            color=COLOURS[4],
            linestyle="--",
            label="ideal: one server's time / servers"
            if work == "sleep"
            else f"ideal, with {cores} cores",
        )
        axes.set(
            title=title,
            xlabel="servers of one slot",
            ylabel="s for the optimization",
            xscale="log",
            yscale="log",
        )
        axes.set_xticks([x for x, _ in points], [str(x) for x, _ in points])
        axes.minorticks_off()
        ticks = [
            tick
            for tick in (0.2, 0.5, 1, 2, 5, 10, 20)
            if min(y for _, y in points) / 2 < tick < first * 2
        ]
        axes.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
        axes.legend(fontsize=9)


def methods(found: Found, figure: Any, task: str) -> None:
    """Draw a small chart per method: its median and quartiles, before the medians of the others."""
    rows = [row for row in found["rows"] if row["task"] == task]
    down = -(-len(rows) // ACROSS)
    figure.set_size_inches(11, 1.0 + 1.9 * down)
    panels = figure.subplots(
        down, ACROSS, sharex=True, sharey=True, squeeze=False
    ).flatten()
    for axes, row in zip(panels, rows, strict=False):
        for other in rows:
            axes.plot(
                other["evaluations"], other["median"], color="#C4C4C4", linewidth=0.8
            )
        axes.fill_between(
            row["evaluations"],
            row["q25"],
            row["q75"],
            color=COLOURS[1],
            alpha=0.3,
            linewidth=0,
        )
        axes.plot(row["evaluations"], row["median"], color=COLOURS[1], linewidth=2)
        axes.set_title(row["method"], fontsize=10)
    for axes in panels[len(rows) :]:
        axes.set_axis_off()
    panels[0].set(xscale="log", ylim=(min(row["median"][0] for row in rows), None))
    figure.supxlabel("evaluations", fontsize=10)
    figure.supylabel("best fitness so far", fontsize=10)
    figure.suptitle(
        f"{task}: median and quartiles of {found['seeds']} runs; grey: the medians of the others",
        fontsize=11,
    )
