"""The version, which programs know without asking for the metadata of packages."""

import tomllib
from importlib.metadata import version
from pathlib import Path

from zswarm.system.version import VERSION


def test_the_version_is_that_of_the_package() -> None:
    project = Path(__file__).parents[2] / "pyproject.toml"
    assert tomllib.loads(project.read_text())["project"]["version"] == VERSION
    assert version("zswarm") == VERSION
