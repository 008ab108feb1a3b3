"""``zswarm-ot replay``: play a recorded trial again."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from zswarm.errors import ConfigError
from zswarm.ot.commands.shared import options, suggestions
from zswarm.ot.display import tables
from zswarm.system.files import write_for_user
from zswarm.system.text import clean

if TYPE_CHECKING:
    from zswarm.ot.replay.trace import Trace

MENU = ("Results", 4)
FORMATS = {".gif": "gif", ".html": "html", ".htm": "html", ".csv": "csv"}


@click.command("replay")
@click.argument("path", type=options.PATH, metavar="RUN", shell_complete=suggestions.runs)
@options.generation_option(
    "--generation",
    help="Generation, from 1.  [default: the one in which the best was found]",
)
@options.candidate_option
@options.number_option(
    "--trial", default=0, show_default=True, help="Trial of the candidate, from 0."
)
@click.option(
    "--to",
    type=click.Choice(["gif", "html", "csv"]),
    help="Write a file, and open no browser.",
)
@options.output_option(
    "The file: .gif, .html or .csv.  [default: the run's name with that extension]"
)
@options.json_option
def command(
    path: Path, to: str | None, output: Path | None, as_json: bool, **chosen: Any
) -> None:
    """Play a recorded trial again, and watch it in the browser.

    The trial is computed from the record, bit for bit as in the run. Without --to and -o a page
    with a player, replay.html in the run's folder, is opened in the browser.

    \b
      zswarm-ot replay runs/stadium
      zswarm-ot replay runs/stadium --generation 1 --trial 2
      zswarm-ot replay runs/stadium --to gif
      zswarm-ot replay runs/stadium -o champion.html
    """
    from zswarm.ot.record.reader import Run
    from zswarm.ot.replay import trace

    kind = to or (_format(output) if output else None)
    output = output or Path(f"{path.resolve().name}.{kind}")
    run = Run(path)
    found = trace.trace(run, **chosen)
    about = found.about
    numbers = {**about, "generation": about["generation"] + 1}
    trial_of = (f"{key} {numbers[key]}" for key in ("generation", "candidate", "trial"))
    title = ", ".join([run.name, *trial_of])
    if found.note:
        tables.line(f"{title}: not the recorded trial: {found.note}", stderr=True)
    if found.error:
        tables.line(f"{title}: the trial failed: {found.error}", stderr=True)
    output, hint = _write(found, title, kind, output, run.folder)
    if as_json:
        fitness = [None if value != value else value for value in found.fitness]
        more = {"fitness": fitness, "note": found.note, "error": found.error}
        tables.print_json({"file": str(output), **about, **more})
        return
    fitness_text = ", ".join(f"{value:.6g}" for value in found.fitness)
    tables.line(f"{clean(str(output))}: {title}, fitness {fitness_text}{hint}")


def _write(
    found: "Trace", title: str, kind: str | None, output: Path, folder: Path
) -> tuple[Path, str]:
    """Write a file, or open the browser; return the file, and a hint."""
    from zswarm.ot.analysis import csv as spreadsheet
    from zswarm.ot.replay import gif, page

    match kind:
        case "csv":
            spreadsheet.save(str(output), *page.table(found))
        case "gif":
            write_for_user(output, gif.gif(found, title))
        case "html":
            write_for_user(output, page.page(found, title).encode())
        case _:
            output, opened = page.show(page.page(found, title), folder)
            return (
                output,
                "" if opened else " (no browser was found: open this file in one)",
            )
    return output, ""


def _format(output: Path) -> str:
    try:
        return FORMATS[output.suffix.lower()]
    except KeyError:
        raise ConfigError(
            f"{output}: expected a name that ends in .gif, .html or .csv"
        ) from None
