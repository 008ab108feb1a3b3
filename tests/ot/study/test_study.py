"""A study's folder: its content, its lock, and opening it again; tests/integration plays it."""

import json
import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner
from msgspec import structs

from tests.ot.invented_record import EXPERIMENT, written
from tests.smallest_experiment import SMALL, small
from zswarm import experiment
from zswarm.errors import ConfigError
from zswarm.experiment import load
from zswarm.ot.commands import status
from zswarm.ot.record.writer import Record
from zswarm.ot.study.study import Study, is_study, load_study, not_begun


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return small(tmp_path, "[study]\nrepeat = 2")


@pytest.fixture
def folder(file: Path) -> Path:
    with Study.create(load(file), "small.toml", file.parent / "runs") as study:
        return study.folder


def record(study: Path, name: str, **changes: object) -> None:
    """A run in a study's folder, not begun."""
    alone = experiment.variants(load_study(study), "x")[0].experiment
    Record.create(study, structs.replace(alone, **changes), "", name=name).close()


def refusal(folder: Path) -> str:
    with pytest.raises(ConfigError) as refused:
        Study.open(folder)
    assert "\n" not in str(refused.value)
    return str(refused.value)


def test_a_study_holds_the_whole_experiment_and_no_record(
    folder: Path, file: Path
) -> None:
    assert sorted(path.name for path in folder.iterdir()) == ["experiment.toml", "lock"]
    assert load(folder / "experiment.toml").study.repeat == 2
    assert load(folder / "experiment.toml") == experiment.complete(load(file), "x"), (
        "every default is written out"
    )
    assert is_study(folder)
    with Study.open(folder) as study:
        assert [one.name for one in study.left] == ["seed-7", "seed-8"]
        assert (study.ended, study.others) == ([], [])


def test_runs_that_did_not_begin_are_counted(folder: Path) -> None:
    assert not_begun(folder) == [
        f"2 of the 2 runs of {folder} did not begin: zswarm-ot resume {folder} evolves them"
    ]
    record(folder, "seed-7")
    assert "1 of the 2 runs" in not_begun(folder)[0]
    record(folder, "seed-8", seed=8)
    assert not_begun(folder) == []
    assert not_begun(folder / "seed-7") == []


def test_status_counts_the_runs_of_each_study(folder: Path) -> None:
    record(folder, "seed-7")
    counts = {"study": str(folder), "runs": 2, "begun": 1, "finished": 0}
    for given in (folder, folder.parent):
        said = CliRunner().invoke(status.command, [str(given), "--json"])
        assert json.loads(said.output)["studies"] == [counts]
    said = CliRunner().invoke(status.command, [str(folder)])
    assert "has 2 runs: 0 finished, 1 begun" in " ".join(said.output.split())
    (folder / "experiment.toml").write_text("[study]\nrepeat = 'often'")
    said = CliRunner().invoke(status.command, [str(folder), "--json"])
    found = json.loads(said.output)
    assert (len(found["runs"]), found["studies"]) == (1, []), "a damaged study hides none"


def test_a_second_study_of_a_name_gets_a_number(folder: Path, file: Path) -> None:
    with Study.create(load(file), "small.toml", folder.parent) as second:
        assert second.folder.name == "small-2"


def test_a_study_of_one_run_is_a_study_again(file: Path) -> None:
    with Study.create(
        load(file, ["study.repeat=1"]), "small.toml", file.parent / "runs"
    ) as study:
        folder = study.folder
    with Study.open(folder) as again:
        assert [one.name for one in again.planned] == ["seed-7"]


def test_a_study_in_use_is_refused(folder: Path) -> None:
    with Study.open(folder):
        assert (
            refusal(folder)
            == f"{folder}: this study is in use by another zswarm-ot process; stop that one first"
        )
    Study.open(folder).__exit__(None, None, None)


def test_an_unbuildable_study_is_refused_before_its_folder_is_created(file: Path) -> None:
    """The optimizer refuses it, not the type of the setting."""
    small(file.parent, "[study.grid]\n'optimizer.mutation' = [0.4, 0.9]")
    with pytest.raises(ConfigError, match=r"^small.toml: study: with mutation 0.9: .*"):
        Study.create(load(file), "small.toml", file.parent / "runs")
    assert not (file.parent / "runs").exists()


def test_a_folder_without_a_study_is_refused(tmp_path: Path, folder: Path) -> None:
    record(folder, "seed-7")
    for other in (tmp_path / "nowhere", tmp_path, folder / "seed-7"):
        assert not is_study(other)
        assert (
            refusal(other)
            == f"{other}: not a study; expected a folder with an experiment.toml that has a [study]"
        )


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[study", "not TOML"),
        ("[study]\nrepeat = 0", "study.repeat: expected int >= 1"),
        ("[study]\nx=1", "study"),
    ],
)
def test_a_damaged_file_is_refused(folder: Path, text: str, said: str) -> None:
    (folder / "experiment.toml").write_text(SMALL + text)
    assert said in refusal(folder)


def test_runs_that_are_no_longer_part_of_the_study_are_named(folder: Path) -> None:
    for seed in (7, 8):
        record(folder, f"seed-{seed}", seed=seed)
    record(folder, "by-hand", seed=99)
    (folder / "notes").mkdir()
    text = (folder / "experiment.toml").read_text()
    (folder / "experiment.toml").write_text(text.replace("repeat = 2", "repeat = 1"))
    with Study.open(folder) as study:
        assert [one.name for one in study.left] == ["seed-7"]
        assert study.others == ["by-hand", "seed-8"]


def test_a_changed_experiment_does_not_reuse_runs_of_the_old_one(
    folder: Path,
) -> None:
    record(folder, "seed-7")
    text = (folder / "experiment.toml").read_text()
    (folder / "experiment.toml").write_text(
        text.replace("population = 50", "population = 60")
    )
    with Study.open(folder) as study:
        first, second = (one.name for one in study.left)
    assert first != "seed-7"
    assert first.endswith("-seed-7")
    assert second == "seed-8"
    assert study.others == ["seed-7"]


def test_a_run_that_cannot_be_read_is_not_finished_and_keeps_its_name(
    folder: Path,
) -> None:
    record(folder, "seed-7")
    for damage in (b"", b"no database"):
        (folder / "seed-7" / "run.sqlite").write_bytes(damage)
        with Study.open(folder) as study:
            assert [one.name for one in study.left] == ["seed-7", "seed-8"]
    (folder / "seed-7" / "experiment.toml").write_text("[")
    with Study.open(folder) as study:
        assert [one.name for one in study.left] == ["seed-7", "seed-8"]


def test_runs_of_a_study_are_reported_at_one_length(tmp_path: Path) -> None:
    """A finished run that is longer than its study now asks for counts with what it was by then."""
    settings = {**EXPERIMENT.representation.settings, "hidden": 2}
    network = structs.replace(EXPERIMENT.representation, settings=settings)
    with Study.create(
        structs.replace(EXPERIMENT, representation=network, generations=3),
        "x",
        tmp_path / "runs",
    ) as study:
        folder = study.folder
    written(tmp_path, [1.0, 5.0, 9.0], candidates=4).rename(folder / "seed-1")
    with Study.open(folder) as study:
        (whole,) = (ended.result for ended in study.ended)
    text = (folder / "experiment.toml").read_text()
    (folder / "experiment.toml").write_text(
        text.replace("generations = 3", "generations = 2")
    )
    with Study.open(folder) as study:
        (part,) = (ended.result for ended in study.ended)
    assert whole is not None
    assert part is not None
    assert (
        whole.generations,
        whole.best,
        whole.evaluations,
        len(whole.history_hash),
    ) == (
        3,
        9.0,
        12,
        32,
    )
    assert (part.generations, part.best, part.evaluations, part.history_hash) == (
        2,
        5.0,
        8,
        "",
    )


def test_a_study_can_be_moved(folder: Path, tmp_path: Path) -> None:
    record(folder, "seed-7")
    shutil.move(folder, tmp_path / "elsewhere")
    with Study.open(tmp_path / "elsewhere") as study:
        assert [one.name for one in study.left] == ["seed-7", "seed-8"]
