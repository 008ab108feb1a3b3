"""``zswarm-ot convert``: write runs for TensorBoard, Weights & Biases or MLflow."""

from pathlib import Path

import click

from zswarm.ot.commands.shared import options
from zswarm.ot.display import tables
from zswarm.system.format import plural
from zswarm.system.text import clean

MENU = ("Results", 11)
NAMES = ("tensorboard", "wandb", "mlflow")
# What shows the files, after the folder's name is filled in.
NEXT = {
    "tensorboard": "tensorboard --logdir {}",
    "wandb": "wandb sync {}/wandb/offline-run-*",
    "mlflow": "mlflow ui --backend-store-uri sqlite:///{}/mlflow.db",
}


@click.command("convert")
@options.paths_argument
@click.option(
    "--to", "target", type=click.Choice(NAMES), required=True, help="For which."
)
@click.option(
    "--out",
    type=options.PATH,
    metavar="FOLDER",
    help="A new folder to write to.  [default: the name of the tool]",
)
@options.json_option
def command(
    paths: tuple[Path, ...], target: str, out: Path | None, as_json: bool
) -> None:
    """Write runs for TensorBoard, Weights & Biases or MLflow.

    Writes fitness, the optimizer's numbers, all settings, tags and notes into a new folder.
    Nothing is sent anywhere.

    \b
      zswarm-ot convert runs/study --to tensorboard
      zswarm-ot convert runs/stadium --to wandb --out offline
      zswarm-ot convert runs --to mlflow
    """
    from zswarm.ot.analysis import trackers
    from zswarm.ot.record.runs import runs_below

    runs, folder = runs_below(paths), out or Path(target)
    trackers.convert(runs, target, folder)
    if as_json:
        found = [run.shown for run in runs]
        tables.print_json({"to": target, "folder": str(folder), "runs": found})
        return
    shown = clean(str(folder))
    tables.line(f"{shown}: {plural(len(runs), 'run')} for {target}")
    tables.line(f"next    {NEXT[target].format(shown)}")
