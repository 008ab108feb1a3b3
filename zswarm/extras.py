"""Packages of the extras: imported when they are used, and named with the command that installs them when they are missing."""

import importlib
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
        raise ConfigError(f"{what} needs {package}: pip install 'zswarm[{extra}]'") from None
