"""Write recorded runs in the formats of TensorBoard, Weights & Biases and MLflow.

Nothing is sent anywhere: each writes files below a folder. Fitness is the mean of a trial.
"""

import itertools
import json
import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from zswarm import experiment
from zswarm.errors import ConfigError
from zswarm.ot.analysis.grouping import flat
from zswarm.ot.record import annotations
from zswarm.ot.record.annotations import Annotations
from zswarm.ot.record.reader import Run
from zswarm.system.extras import need

NOT_NUMBERS = ("generation", "finished_at")  # columns of a history that are no metrics
BATCH, PARAMETERS = 1000, 100  # that MLflow takes at a time
LONGEST = 500  # characters of a parameter


class GenerationNumbers(NamedTuple):
    """The numbers of a generation, which counts from 1."""

    generation: int
    at: float  # Unix time of its end
    numbers: dict[str, float]


class ConvertedRun(NamedTuple):
    """A run as trackers know runs."""

    name: str
    group: str  # the folder that the run is in: its study
    settings: dict[str, Any]
    steps: list[GenerationNumbers]
    annotations: Annotations
    toml: str
    history_hash: str


def converted(run: Run) -> ConvertedRun:
    """Return the numbers and settings of a run.

    Raises:
        ConfigError: its record or its notes are damaged.
    """
    complete = run.experiment
    trials = run.fitness_trials
    steps = []
    for row in run.table():
        numbers = {
            name: float(value)
            for name, value in row.items()
            if name not in NOT_NUMBERS
            and isinstance(value, int | float)
            and math.isfinite(value)
        }
        for name in {"best", "mean"} & numbers.keys():
            numbers[name] /= trials
        steps.append(
            GenerationNumbers(row["generation"] + 1, row["finished_at"], numbers)
        )
    if steps and run.held_out is not None and run.held_out.mean is not None:
        steps[-1].numbers["held_out"] = run.held_out.mean / trials
    return ConvertedRun(
        run.name,
        run.folder.resolve().parent.name,
        flat(complete) | {"seed": complete.seed, "generations": complete.generations},
        steps,
        annotations.load(run.folder),
        experiment.to_toml(complete),
        run.history_hash or "",
    )


def convert(runs: Sequence[Run], target: str, out: Path) -> None:
    """Write runs into a new folder, one after the other.

    Args:
        target: a key of ``TARGETS``.

    Raises:
        ConfigError: the tracker's package is missing, the folder exists, or a run is damaged.
    """
    begin = TARGETS[target]
    module, extra = MODULES[target]
    need(module, extra, f"convert --to {target}")
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise ConfigError(f"{out}: exists already; choose another folder with --out")
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"{out}: cannot be made: {error.strerror}") from None
    write = begin(out)
    for run in runs:
        write(converted(run))


Writer = Callable[[ConvertedRun], None]


def _tensorboard(out: Path) -> Writer:
    from tensorboardX import SummaryWriter

    def write(run: ConvertedRun) -> None:
        folder = out / run.group / run.name
        with SummaryWriter(logdir=str(folder), write_to_disk=True) as writer:
            writer.add_text("experiment", f"```toml\n{run.toml}```", 0)
            writer.add_text("tags and note", _words(run.annotations), 0)
            for step in run.steps:
                for name, value in step.numbers.items():
                    writer.add_scalar(name, value, step.generation, walltime=step.at)

    return write


def _wandb(out: Path) -> Writer:
    import wandb

    quiet = wandb.Settings(
        mode="offline", console="off", silent=True, disable_git=True, save_code=False
    )

    def write(run: ConvertedRun) -> None:
        made = wandb.init(
            project="zswarm",
            name=run.name,
            group=run.group,
            tags=run.annotations.tags,
            notes=run.annotations.note,
            config={**run.settings, "history_hash": run.history_hash},
            dir=str(out),
            settings=quiet,
            reinit="finish_previous",
        )
        for step in run.steps:
            made.log({**step.numbers, "finished_at": step.at}, step=step.generation)
        made.finish()

    return write


def _mlflow(out: Path) -> Writer:
    from mlflow.entities import Metric, Param
    from mlflow.tracking import MlflowClient

    database = (out / "mlflow.db").resolve()
    client = MlflowClient(tracking_uri=f"sqlite:///{database}")
    known: dict[str, str] = {}  # experiments

    def write(run: ConvertedRun) -> None:
        if run.group not in known:
            known[run.group] = client.create_experiment(run.group)
        times = [int(step.at * 1000) for step in run.steps] or [0]
        tags = {
            "tags": ", ".join(run.annotations.tags),
            "mlflow.note.content": run.annotations.note,
            "history_hash": run.history_hash,
        }
        made = client.create_run(
            known[run.group], start_time=times[0], run_name=run.name, tags=tags
        )
        params = [Param(name, _text(value)) for name, value in run.settings.items()]
        metrics = [
            Metric(name, value, time, step.generation)
            for step, time in zip(run.steps, times, strict=False)
            for name, value in step.numbers.items()
        ]
        for part in _parts(params, PARAMETERS):
            client.log_batch(made.info.run_id, params=part)
        for part in _parts(metrics, BATCH):
            client.log_batch(made.info.run_id, metrics=part)
        client.set_terminated(made.info.run_id, "FINISHED", end_time=times[-1])

    return write


TARGETS: dict[str, Callable[[Path], Writer]] = {
    "tensorboard": _tensorboard,
    "wandb": _wandb,
    "mlflow": _mlflow,
}
# Of each: the module that it needs, and the extra that installs it.
MODULES = {
    "tensorboard": ("tensorboardX", "tensorboard"),
    "wandb": ("wandb", "wandb"),
    "mlflow": ("mlflow.tracking", "mlflow"),
}


def _words(given: Annotations) -> str:
    return "\n\n".join(filter(None, [", ".join(given.tags), given.note])) or "none"


def _text(value: Any) -> str:
    return (value if isinstance(value, str) else json.dumps(value))[:LONGEST]


def _parts(items: Sequence[Any], size: int) -> Iterator[list[Any]]:
    rest = iter(items)
    while part := list(itertools.islice(rest, size)):
        yield part
