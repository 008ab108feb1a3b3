"""What cannot be stopped is named."""

from pathlib import Path

import pytest

from tests.ot.invented_record import written
from zswarm.errors import ConfigError
from zswarm.ot.cli import command


def test_a_run_that_does_not_exist_is_not_called_stopped(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    for name in ("missing", "empty"):
        with pytest.raises(ConfigError, match="no run; expected a folder of a run or"):
            command.main(["stop", str(tmp_path / name)], standalone_mode=False)
    run = written(tmp_path, [1.0])
    with pytest.raises(ConfigError, match="not running"):
        command.main(["stop", str(run)], standalone_mode=False)
