"""Packages of the extras: imported when they are used, and named with the command that installs them when they are missing."""

import importlib
import importlib.util
import re
import shlex
import sys
from importlib import metadata
from types import ModuleType

from zswarm.errors import ConfigError


def need(module: str, extra: str, what: str) -> ModuleType:
    """Import a module of an extra.

    Args:
        module: its name, such as ``matplotlib.figure``.
        extra: which extra brings it, such as ``plot``.
        what: who needs it, for the user, such as ``plot``.

    Raises:
        ConfigError: it is not installed; the text says how to install it.
    """
    package = module.partition(".")[0]
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] != package:
            raise  # it is there, and lacks something of its own
        raise ConfigError(f"{what} needs {package}: {how(extra)}") from None


def how(*extras: str) -> str:
    """The command that installs the packages of extras where this program runs, wherever zswarm itself came from."""
    names = dict.fromkeys(name for extra in extras for name in packages(extra))
    return installing(*(names or [f"zswarm[{','.join(extras)}]"]))


def installing(*names: str) -> str:
    """The command that installs packages where this program runs."""
    python = shlex.quote(sys.executable)
    pip = f"{python} -m pip install" if importlib.util.find_spec("pip") else f"uv pip install --python {python}"
    return " ".join([pip, *map(shlex.quote, names)])


def packages(extra: str) -> list[str]:
    """Names of an extra's packages; none where zswarm runs from its sources and was never installed."""
    try:
        required = metadata.requires("zswarm") or []
    except metadata.PackageNotFoundError:
        return []
    found = (re.match(rf"([\w.-]+)[^;]*;\s*extra == ['\"]{re.escape(extra)}['\"]", line) for line in required)
    return sorted(match[1] for match in found if match)
