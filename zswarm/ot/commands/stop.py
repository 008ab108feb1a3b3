"""``zswarm-ot stop``: stop a run or a study, wherever it was started."""

import time
from pathlib import Path

import click

from zswarm.errors import ConfigError, EvaluationError
from zswarm.ot.commands.shared import options, suggestions
from zswarm.system.text import clean

MENU = ("Evolve", 6)
LOOK_S, LONGEST_S = 0.1, 60.0


@click.command("stop")
@click.argument(
    "folder", type=options.PATH, metavar="RUN|STUDY", shell_complete=suggestions.runs
)
def command(folder: Path) -> None:
    """Stop a run or a study, and wait until it has ended.

    Nothing is lost, and "zswarm-ot resume" continues it. It may have been started with --detach,
    in another terminal, or on another machine that shares the folder.

    \b
      zswarm-ot stop runs/stadium
    """
    from zswarm.ot.record import control_file
    from zswarm.ot.record.folder import DATABASE, EXPERIMENT, is_running, no_run

    shown = clean(str(folder))
    if not folder.is_dir() or not any(
        (folder / name).exists() for name in (EXPERIMENT, DATABASE)
    ):
        raise ConfigError(f"{no_run(folder)} of a run or study")
    if not is_running(folder):
        raise ConfigError(f"{shown}: not running; zswarm-ot status shows what is")
    control_file.ask(folder, "stop")
    deadline = time.monotonic() + LONGEST_S
    while is_running(folder):
        if time.monotonic() > deadline:
            raise EvaluationError(
                f"{shown}: was asked to stop, and has not ended in {LONGEST_S:.0f} s"
            )
        time.sleep(LOOK_S)
    click.echo(f"stopped; nothing is lost. Resume with: zswarm-ot resume {shown}")
