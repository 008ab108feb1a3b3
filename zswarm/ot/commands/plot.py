"""``zswarm-ot plot``: learning curves as a figure."""

from pathlib import Path

import click

from zswarm.ot.commands.options import json_option, one_stdout


@click.command()
@click.argument("paths", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="RUN|STUDY...")
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="The figure: .pdf, .svg or .png; by default the folder's name with .pdf, and comparison.pdf for several folders.",
)
@click.option("--csv", metavar="FILE", help="Write the numbers that the figure shows, too; - is stdout.")
@click.option(
    "--x",
    "axis",
    type=click.Choice(["generation", "evaluations", "time"]),
    default="generation",
    show_default=True,
    help="Along the horizontal axis.",
)
@click.option(
    "--size",
    type=click.Choice(["column", "page", "slides"]),
    default="column",
    show_default=True,
    help="column: 3.4 inches wide, letters of 8 points; page: 7 inches, 9 points; slides: 10 inches, 18 points.",
)
@click.option("--title", default="", help="Above the figure.")
@click.option("--lowest", type=float, metavar="VALUE", help="Lowest fitness on the vertical axis; all that there is by default.")
@json_option
def plot(
    paths: tuple[Path, ...],
    output: Path | None,
    csv: str | None,
    axis: str,
    size: str,
    title: str,
    lowest: float | None,
    as_json: bool,
) -> None:
    """Draw the learning curves of runs.

    One run: its best and mean fitness. Repeats: the median of their best, and of three or more a band from the lower to the
    upper quartile.
    Runs of different experiments or settings: a line and a band for each, and a test between them.
    """
    from zswarm.ot import curves, figures, grouping, reading, spreadsheet, terminal
    from zswarm.protocol.codec import clean

    one_stdout(csv, as_json=as_json)
    output = output or Path(f"{paths[0].resolve().name}.pdf" if len(paths) == 1 else "comparison.pdf")
    figures.format_of(output)
    left_out: list[str] = []
    groups = grouping.groups(reading.runs_below(paths, left_out))
    loaded, notes = curves.load(groups)
    for note in [*left_out, *notes, *curves.cut(loaded, axis)]:  # type: ignore[arg-type]  # click checked it
        terminal.line(note, stderr=True)
    if csv:
        spreadsheet.save(csv, *figures.table(loaded, axis))  # type: ignore[arg-type]  # click checked it
    figures.plain_style()
    figures.save(figures.of_series(loaded, axis, size, title, lowest), output)  # type: ignore[arg-type]  # likewise
    runs = {group: len(found) for group, found in loaded.items()}
    if as_json:
        terminal.print_json({"figure": str(output), "groups": [{"group": g, "runs": n} for g, n in runs.items()]})
        return
    drawn = f"{terminal.plural(sum(runs.values()), 'run')} in {terminal.plural(len(runs), 'group')}"
    terminal.line(f"{clean(str(output))}: {drawn}", stderr=csv == "-")
