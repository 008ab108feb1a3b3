"""A package of an extra that is missing is named with the command that installs it."""

import sys
from pathlib import Path

import pytest

from zswarm.errors import ConfigError
from zswarm.extras import need


def test_a_package_that_is_there_is_given() -> None:
    assert need("json.decoder", "plot", "plot").JSONDecoder


def test_a_missing_package_is_one_line_with_the_command_that_installs_it() -> None:
    with pytest.raises(ConfigError) as raised:
        need("zswarm_none.figure", "plot", "plot")
    assert str(raised.value) == "plot needs zswarm_none: pip install 'zswarm[plot]'"


def test_a_package_that_lacks_something_itself_says_what(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Installing the extra would not help."""
    (tmp_path / "zswarm_half.py").write_text("import zswarm_none\n")
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    with pytest.raises(ModuleNotFoundError, match="zswarm_none"):
        need("zswarm_half", "plot", "plot")
