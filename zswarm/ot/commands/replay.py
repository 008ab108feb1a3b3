"""``zswarm-ot replay``: a recorded trial, played again."""

from pathlib import Path

import click

from zswarm.errors import ConfigError
from zswarm.ot.commands import suggestions
from zswarm.ot.commands.options import json_option

ENDINGS = {".gif": "gif", ".html": "html", ".htm": "html", ".csv": "csv"}


@click.command()
@click.argument("path", type=click.Path(path_type=Path), metavar="RUN", shell_complete=suggestions.runs)
@click.option(
    "--generation", type=int, metavar="N", help="Of this generation, from 0: by default that in which the best was found."
)
@click.option("--candidate", type=int, metavar="N", help="This candidate of the generation, from 0: the best by default.")
@click.option("--trial", type=int, metavar="N", default=0, show_default=True, help="This one of its trials, from 0.")
@click.option("--to", type=click.Choice(["gif", "html", "csv"]), help="Write a file, and open no browser.")
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="The file: .gif, .html or .csv; the run's name with that ending by default.",
)
@json_option
def replay(
    path: Path,
    generation: int | None,
    candidate: int | None,
    trial: int,
    to: str | None,
    output: Path | None,
    as_json: bool,
) -> None:
    """Play a recorded trial again, and watch it in the browser.

    The trial is computed anew from the record, bit for bit as in the run. Without --to and -o a page with a player is opened in
    the browser; its file is private, and its name is printed.

    \b
      zswarm-ot replay runs/stadium
      zswarm-ot replay runs/stadium --generation 0 --trial 2
      zswarm-ot replay runs/stadium --to gif
      zswarm-ot replay runs/stadium -o champion.html
    """  # noqa: D301  click's mark for text that is not to be wrapped
    from zswarm.files import write_for_user
    from zswarm.ot import gif, reading, spreadsheet, terminal, trace
    from zswarm.ot import replay as pages
    from zswarm.protocol.codec import clean

    kind = to or (_kind(output) if output else None)
    output = output or Path(f"{path.resolve().name}.{kind}")
    run = reading.Run(path)
    found = trace.trace(run, generation, candidate, trial)
    about = found.about
    title = f"{run.name}, generation {about['generation']}, candidate {about['candidate']}, trial {about['trial']}"
    if found.note:
        terminal.line(f"{title}: not the recorded trial: {found.note}", stderr=True)
    if found.error:
        terminal.line(f"{title}: the trial failed: {found.error}", stderr=True)
    opened = False
    if kind == "csv":
        spreadsheet.save(str(output), *pages.table(found))
    elif kind == "gif":
        write_for_user(output, gif.gif(found, title))
    elif kind == "html":
        write_for_user(output, pages.page(found, title).encode())
    else:
        output, opened = pages.show(pages.page(found, title))
    if as_json:
        fitness = [None if value != value else value for value in found.fitness]
        terminal.print_json({"file": str(output), **about, "fitness": fitness, "note": found.note, "error": found.error})
        return
    told = "" if kind or opened else " (no browser was found: open this file in one)"
    terminal.line(f"{clean(str(output))}: {title}, fitness {', '.join(f'{f:.6g}' for f in found.fitness)}{told}")


def _kind(output: Path) -> str:
    try:
        return ENDINGS[output.suffix.lower()]
    except KeyError:
        raise ConfigError(f"{output}: expected a name that ends in .gif, .html or .csv") from None
