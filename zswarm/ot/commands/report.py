"""``zswarm-ot report``: a run or a study as one HTML file."""

from pathlib import Path

import click

from zswarm.errors import ConfigError
from zswarm.ot.commands.options import json_option

ENDINGS = (".html", ".htm")


@click.command()
@click.argument("path", type=click.Path(path_type=Path), metavar="RUN|STUDY")
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="The page; the folder's name with .html by default.",
)
@click.option(
    "--trials",
    type=click.IntRange(0, 1_000_000),
    default=100,
    show_default=True,
    help="Trials on unseen seeds that a run's champion plays; 0: none.",
)
@json_option
def report(path: Path, output: Path | None, trials: int, as_json: bool) -> None:
    """Write one HTML file about a run: curve, champion, settings, servers and events; about a study: curves and comparison.

    The file holds all that it shows: it can be mailed, printed and opened without a network.
    """
    from zswarm.ot import report as reports
    from zswarm.ot import terminal
    from zswarm.protocol.codec import clean

    output = output or Path(f"{path.resolve().name}.html")
    if output.suffix.lower() not in ENDINGS:
        raise ConfigError(f"{clean(str(output))}: expected a name that ends in {' or '.join(ENDINGS)}")
    reports.write(path, output, trials)
    if as_json:
        terminal.print_json({"report": str(output)})
    else:
        terminal.line(clean(str(output)))
