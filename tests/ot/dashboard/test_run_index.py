"""Runs are named by ids, which never are paths."""

import re
import shutil
from pathlib import Path

from tests.ot.invented_record import written
from zswarm.ot.dashboard.run_index import RunIndex


def test_no_run_outside_the_folders_is_found(tmp_path: Path) -> None:
    """Neither by a path in place of an id, nor through a link."""
    inside, outside = tmp_path / "runs", written(tmp_path / "others", [1.0])
    written(inside, [1.0])
    (inside / "link").symlink_to(outside)
    index = RunIndex([inside])
    assert [row["id"] for row in index.rows()] == ["stadium"]
    for id_ in (
        "../others/stadium",
        str(outside),
        "link",
        "..",
        "stadium/../../others/stadium",
        "%2e%2e",
        "",
    ):
        assert index.folder(id_) is None


def test_ids_are_plain_for_every_folder_name(tmp_path: Path) -> None:
    folder = written(tmp_path, [1.0])
    shutil.move(folder, tmp_path / "<b>ü\u202e x")
    (row,) = RunIndex([tmp_path]).rows()
    assert re.fullmatch(r"[A-Za-z0-9._~-]+", row["id"])
    assert "\u202e" not in row["name"]
    assert RunIndex([tmp_path]).folder(row["id"]) == tmp_path / "<b>ü\u202e x"


def test_the_folder_may_be_created_later(tmp_path: Path) -> None:
    index = RunIndex([tmp_path / "runs"])
    assert index.rows() == []
    written(tmp_path / "runs", [1.0])
    assert [row["status"] for row in index.rows()] == ["finished"]
