"""Compare published controllers of e-pucks here and in ARGoS, and write docs/epuck.md's table.

ARGoS' numbers, and the controllers, are read from a folder next to the checkout. Rows that were
played are kept, so an interrupted run resumes.

    python benchmarks/argos.py --seeds 100
"""

import argparse
import csv
import json
import math
import os
import statistics
import sys
from collections.abc import Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from zswarm.evaluate import build, evaluate
from zswarm.nets.chocolate import encoded
from zswarm.robots.argos import genome, machine

HERE = Path(__file__).parent
SHARED = Path(os.environ.get("SHARED", HERE.parents[1] / "shared"))
GOLDEN = SHARED / "golden" / "epuck"
RESULTS = HERE / "argos.json"
DOCS = HERE.parent / "docs"
BEGIN, END = "<!-- argos: made by benchmarks/argos.py -->\n", "<!-- end of argos -->"
MISSIONS = {"gridexploration": "grid-exploration"}
WITHIN = 0.1  # of ARGoS' mean
BIAS, OUTPUTS = 15, [16, 17]


class Row(NamedTuple):
    """A controller on a mission with a model of noise, and ARGoS' results."""

    mission: str
    model: str
    controller: str
    method: str
    runs: int
    mean: float
    deviation: float

    @property
    def name(self) -> str:
        """Return the row's key in the results."""
        return f"{self.mission} {self.model} {self.controller}"

    @property
    def minimised(self) -> bool:
        """Return whether ARGoS' score is the smaller the better."""
        return self.mission == "chocolate_spc"


class Result(NamedTuple):
    """A row, and the results here."""

    row: Row
    seeds: int
    mean: float
    deviation: float

    @property
    def error(self) -> float:
        """Return the difference as a share of ARGoS' mean."""
        return abs(self.mean - self.row.mean) / max(abs(self.row.mean), 1e-9)

    @property
    def z(self) -> float:
        """Return the difference in its standard errors; deviations are those of both together."""
        row = self.row
        freedom = row.runs - 1 + self.seeds - 1
        squares = (self.seeds - 1) * self.deviation**2
        if row.runs > 1:
            squares += (row.runs - 1) * row.deviation**2
        width = math.sqrt(squares / freedom * (1 / row.runs + 1 / self.seeds))
        return (self.mean - row.mean) / max(width, 1e-12)

    @property
    def holds(self) -> bool:
        """Return whether the mean is within 10 % of ARGoS', or within its 95 % interval."""
        if self.error <= WITHIN:
            return True
        if self.row.runs == 1:  # ARGoS' deviation is not known
            return abs(self.z) <= 1.98
        half = T_95[self.row.runs - 1] * self.row.deviation / math.sqrt(self.row.runs)
        return abs(self.mean - self.row.mean) <= half


# Student's t, two-sided 95 %, by degrees of freedom.
T_95 = {
    1: 12.706, 2: 4.303, 3: 3.182, 4: 2.776, 5: 2.571, 6: 2.447, 7: 2.365, 8: 2.306,
    9: 2.262, 10: 2.228, 11: 2.201, 12: 2.179,
}  # fmt: skip


def rows() -> list[Row]:
    """Return the rows of ARGoS' summary."""
    with (GOLDEN / "summary.csv").open() as file:
        return [
            Row(
                *(each["mission"], each["model"], each["controller"], each["method"]),
                runs=int(each["n"]),
                mean=float(each["mean"]),
                deviation=float(each["sd"] or "nan"),
            )
            for each in csv.DictReader(file)
        ]


def controllers() -> dict[str, tuple[str, dict[str, Any], bytes]]:
    """Return the reference model, the representation and the genome of each controller."""
    found = {}
    for each in json.loads((GOLDEN / "controllers.json").read_text()):
        genes = [genome.Gene(*link, enabled=True) for link in each["links"]]
        inputs = [*range(1, BIAS)]
        network = genome.Network(inputs, BIAS, OUTPUTS, each["hidden"], genes)
        found[each["id"]] = ("1.2", *genome.build(network))
    for each in json.loads((GOLDEN / "fsms.json").read_text()):
        states = encoded(machine.read(each["fsm"]))
        found[each["id"]] = ("1.2-machine", {"kind": "chocolate"}, states)
    return found


def play(row: Row, seeds: int) -> Result:
    """Play a row's controller."""
    model, representation, one = controllers()[row.controller]
    mission = row.mission.removeprefix("chocolate_")
    settings = {
        "mission": MISSIONS.get(mission, mission),
        "reality": row.model,
        "reference_model": model,
    }
    if row.minimised:  # as ARGoS, larger is better here
        row = row._replace(mean=-row.mean)
    kind = {key: value for key, value in representation.items() if key != "kind"}
    simulator, network = build("epuck", settings, representation["kind"], kind)
    outcomes = evaluate(
        simulator,
        network,
        [one],
        np.zeros((seeds, 1), np.int64),
        np.arange(1, seeds + 1, dtype=np.uint64),
    )
    fitness = outcomes.fitness[:, 0]
    return Result(row, seeds, float(fitness.mean()), float(fitness.std(ddof=1)))


def kendall(results: Iterable[Result]) -> float:
    """Return Kendall's tau-b of the means here and in ARGoS."""
    pairs = [(one.mean, one.row.mean) for one in results]
    agree = ties_here = ties_there = count = 0
    for at, (here, there) in enumerate(pairs):
        for other_here, other_there in pairs[at + 1 :]:
            sign = np.sign(here - other_here) * np.sign(there - other_there)
            agree += int(sign)
            count += 1
            ties_here += here == other_here
            ties_there += there == other_there
    ordered = (count - ties_here) * (count - ties_there)
    return agree / math.sqrt(ordered) if ordered else math.nan


def flags(row: Row) -> tuple[bool, int, str]:
    """Return a key that sorts rows so that an interrupted comparison has some of each kind."""
    return row.method == "random", int(row.controller.rsplit("_", 1)[1]), row.name


def table(results: list[Result]) -> str:
    """Return what holds, mission by mission, as Markdown."""
    lines = [
        "| mission | noise | controllers | means hold | median difference | Kendall's tau |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for (mission, model), group in grouped(results).items():
        holding = sum(result.holds for result in group)
        median = 100 * statistics.median(result.error for result in group)
        tau = f"{kendall(group):.2f}" if len(group) > 2 else ""
        lines.append(
            f"| {mission} | {model} | {len(group)} | {holding} | {median:.1f} % | {tau} |"
        )
    return "\n".join(lines) + "\n"


def grouped(results: Iterable[Result]) -> dict[tuple[str, str], list[Result]]:
    """Return results by mission and model of noise."""
    groups: dict[tuple[str, str], list[Result]] = {}
    for result in results:
        groups.setdefault((result.row.mission, result.row.model), []).append(result)
    return groups


def draw(results: list[Result], path: Path) -> None:
    """Draw the means here against ARGoS', with 95 % intervals."""
    import matplotlib as mpl

    mpl.use("agg")
    from matplotlib import pyplot as plt

    shown = {
        mission: [result for result in results if result.row.mission == mission]
        for mission in ("aggregation", "foraging", "gridexploration")
    }
    figure, axes = plt.subplots(1, len(shown), figsize=(11, 3.7))
    for axis, (mission, group) in zip(axes, shown.items(), strict=True):
        for model, colour in (("design", "#0072b2"), ("pseudo", "#d55e00")):
            some = [result for result in group if result.row.model == model]
            runs = [max(result.row.runs, 2) for result in some]
            there = [
                T_95[n - 1] * result.deviation / math.sqrt(n)
                for n, result in zip(runs, some, strict=True)
            ]
            here = [1.96 * result.deviation / math.sqrt(result.seeds) for result in some]
            means = [result.row.mean for result in some], [result.mean for result in some]
            axis.errorbar(
                *means, here, there, ".", color=colour, linewidth=0.8, label=model
            )
        ends = [axis.get_xlim()[0], axis.get_xlim()[1]]
        axis.plot(ends, ends, color="#999999", linewidth=0.8, zorder=0)
        axis.set(title=MISSIONS.get(mission, mission), xlabel="ARGoS", ylabel="zswarm")
        axis.locator_params(nbins=4)
        axis.legend(fontsize=8)
    figure.tight_layout()
    figure.savefig(path, dpi=80)


def played(seeds: int, processes: int) -> Iterator[Result]:
    """Yield the results of all rows, and keep each as it comes."""
    kept = json.loads(RESULTS.read_text()) if RESULTS.is_file() else {}
    waiting = [row for row in rows() if kept.get(row.name, [0])[0] != seeds]
    waiting.sort(key=flags)
    with ProcessPoolExecutor(processes) as pool:
        for at, result in enumerate(pool.map(play, waiting, [seeds] * len(waiting))):
            numbers = [seeds, result.mean, result.deviation]
            kept[result.row.name] = numbers
            lines = (
                f"{json.dumps(key)}: {json.dumps(kept[key])}" for key in sorted(kept)
            )
            RESULTS.write_text("{\n" + ",\n".join(lines) + "\n}\n")
            sys.stderr.write(f"{at + 1} of {len(waiting)}: {result.row.name}\n")
    yield from known()


def known() -> Iterator[Result]:
    """Yield the results that are kept."""
    kept = json.loads(RESULTS.read_text())
    for row in rows():
        if row.name in kept:
            shown = row._replace(mean=-row.mean) if row.minimised else row
            yield Result(shown, *kept[row.name])


def main() -> None:
    """Play, and print what holds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--known", action="store_true", help="play nothing")
    parser.add_argument("--docs", action="store_true", help="write docs/epuck.md's part")
    options = parser.parse_args()
    found = [*(known() if options.known else played(options.seeds, options.processes))]
    sys.stdout.write(table(found))
    for result in sorted(found, key=lambda one: -abs(one.z)):
        if not result.holds or abs(result.z) > 2.5:
            sys.stdout.write(
                f"{result.row.name:50} here {result.mean:.6g}, ARGoS {result.row.mean:.6g} "
                f"(n = {result.row.runs}), z = {result.z:.1f}, holds: {result.holds}\n"
            )
    if options.docs:
        draw(found, DOCS / "pictures" / "epuck-argos.png")
        page = DOCS / "epuck.md"
        before, rest = page.read_text().split(BEGIN)
        _, after = rest.split(END)
        page.write_text(before + BEGIN + "\n" + table(found) + END + after)


if __name__ == "__main__":
    main()
