"""``zswarm-ot doctor``: what this machine and its network are fit for, and how faults are mended."""

import os
import sys
from pathlib import Path

import click

from zswarm.errors import ConfigError
from zswarm.ot.commands.options import json_lines_option
from zswarm.ot.exits import EXIT_FAILED


@click.command()
@click.option("--realm", default="default", show_default=True, help="Realm to look in for servers.")
@click.option("--connect", multiple=True, metavar="EP", help="Server or router to dial; may be repeated.")
@click.option("--multicast/--no-multicast", default=True, help="Find servers by multicast.  [default: multicast]")
@click.option("--through-router", is_flag=True, help="Look through a router: one named by --connect, or found by multicast.")
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
    from zswarm import endpoint
    from zswarm.ot import terminal
    from zswarm.ot.doctor.examination import examine
    from zswarm.protocol import keys
    from zswarm.protocol.codec import clean
    from zswarm.session import Reach

    if not keys.is_id(realm):
        raise ConfigError(f"--realm: expected {keys.ID_RULE}, not {realm!r}")
    endpoint.check(connect, "--connect")
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
