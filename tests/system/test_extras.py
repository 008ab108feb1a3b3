"""A package of an extra that is missing is named with the command that installs it."""

import importlib.util
import shlex
import sys
from importlib import metadata
from pathlib import Path

import pytest

from zswarm.errors import ConfigError
from zswarm.system.extras import how, need

PYTHON = shlex.quote(sys.executable)


def test_an_installed_package_is_imported() -> None:
    assert need("json.decoder", "plot", "plot").JSONDecoder


def test_a_missing_package_is_one_line_with_the_command_that_installs_it() -> None:
    with pytest.raises(ConfigError) as raised:
        need("zswarm_none.figure", "plot", "plot")
    assert (
        str(raised.value)
        == f"plot needs zswarm_none: {PYTHON} -m pip install jinja2 matplotlib scipy"
    )


def test_the_install_command_works_without_pip_and_without_zswarm_in_an_index(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It also works in an environment of uv, and if zswarm was not installed."""
    assert how("keys", "metrics").endswith(
        " -m pip install cryptography prometheus-client"
    )
    monkeypatch.setattr(importlib.util, "find_spec", lambda _name: None)
    assert how("keys") == f"uv pip install --python {PYTHON} cryptography"
    monkeypatch.setattr(metadata, "requires", lambda _name: None)
    assert how("keys").endswith(" 'zswarm[keys]'")


def test_a_package_with_a_missing_dependency_names_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Installing the extra would not help."""
    (tmp_path / "zswarm_half.py").write_text("import zswarm_none\n")
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    with pytest.raises(ModuleNotFoundError, match="zswarm_none"):
        need("zswarm_half", "plot", "plot")
