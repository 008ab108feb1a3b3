"""The charts of docs/paper.md: the paper's figures 3 and 4, with what was measured."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
from charts import COLOURS, MARKERS

from paper import findings
from paper.equations import ratio
from paper.findings import Results, table_i
from paper.names import NODELAY, STOCK, ZENOH
from zswarm.ot.estimate.cost_model import TABLE_I, Constants, blob, external

AGENTS = (1, 2, 4, 8, 16)
STEPS = range(1, 101)
CHARTS = {  # name: alternative text
    "ratio": "Figure 3: time with the controller in the optimizer / time with an exported one, "
    "by steps, for 1 to 16 agents",
    "servers": "Figure 4: time of an optimization by the steps of a simulation and by servers",
    "crowded": "Time of an optimization by servers, with enough simulations for 16 of them, "
    "and its ideal",
}


def draw(results: Results, folder: Path) -> None:
    """Draw all charts."""
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
    for name, size, drawn in (
        ("ratio", (11, 4.6), figure_3),
        ("servers", (11, 4.6), figure_4),
        ("crowded", (7, 4.6), crowded),
    ):
        figure = plt.figure(figsize=size, layout="constrained")
        drawn(results, figure)
        figure.savefig(folder / f"paper-{name}.png", dpi=110, metadata={"Software": None})
        plt.close(figure)


def figure_3(results: Results, figure: Any) -> None:
    """Draw r with the paper's and this machine's constants, and against parameters by message."""
    here = findings.constants(results, STOCK)
    panels: Sequence[tuple[str, Constants, Any]] = (
        ("the paper's Table I", TABLE_I, external),
        ("measured here, broker", here, external),
        ("Table I, compared with\nparameters in a message", TABLE_I, blob),
    )
    for axes, (title, constants, against) in zip(
        figure.subplots(1, 3, sharey=True), panels, strict=True
    ):
        for number, agents in enumerate(AGENTS):
            plan = table_i(agents)
            r = [
                ratio(
                    msgspec.structs.replace(plan, steps=steps), constants, against=against
                )
                for steps in STEPS
            ]
            axes.plot(
                STEPS,
                r,
                color=COLOURS[number],
                marker=MARKERS[number],
                markevery=(9, 20),
                label=counted(agents),
            )
        axes.axhline(1, color="#000000", linestyle="--", linewidth=1)
        axes.set(title=title, xlabel="steps of a simulation", yscale="log")
    figure.axes[0].set_ylabel(
        "r = time with the controller in the\noptimizer / without it"
    )
    figure.legend(
        *figure.axes[0].get_legend_handles_labels(),
        loc="outside lower center",
        ncols=5,
        fontsize=9,
    )


def figure_4(results: Results, figure: Any) -> None:
    """Draw time over steps as the paper, a panel per design and a line per number of servers."""
    named = (STOCK, NODELAY, ZENOH["blob"])
    longest = max(row["s"] for row in findings.rows(results, part="scaling"))
    for axes, design in zip(figure.subplots(1, 3, sharey=True), named, strict=True):
        found = findings.rows(results, part="scaling", design=design)
        for number, servers in enumerate(sorted({row["servers"] for row in found})):
            points = sorted(
                (row["steps"], row["s"]) for row in found if row["servers"] == servers
            )
            label = f"{servers} server{'s' if servers > 1 else ''}"
            axes.plot(
                *zip(*points, strict=True),
                color=COLOURS[number],
                marker=MARKERS[number],
                label=label,
            )
        axes.set(title=design, xlabel="steps of a simulation", xlim=(0, None))
    figure.axes[0].set(ylabel="s for the optimization", ylim=(0, 1.05 * longest))
    figure.legend(
        *figure.axes[0].get_legend_handles_labels(),
        loc="outside lower center",
        ncols=5,
        fontsize=9,
    )


def crowded(results: Results, figure: Any) -> None:
    """Draw time over servers: where each design stops gaining."""
    axes = figure.subplots()
    found = findings.rows(results, part="crowded")
    named = (ZENOH["blob"], STOCK, NODELAY, ZENOH["turn"], ZENOH["agent"])
    for number, design in enumerate(named):
        points = sorted(
            (row["servers"], row["s"]) for row in found if row["design"] == design
        )
        width = 2.5 if number == 0 else 1.3
        axes.plot(
            *zip(*points, strict=True),
            color=COLOURS[number],
            marker=MARKERS[number],
            linewidth=width,
            label=design,
        )
    servers = sorted({row["servers"] for row in found})
    ideal = [findings.ideal_s(found[0], count) for count in servers]
    axes.plot(servers, ideal, color=COLOURS[7], linestyle="--", label="steps only")
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="servers of one slot",
        ylabel="s for the optimization",
    )
    axes.set_xticks(servers, [str(count) for count in servers])
    axes.minorticks_off()
    lowest, highest = min(ideal), max(row["s"] for row in found)
    ticks = [
        tick
        for tick in (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100)
        if lowest / 2 < tick < 2 * highest
    ]
    axes.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    figure.legend(loc="outside lower center", ncols=2, fontsize=9)


def counted(agents: int) -> str:
    """Return a number in words."""
    return f"{agents} agent{'s' if agents > 1 else ''}"
