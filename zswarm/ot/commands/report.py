"""``zswarm-ot report``: write one HTML file about a run or a study."""

from pathlib import Path

import click

from zswarm.errors import ConfigError
from zswarm.ot.commands.shared import options
from zswarm.ot.display import tables
from zswarm.system.text import clean

MENU = ("Results", 6)
EXTENSIONS = (".html", ".htm")


@click.command("report")
@click.argument("path", type=options.PATH, metavar="RUN|STUDY")
@options.output_option("The page.  [default: the folder's name with .html]")
@click.option(
    "--trials",
    type=click.IntRange(0, 1_000_000),
    default=100,
    show_default=True,
    help="Trials on held-out seeds that the champion of a run plays; 0: none.",
)
@options.json_option
def command(path: Path, output: Path | None, trials: int, as_json: bool) -> None:
    """Write one HTML file about a run or a study.

    About a run: its curve, champion, settings, servers and events; about a study: curves, runs,
    the settings of each group, and a comparison, by held-out fitness if all runs have it. The file
    needs no other one: it can be mailed, printed and read without a network.
    """
    from zswarm.ot.report import report

    output = output or Path(f"{path.resolve().name}.html")
    if output.suffix.lower() not in EXTENSIONS:
        raise ConfigError(
            f"{clean(str(output))}: expected a name that ends in {' or '.join(EXTENSIONS)}"
        )
    report.write(path, output, trials)
    if as_json:
        tables.print_json({"report": str(output)})
    else:
        tables.line(clean(str(output)))
