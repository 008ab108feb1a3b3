"""``zswarm-ot plot``: draw learning curves."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from zswarm.errors import ConfigError
from zswarm.ot.commands.shared import options
from zswarm.ot.display import tables
from zswarm.system.format import plural
from zswarm.system.text import clean

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from zswarm.ot.analysis.boxes import Shape
    from zswarm.ot.analysis.curves import Axis
    from zswarm.ot.analysis.drawing import FigureStyle, Size
    from zswarm.ot.record.reader import Run

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
    type=click.Choice(["generation", "evaluations", "simulations", "time"]),
    help="Quantity on the horizontal axis.  [default: what the runs have a budget of, as for "
    "compare, else generation]",
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
@click.option(
    "--as",
    "shape",
    type=click.Choice(["curves", "box", "violin", "archive"]),
    default="curves",
    show_default=True,
    help="curves of learning; one number of each run as boxes or violins; the archive of a run "
    "of map-elites.",
)
@options.measure_option
@options.label_option
@click.option(
    "--style",
    default="",
    metavar="FILE",
    help="A style of matplotlib: a file with settings such as font.family, or a name.",
)
@click.option(
    "--note/--no-note",
    "noted",
    default=True,
    help="Write below what bands, boxes or violins are, and under curves the test's result.  "
    "[default: note]",
)
@options.json_option
def command(
    paths: tuple[Path, ...],
    output: Path | None,
    csv: str | None,
    axis: "Axis | None",
    size: "Size",
    title: str,
    lowest: float | None,
    shape: str,
    measure: str | None,
    labels: tuple[str, ...],
    style: str,
    noted: bool,
    as_json: bool,
) -> None:
    """Draw the learning curves of runs.

    Of one run: its best and mean fitness. Of repeated runs: the median of their best and, for three
    or more, a band from the lower to the upper quartile. Of runs with different experiments or
    settings: a line and a band for each, and a test between them.

    \b
      zswarm-ot plot runs/study --x evaluations
      zswarm-ot plot runs/study --as violin --measure held-out
      zswarm-ot plot runs/minisim-elites --as archive
    """
    from zswarm.ot.analysis import csv as spreadsheet
    from zswarm.ot.analysis import curves, figures, grouping, picture
    from zswarm.ot.analysis.drawing import SIZES
    from zswarm.ot.analysis.measure import SEARCH
    from zswarm.ot.record.runs import runs_below

    options.check_stdout(csv, as_json=as_json)
    name = paths[0].resolve().name if len(paths) == 1 else "comparison"
    output = output or Path(f"{name}.pdf")
    figures.format_of(output)
    skipped: list[str] = []
    found = runs_below(paths, skipped)
    groups = grouping.renamed(grouping.groups(found), labels)
    if shape != "curves" or measure not in (None, SEARCH):
        if csv:
            raise ConfigError(
                "--csv has the numbers of curves; of runs: zswarm-ot compare --csv"
            )
        look = SIZES[size]._replace(file=style)
        figures.plain_style()
        figure, drawn = _figure(groups, shape, measure, look, title, skipped, noted=noted)
    else:
        loaded, notes = curves.load(groups)
        axis = axis or picture.usual_axis(found)
        for note in [*skipped, *notes, *curves.cut(loaded, axis)]:
            tables.line(note, stderr=True)
        if csv:
            spreadsheet.save(csv, *figures.table(loaded, axis))
        figures.plain_style()
        figure = figures.of_series(loaded, axis, size, title, lowest, style, noted=noted)
        drawn = {group: len(runs) for group, runs in curves.started(loaded).items()}
    figures.save(figure, output)
    _report(output, drawn, found, as_json=as_json, stderr=csv == "-")


def _figure(
    groups: "dict[str, list[Run]]",
    shape: str,
    measure: str | None,
    style: "FigureStyle",
    title: str,
    skipped: list[str],
    *,
    noted: bool,
) -> "tuple[Figure, dict[str, int]]":
    """Draw one number of each run, or an archive, and print what to know of the runs.

    Return how many runs of each group are drawn, too.
    """
    from zswarm.ot.analysis import archive, boxes, compared

    if shape == "archive":
        runs = [run for members in groups.values() for run in members]
        figure = archive.draw(archive.of_runs(runs), style, title)
        return figure, {group: len(members) for group, members in groups.items()}
    values, height, notes = compared.numbers(groups, measure)
    for note in [*skipped, *notes]:
        tables.line(note, stderr=True)
    kind: Shape = "violin" if shape == "violin" else "box"
    drawn = {group: len(numbers) for group, numbers in values.items()}
    return boxes.draw(values, height, kind, style, title, noted=noted), drawn


def _report(
    output: Path,
    drawn: dict[str, int],
    found: "list[Run]",
    *,
    as_json: bool,
    stderr: bool,
) -> None:
    """Print what was drawn, and how many of the runs found have nothing to draw yet."""
    if as_json:
        counts = [{"group": group, "runs": count} for group, count in drawn.items()]
        tables.print_json({"figure": str(output), "groups": counts})
        return
    runs = f"{plural(sum(drawn.values()), 'run')} in {plural(len(drawn), 'group')}"
    if begun := sum(not run.generations() for run in found):
        runs += f"; not drawn: {plural(begun, 'run')} without a finished generation"
    tables.line(f"{clean(str(output))}: {runs}", stderr=stderr)
