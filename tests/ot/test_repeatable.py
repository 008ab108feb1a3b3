"""A simulator whose trials do not repeat: said wherever a run's results are shown."""

from pathlib import Path

import pytest
from click.testing import CliRunner

import zswarm
from zswarm.ot.analysis.caveats import caveats
from zswarm.ot.cli import command
from zswarm.ot.display.progress import summary
from zswarm.ot.record.results import finished_result
from zswarm.ot.report import report
from zswarm.sims.xor import XOR

DO_NOT = "Trials of xor do not repeat (repeatable = False)"


def shown(*arguments: str) -> str:
    done = CliRunner().invoke(command, arguments, catch_exceptions=False)
    assert done.exit_code == 0
    return " ".join(done.stdout.split())


@pytest.mark.parametrize("repeatable", [True, False])
def test_what_a_run_promises_is_said_at_every_place(
    repeatable: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(XOR, "repeatable", repeatable)
    small = zswarm.load("xor", {"generations": 2, "optimizer.population": 10})
    with (
        zswarm.connect(local_slots=1) as connection,
        zswarm.start(small, connection=connection, out=tmp_path) as evolution,
    ):
        ended = evolution.finish()
    run = zswarm.read(evolution.folder)
    again = finished_result(run.folder, run.experiment)
    assert again is not None
    report.write(run.folder, page := tmp_path / "page.html", 0)
    html = page.read_text()
    assert run.history_hash is not None
    for text, promise in (
        (shown("check", "xor"), "the same on all machines, bit for bit"),
        (shown("describe", "xor"), "repeatable yes: the same genomes and seed give"),
        (summary(again), f"history {run.history_hash}"),
        (html, "with the same code gets the same one, on any machines"),
    ):
        assert (promise in text) == repeatable
    for text, warning in (
        (shown("check", "xor"), "trials of xor do not repeat"),
        (
            shown("describe", "xor"),
            "repeatable no: trials do not repeat, and servers are",
        ),
        (summary(again), f"history trials do not repeat, {run.history_hash}"),
        (html, DO_NOT),
        ("".join(caveats(run)), DO_NOT),
    ):
        assert (warning in text) != repeatable
    assert again.repeatable == repeatable
    assert ended is not None
