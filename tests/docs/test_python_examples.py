"""The programs in examples/python do what they say."""

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest

from tests.repository import REPOSITORY

EXAMPLES = REPOSITORY / "examples" / "python"


def example(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(
        f"example_{name}", EXAMPLES / f"{name}.py"
    )
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_an_optimizer_of_another_library_evolves_on_the_servers(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """It is well above where it began."""
    history = example("cmaes_stadium").evolve(12, "local")
    assert history[-1] > history[0] + 50
    assert capsys.readouterr().out.count("generation") == 12


def test_a_run_is_shown_in_tensorboard(tmp_path: Path) -> None:
    """Its event file holds what the run recorded."""
    from tensorboardX.proto.event_pb2 import Event

    run = example("tensorboard_logger").evolve(4, str(tmp_path), "local")
    (file,) = (run.folder / "tensorboard").iterdir()
    events, body = [], file.read_bytes()
    while body:  # TFRecord: length, its check, the event, its check
        length = int.from_bytes(body[:8], "little")
        events.append(Event.FromString(body[12 : 12 + length]))
        body = body[16 + length :]
    best = {
        event.step: value.simple_value
        for event in events
        for value in event.summary.value
        if value.tag == "best"
    }
    assert best == {
        row["generation"]: pytest.approx(row["best"]) for row in run.history()
    }
    assert any(
        value.tag.startswith("events")
        for event in events
        for value in event.summary.value
    )
