"""Where a run can be repeated: what the page promises, and what it does not."""

from pathlib import Path

import pytest

from tests.ot.invented_record import written
from zswarm.config.sections import PartConfig, StopConfig
from zswarm.ot.notes import Note, RunEvent
from zswarm.ot.record.epochs import Epoch
from zswarm.ot.record.reader import Run
from zswarm.ot.report import report
from zswarm.ot.report.repeating import LAST_BITS, LIKE_IT, Repeats, repeats

AGAIN = "anyone who runs this experiment with the same code gets the same one, on "


def began(machine: str, cmaes: str = "0.13.1", generation: int = 0) -> Note:
    versions = {"zswarm": "0.1.0", "numpy": "2.4.6", "cmaes": cmaes, "code of it": "1234"}
    epoch = Epoch(
        generation=generation, version_hash="ab", versions=versions, machine=machine
    )
    return Note(RunEvent.BEGAN, text=epoch.text)


def page_of(run: Run) -> str:
    return " ".join(report.of_run(run, trials=0).split())


def test_a_portable_optimizer_gives_the_same_on_any_machines(tmp_path: Path) -> None:
    run = Run(written(tmp_path, [1, 2], notes=[began("one"), began("two")]))
    assert repeats(run) == Repeats([], "any machines", "", "numpy 2.4.6, cmaes 0.13.1")
    page = page_of(run)
    assert f"{AGAIN}any machines.</p>" in page
    assert "# again: the same history hash zswarm-ot" in page
    assert "file and the history hash: with these the run can be repeated bit" in page
    assert "bit by bit.</p>" in page
    assert '<th scope="row">packages</th><td>numpy 2.4.6, cmaes 0.13.1</td>' in page


@pytest.mark.parametrize("kind", ["cmaes", "cma-me", "map-elites", "not-here"])
def test_an_optimizer_that_is_not_portable_needs_its_machine(
    kind: str, tmp_path: Path
) -> None:
    optimizer = PartConfig(kind=kind, settings={})
    run = Run(written(tmp_path, [1, 2], optimizer=optimizer, notes=[began("one")]))
    found = repeats(run)
    assert (found.caveats, found.where) == ([], LIKE_IT)
    assert found.why.startswith(f"{kind} is not ")
    assert found.why.endswith(LAST_BITS)
    page = page_of(run)
    assert "any machines" not in page
    assert f"{AGAIN}{LIKE_IT}. {found.why}</p>" in page
    assert "# again: the same history hash on such a machine zswarm-ot" in page
    assert "the history hash and the machine and packages of the optimizer: with" in page
    assert "the run can be repeated bit by bit on such a machine.</p>" in page


@pytest.mark.parametrize(
    "second", [began("two", generation=1), began("one", "0.14.0", generation=1)]
)
def test_an_optimizer_that_changed_its_machine_promises_nothing(
    second: Note, tmp_path: Path
) -> None:
    optimizer = PartConfig(kind="cmaes", settings={})
    notes = [began("one"), second]
    run = Run(written(tmp_path, [1, 2], optimizer=optimizer, notes=notes))
    (caveat,) = repeats(run).caveats
    assert "ran on several machines or with several packages (one, with numpy" in caveat
    page = page_of(run)
    assert caveat in page
    assert AGAIN not in page
    assert "bit by bit" not in page
    assert "the same history hash" not in page


def test_own_parts_have_to_keep_the_rules(tmp_path: Path) -> None:
    run = Run(written(tmp_path, [1], simulator="own"))
    assert repeats(run).where == (
        "any machines, if simulator own keeps the rules for own parts"
    )


def test_a_run_that_time_limits_does_not_repeat(tmp_path: Path) -> None:
    page = page_of(Run(written(tmp_path, [1], stop=StopConfig(seconds=9.0))))
    assert "Time limits the run ([stop] seconds): when it is run again it may end" in page
    assert AGAIN not in page
    assert "bit by bit" not in page
