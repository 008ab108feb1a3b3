"""``zswarm-ot compare``: groups of runs beside each other, and whether a difference may be chance."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from zswarm.ot.commands.options import json_option, one_stdout

if TYPE_CHECKING:
    from zswarm.ot.comparison import Comparison

TOLD = 6  # pairs at most that are told in words


@click.command()
@click.argument("paths", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="RUN|STUDY...")
@click.option(
    "--by",
    type=click.Choice(["generations", "evaluations"]),
    default="generations",
    show_default=True,
    help="Compare runs after equally many of these.",
)
@click.option("--csv", metavar="FILE", help="Write the table as CSV, too; - is stdout.")
@json_option
def compare(paths: tuple[Path, ...], by: str, csv: str | None, as_json: bool) -> None:
    """Compare runs: median and quartiles of each group, and whether a difference may be chance.

    Runs that differ in seed only are a group of repeats. Tests: Mann-Whitney U with Holm's correction, Kruskal-Wallis.
    """
    from zswarm.ot import comparison, grouping, reading, spreadsheet, terminal

    one_stdout(csv, as_json=as_json)
    left_out: list[str] = []
    found = comparison.compare(grouping.groups(reading.runs_below(paths, left_out)), by)  # type: ignore[arg-type]  # click checked it
    for note in left_out:
        terminal.line(note, stderr=True)
    if csv:
        spreadsheet.save(csv, comparison.Row._fields, found.rows)
    if as_json:
        terminal.print_json(
            {
                **found._asdict(),
                "rows": [row._asdict() for row in found.rows],
                "pairs": [pair._asdict() for pair in found.pairs],
            }
        )
    elif csv != "-":
        show(found)


def show(found: "Comparison") -> None:
    """For people."""
    from zswarm.ot import comparison, terminal

    table = terminal.table(
        "group", "runs", "median", "quartiles", "best", "worst", "evaluations/run", "time", padding=(0, 1, 0, 0)
    )
    for row in found.rows:
        quartiles = f"{_number(row.q25)} / {_number(row.q75)}"
        numbers = (_number(row.median), quartiles, _number(row.best), _number(row.worst))
        terminal.row(table, row.group, row.runs, *numbers, f"{row.evaluations:.0f}", _time(row.seconds))
    terminal.show(table)
    for note in found.notes:
        terminal.paragraph(note)
    unit = found.by if found.at != 1 else found.by.removesuffix("s")
    terminal.paragraph(
        f"Fitness is the best of each run after {found.at:.0f} {unit}; higher is better. Half of a group's runs are above the "
        "median, and half lie between the quartiles. Evaluations and time are the medians of its runs."
    )
    if len(found.rows) > 1:
        terminal.line("")
    if found.kruskal_p is not None:
        terminal.paragraph(
            f"Kruskal-Wallis over all groups: {comparison.p_value(found.kruskal_p)}; below {comparison.LEVEL} at least one "
            "group differs from the others."
        )
    if reconciling := comparison.reconciling(found):
        terminal.paragraph(reconciling)
    if found.pairs:
        _show_pairs(found)
    if found.untested:
        terminal.paragraph(f"No test: {found.untested}.")


def _show_pairs(found: "Comparison") -> None:
    from zswarm.ot import comparison, terminal

    table = terminal.table("first", "second", "U", "p", "p (Holm)", "A12")
    for pair in found.pairs:
        terminal.row(
            table, pair.first, pair.second, f"{pair.u:.6g}", _p(pair.p), _p(pair.p_holm), f"{pair.a12:.2f}"
        )  # fmt: skip
    terminal.show(table)
    terminal.paragraph(
        f"Mann-Whitney U ({', '.join(sorted({pair.method for pair in found.pairs}))}). p: how often chance alone gives so large "
        f"a difference where there is none; below {comparison.LEVEL} it counts as shown. Holm: corrected for the number of "
        "pairs; this one counts. A12: how often a run of the first is better than one of the second; 0.5: equally often."
    )
    terminal.line("")
    for pair in sorted(found.pairs, key=lambda pair: pair.p_holm)[:TOLD]:
        terminal.paragraph(comparison.in_words(pair))


def _number(value: float | None) -> str:
    return "failed" if value is None else f"{value:.4g}"


def _time(seconds: float) -> str:
    if seconds < 100:
        return f"{seconds:.1f} s"
    return f"{seconds / 60:.1f} min" if seconds < 6000 else f"{seconds / 3600:.1f} h"


def _p(p: float) -> str:
    return "< 0.001" if p < 0.001 else f"{p:.3f}"
