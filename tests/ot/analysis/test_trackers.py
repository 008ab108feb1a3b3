"""Runs as other tools read them: with TensorBoard's own format, MLflow and Weights & Biases."""

import struct
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.ot.invented_record import written
from zswarm.errors import ConfigError
from zswarm.ot.cli import command
from zswarm.ot.record import annotations
from zswarm.ot.record.annotations import Annotations

BLOCK, FULL, LAST = 1 << 15, 1, 4  # of a log of LevelDB


def study(folder: Path) -> Path:
    """Write two runs with two trials, the first with a tag and a note."""
    for seed in (1, 2):
        run = written(folder / "study", [1.0, 3.0], seed=seed, trials=2)
        if seed == 1:
            annotations.save(run, Annotations(tags=["paper"], note="a note"))
    return folder / "study"


def convert(runs: Path, target: str, out: Path) -> None:
    arguments = ["convert", str(runs), "--to", target, "--out", str(out)]
    command.main(arguments, standalone_mode=False)


def log_records(content: bytes) -> Iterator[bytes]:
    """Yield the records of a log of LevelDB with a header of 7 bytes, as wandb writes it."""
    at, whole = 7, b""
    while at < len(content):
        left = BLOCK - at % BLOCK
        if left < 7:
            at += left
            continue
        _, length, kind = struct.unpack_from("<IHB", content, at)
        whole += content[at + 7 : at + 7 + length]
        at += 7 + length
        if kind in (FULL, LAST):
            yield whole
            whole = b""


def test_tensorboard_reads_fitness_by_generation(tmp_path: Path) -> None:
    from tensorboardX.proto.event_pb2 import Event

    convert(study(tmp_path), "tensorboard", tmp_path / "out")
    (file,) = (tmp_path / "out" / "study" / "stadium").iterdir()
    content, at, found, texts = file.read_bytes(), 0, [], b""
    while at < len(content):  # length, its checksum, the event, its checksum
        (length,) = struct.unpack_from("<Q", content, at)
        event = Event.FromString(content[at + 12 : at + 12 + length])
        at += 12 + length + 4
        for value in event.summary.value:
            if value.tag == "best":
                found.append((event.step, value.simple_value))
            texts += b"".join(value.tensor.string_val)
    assert found == [(1, 0.5), (2, 1.5)]  # means of two trials
    assert b"paper" in texts
    assert b"a note" in texts
    with pytest.raises(ConfigError, match="exists already; choose another folder"):
        convert(tmp_path / "study", "tensorboard", tmp_path / "out")


def test_a_missing_package_is_named_and_nothing_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import importlib

    real = importlib.import_module

    def missing(name: str, package: str | None = None) -> Any:
        if name.startswith("mlflow"):
            raise ModuleNotFoundError(name=name)
        return real(name, package)

    monkeypatch.setattr(importlib, "import_module", missing)
    with pytest.raises(ConfigError, match=r"convert --to mlflow needs mlflow: .*install"):
        convert(study(tmp_path), "mlflow", tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.vmas
@pytest.mark.filterwarnings("default")
def test_mlflow_reads_what_was_written(tmp_path: Path) -> None:
    from mlflow.tracking import MlflowClient

    convert(study(tmp_path), "mlflow", tmp_path / "out")
    client = MlflowClient(tracking_uri=f"sqlite:///{tmp_path}/out/mlflow.db")
    experiment = client.get_experiment_by_name("study")
    runs = client.search_runs([experiment.experiment_id])
    assert {run.info.run_name for run in runs} == {"stadium", "stadium-2"}
    (run,) = (run for run in runs if run.info.run_name == "stadium")
    history = client.get_metric_history(run.info.run_id, "best")
    assert [(one.step, one.value) for one in history] == [(1, 0.5), (2, 1.5)]
    assert run.data.params["representation.hidden"] == "2"
    assert run.data.tags["tags"] == "paper"


@pytest.mark.vmas
@pytest.mark.filterwarnings("default")
def test_wandb_reads_what_was_written_offline(tmp_path: Path) -> None:
    from wandb.proto import wandb_internal_pb2

    # wandb's own process has written everything when the program ends.
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "zswarm.ot",
            "convert",
            str(study(tmp_path)),
            "--to",
            "wandb",
            "--out",
            str(tmp_path / "out"),
        ],
        capture_output=True,
        text=True,
        check=True,
    )
    assert "2 runs for wandb" in done.stdout
    files = sorted((tmp_path / "out" / "wandb").glob("offline-run-*/*.wandb"))
    assert len(files) == 2
    steps, names = [], set()
    for file in files:
        for content in log_records(file.read_bytes()):
            record = wandb_internal_pb2.Record.FromString(content)
            if record.HasField("run"):
                names.add((record.run.display_name, record.run.run_group))
            steps += [
                float(item.value_json)
                for item in record.history.item
                if "best" in (item.key, *item.nested_key)
            ]
    assert names == {("stadium", "study"), ("stadium-2", "study")}
    assert steps == [0.5, 1.5, 0.5, 1.5]
