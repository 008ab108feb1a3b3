"""``zswarm-ot plot``: draw learning curves."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from zswarm.ot.commands.shared import options
from zswarm.ot.display import tables
from zswarm.system.format import plural
from zswarm.system.text import clean

if TYPE_CHECKING:
    from zswarm.ot.analysis.curves import Axis
    from zswarm.ot.analysis.drawing import Size

MENU = ("Results", 7)


@click.command("plot")
@options.paths_argument
@options.output_option(
    "The figure: .pdf, .svg or .png.  [default: the folder's name with .pdf; comparison.pdf for "
    "several]"
)
@options.csv_option
@click.option(
    "--x",
    "axis",
    type=click.Choice(["generation", "evaluations", "time"]),
    default="generation",
    show_default=True,
    help="Quantity on the horizontal axis.",
)
@click.option(
    "--size",
    type=click.Choice(["column", "page", "slides"]),
    default="column",
    show_default=True,
    help="column: 3.4 inches wide, 8 point text; page: 7 inches, 9 point; slides: 10 inches, "
    "18 point.",
)
@click.option("--title", default="", help="Title above the figure.")
@click.option(
    "--lowest",
    type=float,
    metavar="VALUE",
    help="Lowest fitness on the vertical axis.  [default: the lowest there is]",
)
@options.json_option
def command(
    paths: tuple[Path, ...],
    output: Path | None,
    csv: str | None,
    axis: "Axis",
    size: "Size",
    title: str,
    lowest: float | None,
    as_json: bool,
) -> None:
    """Draw the learning curves of runs.

    Of one run: its best and mean fitness. Of repeated runs: the median of their best and, for three
    or more, a band from the lower to the upper quartile. Of runs with different experiments or
    settings: a line and a band for each, and a test between them.
    """
    from zswarm.ot.analysis import csv as spreadsheet
    from zswarm.ot.analysis import curves, figures, grouping
    from zswarm.ot.record.run_index import runs_below

    options.check_stdout(csv, as_json=as_json)
    name = paths[0].resolve().name if len(paths) == 1 else "comparison"
    output = output or Path(f"{name}.pdf")
    figures.format_of(output)
    skipped: list[str] = []
    groups = grouping.groups(runs_below(paths, skipped))
    loaded, notes = curves.load(groups)
    for note in [*skipped, *notes, *curves.cut(loaded, axis)]:
        tables.line(note, stderr=True)
    if csv:
        spreadsheet.save(csv, *figures.table(loaded, axis))
    figures.plain_style()
    figures.save(figures.of_series(loaded, axis, size, title, lowest), output)
    runs = {group: len(found) for group, found in loaded.items()}
    if as_json:
        counts = [{"group": group, "runs": count} for group, count in runs.items()]
        tables.print_json({"figure": str(output), "groups": counts})
        return
    drawn = f"{plural(sum(runs.values()), 'run')} in {plural(len(runs), 'group')}"
    tables.line(f"{clean(str(output))}: {drawn}", stderr=csv == "-")
