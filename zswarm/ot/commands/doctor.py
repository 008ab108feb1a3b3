"""``zswarm-ot doctor``: what this machine and its network are fit for, and how faults are mended."""

import os
import sys
from pathlib import Path

import click

from zswarm.ot.commands.options import check_looking, json_lines_option, looking_options
from zswarm.ot.exits import EXIT_FAILED


@click.command()
@looking_options
@click.option(
    "--out", type=click.Path(path_type=Path), default=Path("runs"), show_default=True, help="Where runs are to be made."
)
@json_lines_option
def doctor(realm: str, connect: tuple[str, ...], multicast: bool, through_router: bool, out: Path, as_json: bool) -> None:
    """Look whether machine and network are fit.

    Each line is ok, a warning (it works, but not as well as it could) or broken (runs fail): then the exit code is 1. What
    is not ok comes with what to do. Takes some seconds; nothing is changed.

    \b
      zswarm-ot doctor
      zswarm-ot doctor --connect tcp/192.168.1.5:7467
    """  # noqa: D301  click's mark for text that is not to be wrapped
    os.environ["ZSWARM_PLAIN"] = "1"  # nothing is evaluated
    from zswarm.ot import terminal
    from zswarm.ot.doctor.examination import examine
    from zswarm.protocol.codec import clean
    from zswarm.session import Reach

    check_looking(realm, connect)
    states = set()
    for finding in examine(realm, out, Reach(connect, multicast, through_router)):
        states.add(finding.state)
        text, mend = clean(finding.text), clean(finding.mend)
        if as_json:
            terminal.print_json({**finding._asdict(), "text": text, "mend": mend})
        else:
            terminal.fact(finding.state, finding.check, text, mend)
    if not as_json:
        told = {"broken": "something is broken", "warning": "it works; see the warnings", "ok": "everything is fine"}
        terminal.line(next(words for state, words in told.items() if state in states))
    if "broken" in states:
        sys.exit(EXIT_FAILED)
