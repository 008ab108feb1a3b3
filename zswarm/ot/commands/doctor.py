"""``zswarm-ot doctor``: examine this machine and its network, and explain how to fix faults."""

import sys
from pathlib import Path
from typing import Any

import click

from zswarm.ot.commands.shared import options, suggestions
from zswarm.ot.commands.shared.exits import EXIT_FAILED
from zswarm.ot.display import tables
from zswarm.system.text import clean

MENU = ("Begin", 6)
VERDICTS = {
    "broken": "something is broken",
    "warning": "it works; see the warnings",
    "ok": "everything is fine",
}


@click.command("doctor")
@options.search_options
@click.option(
    "--out",
    type=options.PATH,
    default=suggestions.RUNS,
    show_default=True,
    help="Folder in which runs will be made.",
)
@options.json_lines_option
def command(out: Path, as_json: bool, **search: Any) -> None:
    """Check whether this machine and its network are ready.

    Each line is ok, a warning (it works, but not as well as it could) or broken (runs fail; the
    exit code is 1). Whatever is not ok comes with a remedy. This takes a few seconds and changes
    nothing.

    \b
      zswarm-ot doctor
      zswarm-ot doctor --connect tcp/192.168.1.5:7467
    """
    from zswarm.ot.doctor.examination import examine

    states = set()
    for finding in examine(search["realm"], out, options.reach(**search, keys=False)):
        states.add(finding.state)
        text, remedy = clean(finding.text), clean(finding.fix)
        if as_json:
            tables.print_json({**finding._asdict(), "text": text, "fix": remedy})
        else:
            tables.fact(finding.state, finding.check, text, remedy)
    if not as_json:
        tables.line(
            next(verdict for state, verdict in VERDICTS.items() if state in states)
        )
    if "broken" in states:
        sys.exit(EXIT_FAILED)
