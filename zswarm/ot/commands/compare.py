"""``zswarm-ot compare``: compare groups of runs, and test whether a difference may be chance."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from zswarm.ot.commands.shared import options
from zswarm.ot.display import tables
from zswarm.system.format import duration

if TYPE_CHECKING:
    from zswarm.ot.analysis.comparison import Comparison

MENU = ("Results", 8)
PAIRS = 6  # pairs that are described in words


@click.command("compare")
@options.paths_argument
@click.option(
    "--by",
    type=click.Choice(["generations", "evaluations"]),
    default="generations",
    show_default=True,
    help="Compare runs after an equal number of these.",
)
@options.csv_option
@options.json_option
def command(paths: tuple[Path, ...], by: str, csv: str | None, as_json: bool) -> None:
    """Compare runs: median and quartiles of each group, and whether a difference may be chance.

    Runs that differ only in their seed form a group. The tests are Mann-Whitney U with Holm's
    correction, and Kruskal-Wallis.
    """
    from zswarm.ot.analysis import comparison, curves, grouping
    from zswarm.ot.analysis import csv as spreadsheet
    from zswarm.ot.record.run_index import runs_below

    options.check_stdout(csv, as_json=as_json)
    skipped: list[str] = []
    groups = grouping.groups(runs_below(paths, skipped))
    loaded, notes = curves.load(groups)
    found = comparison.of_series(loaded, by, notes)  # type: ignore[arg-type]  # click checked it
    for note in skipped:
        tables.line(note, stderr=True)
    if csv:
        spreadsheet.save(csv, comparison.Row._fields, found.rows)
    if as_json:
        rows, pairs = (
            [one._asdict() for one in some] for some in (found.rows, found.pairs)
        )
        tables.print_json({**found._asdict(), "rows": rows, "pairs": pairs})
    elif csv != "-":
        show(found)


def show(found: "Comparison") -> None:
    """Print a comparison for people."""
    from zswarm.ot.analysis import comparison

    numbers = (
        ">runs",
        ">median",
        ">quartiles",
        ">best",
        ">worst",
        ">held-out",
        ">evaluations/run",
        ">time",
    )
    table = tables.table("group", *numbers, padding=(0, 1, 0, 0))
    for row in found.rows:
        quartiles = f"{_number(row.q25)} / {_number(row.q75)}"
        values = (_number(row.median), quartiles, _number(row.best), _number(row.worst))
        held_out = "" if row.held_out is None else _number(row.held_out)
        costs = (f"{row.evaluations:.0f}", duration(row.seconds))
        tables.row(table, row.group, row.runs, *values, held_out, *costs)
    tables.show(table)
    for note in found.notes:
        tables.paragraph(note)
    unit = found.by if found.at != 1 else found.by.removesuffix("s")
    tables.paragraph(
        f"Fitness is the best of each run in search after {found.at:.0f} {unit}; higher is better. "
        "Half of a group's runs are above the median, and half lie between the quartiles. Held-out "
        "is what the champions of finished runs do on seeds that search did not use; it, "
        "evaluations and time are the medians of its runs."
    )
    if len(found.rows) > 1:
        tables.line("")
    if found.kruskal_p is not None:
        tables.paragraph(
            f"Kruskal-Wallis over all groups: {comparison.p_value(found.kruskal_p)}; below "
            f"{comparison.LEVEL} at least one group differs from the others."
        )
    if note := comparison.disagreement(found):
        tables.paragraph(note)
    if found.pairs:
        _show_pairs(found)
    if found.untested:
        tables.paragraph(f"No test: {found.untested}.")


def _show_pairs(found: "Comparison") -> None:
    from zswarm.ot.analysis import comparison

    table = tables.table("first", "second", ">U", ">p", ">p (Holm)", ">A12")
    for pair in found.pairs:
        numbers = (f"{pair.u:.6g}", _p(pair.p), _p(pair.p_holm), f"{pair.a12:.2f}")
        tables.row(table, pair.first, pair.second, *numbers)
    tables.show(table)
    methods = ", ".join(sorted({pair.method for pair in found.pairs}))
    tables.paragraph(
        f"Mann-Whitney U ({methods}). p: how often chance alone gives so large a difference where "
        f"there is none; below {comparison.LEVEL} it is significant. Holm: corrected for the "
        "number of pairs; this one decides. A12: how often a run of the first group is better "
        "than one of the second; 0.5: equally often."
    )
    tables.line("")
    for pair in sorted(found.pairs, key=lambda pair: pair.p_holm)[:PAIRS]:
        tables.paragraph(comparison.describe(pair))


def _number(value: float | None) -> str:
    return "failed" if value is None else f"{value:.4g}"


def _p(p: float) -> str:
    return "< 0.001" if p < 0.001 else f"{p:.3f}"
