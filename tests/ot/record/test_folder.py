"""The lock of a run's folder, which may come from somebody else."""

from pathlib import Path

import pytest

from zswarm.errors import ConfigError
from zswarm.ot.record import folder


def test_a_lock_that_is_a_link_creates_no_file(tmp_path: Path) -> None:
    target = tmp_path / "elsewhere"
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "lock").symlink_to(target)
    with pytest.raises(ConfigError, match=r"cannot be written: .*symbolic links"):
        folder.lock_folder(tmp_path / "run")
    assert not folder.is_running(tmp_path / "run")
    assert not target.exists()
