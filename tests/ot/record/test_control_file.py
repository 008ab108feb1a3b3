"""Requests to a run are one word in its folder."""

from pathlib import Path

import pytest

from zswarm.errors import ConfigError
from zswarm.ot.record import control_file as control


def test_a_control_file_holds_one_of_three_words(tmp_path: Path) -> None:
    """Other contents of the file are ignored, and an endless file is not read to its end."""
    assert control.asked(tmp_path) == ""
    control.ask(tmp_path, "drain")
    assert control.asked(tmp_path) == "drain"
    (tmp_path / "control").write_bytes(b"\xff" * 1_000_000)
    assert control.asked(tmp_path) == ""
    control.forget(tmp_path)
    control.forget(tmp_path)
    assert not control.StopRequest(tmp_path).is_set()
    control.ask(tmp_path, "stop")
    assert control.StopRequest(tmp_path).is_set()


def test_an_unwritable_folder_is_reported(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(ConfigError, match="cannot be written: Not a directory"):
        control.ask(tmp_path / "file", "stop")
