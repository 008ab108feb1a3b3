"""Manifests: small TOML files that say which programs of this machine are simulators (docs/foreign.md).

``NAME.toml`` makes a simulator of that name. What runs is decided here alone, by files that the machine's user or administrator
put there: nothing that comes over the wire names a command.
"""

import contextlib
import os
import re
from pathlib import Path
from typing import Annotated

import msgspec
import platformdirs
from msgspec import Meta

from zswarm import strict
from zswarm.errors import ConfigError

SYSTEM = Path("/etc/zswarm/simulators")
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,62}")


class Manifest(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What ``NAME.toml`` says; paths are relative to its folder."""

    command: Annotated[list[str], Meta(min_length=1)]  # and its arguments
    files: Annotated[list[str], Meta(min_length=1)]  # what decides the program's results: the version hash covers them
    description: str = ""  # one line, for zswarm-ot list


def find() -> dict[str, Path]:
    """The manifests of this machine by the names of their simulators; of two of a name the first."""
    found: dict[str, Path] = {}
    for folder in _folders():
        for path in sorted(folder.glob("*.toml")):
            if NAME.fullmatch(path.stem):
                found.setdefault(path.stem, path.absolute())
    return found


def read(path: Path) -> Manifest:
    """What a manifest says.

    Raises:
        ConfigError: it cannot be read, or something in it is unknown, missing or impossible.
    """
    manifest = strict.convert(strict.read(path), Manifest, str(path))
    for name in manifest.files:
        if not (path.parent / name).is_file():
            raise ConfigError(f"{path}: files: {path.parent / name} is not there, or no file")
    return manifest


def files(path: Path) -> list[Path]:
    """A manifest and the files that it names, for the version hash; where it cannot be used, it alone."""
    try:
        return [path, *(path.parent / name for name in read(path).files)]
    except ConfigError:
        return [path] if path.is_file() else []


def _folders() -> list[Path]:
    if told := os.environ.get("ZSWARM_SIMULATORS"):
        return [Path(folder) for folder in told.split(os.pathsep) if folder]
    folders = [SYSTEM]
    with contextlib.suppress(RuntimeError):  # nobody knows where this user is at home
        folders.insert(0, Path(platformdirs.user_config_dir("zswarm"), "simulators"))
    return folders
