"""A package of an extra that is missing is named with the command that installs it."""

import importlib.util
import shlex
import sys
from importlib import metadata
from pathlib import Path

import pytest

from zswarm.errors import ConfigError
from zswarm.extras import how, need


def test_a_package_that_is_there_is_given() -> None:
    assert need("json.decoder", "plot", "plot").JSONDecoder


def test_a_missing_package_is_one_line_with_the_command_that_installs_it() -> None:
    with pytest.raises(ConfigError) as raised:
        need("zswarm_none.figure", "plot", "plot")
    assert str(raised.value) == f"plot needs zswarm_none: {shlex.quote(sys.executable)} -m pip install jinja2 matplotlib scipy"


def test_the_command_needs_neither_an_index_that_has_zswarm_nor_the_right_pip(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where there is no pip, as in an environment of uv's, and where zswarm was not installed."""
    assert how("keys", "metrics").endswith(" -m pip install cryptography prometheus-client")
    monkeypatch.setattr(importlib.util, "find_spec", lambda _name: None)
    assert how("keys") == f"uv pip install --python {shlex.quote(sys.executable)} cryptography"
    monkeypatch.setattr(metadata, "requires", lambda _name: None)
    assert how("keys").endswith(" 'zswarm[keys]'")


def test_a_package_that_lacks_something_itself_says_what(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Installing the extra would not help."""
    (tmp_path / "zswarm_half.py").write_text("import zswarm_none\n")
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    with pytest.raises(ModuleNotFoundError, match="zswarm_none"):
        need("zswarm_half", "plot", "plot")
