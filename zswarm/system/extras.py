"""Import packages of extras when they are used; name the command that installs a missing one."""

import importlib
import importlib.util
import shlex
import sys
from types import ModuleType
from typing import TYPE_CHECKING

from zswarm.errors import ConfigError

if TYPE_CHECKING:  # this, and importlib's metadata, slow the start
    from packaging.requirements import Requirement


def need(module: str, extra: str, what: str) -> ModuleType:
    """Import a module of an extra.

    Args:
        module: name, such as ``matplotlib.figure``.
        extra: the extra that installs it, such as ``plot``.
        what: what needs it, for the user, such as ``plot``.

    Raises:
        ConfigError: not installed; the message says how to install it.
    """
    package = module.partition(".")[0]
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] != package:
            raise  # it is installed, and lacks a dependency
        raise ConfigError(f"{what} needs {package}: {how(extra)}") from None


def how(*extras: str) -> str:
    """Return the command that installs the packages of extras for this Python."""
    known = requirements()
    names = [each.name for extra in extras for each in known.get(extra, [])]
    return installing(*(dict.fromkeys(names) or [f"zswarm[{','.join(extras)}]"]))


def installing(*names: str) -> str:
    """Return the command that installs packages for this Python."""
    python = shlex.quote(sys.executable)
    pip = f"{python} -m pip install"
    if not importlib.util.find_spec("pip"):
        pip = f"uv pip install --python {python}"
    return " ".join([pip, *map(shlex.quote, names)])


def requirements() -> dict[str, list["Requirement"]]:
    """Return zswarm's requirements by extra, "" for those without one; none if not installed."""
    from importlib import metadata

    from packaging.requirements import Requirement

    try:
        lines = metadata.requires("zswarm") or []
        extras = metadata.metadata("zswarm").get_all("Provides-Extra") or []
    except metadata.PackageNotFoundError:
        return {}
    found = sorted(map(Requirement, lines), key=str)
    by_extra = {"": [each for each in found if _applies(each, "")]}
    for extra in extras:
        by_extra[extra] = [
            each for each in found if _applies(each, extra) and not _applies(each, "")
        ]
    return by_extra


def _applies(requirement: "Requirement", extra: str) -> bool:
    return requirement.marker is None or requirement.marker.evaluate({"extra": extra})
