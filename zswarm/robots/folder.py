"""Exported files in a folder, which may hold others, too: what somebody else wrote or changed is never replaced.

The file ``.zswarm-export`` lists what was written, by hash: only that is replaced, and only as long as it is unchanged.
"""

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import msgspec

from zswarm.errors import ConfigError
from zswarm.files import write_whole

LIST = ".zswarm-export"
EXECUTABLE, PLAIN = 0o777, 0o666


class Written(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag="zswarm-export", tag_field="format"):
    """That file, JSON: SHA-256 of each file by its path, 64 hex digits."""

    files: dict[str, str]
    version: Literal[1] = 1


def write(folder: Path, files: Mapping[str, str | bytes]) -> list[Path]:
    """Write files, each whole; none where one would replace what is not ours.

    Args:
        folder: made where it is missing.
        files: texts and bytes by their paths in it; what begins with ``#!`` may be run.

    Returns:
        their paths.

    Raises:
        ConfigError: there is such a file of somebody else, or something cannot be written.
    """
    contents = {path: text.encode() if isinstance(text, str) else text for path, text in files.items()}
    at = folder
    try:
        known = _known(folder)
        for path, content in contents.items():
            at = folder / path
            if (at.is_symlink() or at.exists()) and hashlib.sha256(at.read_bytes()).hexdigest() not in (
                known.get(path),
                hashlib.sha256(content).hexdigest(),
            ):
                raise ConfigError(f"{at}: is there, and not as it was exported; name another folder by --out, or remove it")
        for path, content in contents.items():
            at = folder / path
            at.parent.mkdir(parents=True, exist_ok=True)
            write_whole(at, content, EXECUTABLE if content.startswith(b"#!") else PLAIN)
        at = folder / LIST
        now = known | {path: hashlib.sha256(content).hexdigest() for path, content in contents.items()}
        write_whole(at, msgspec.json.format(msgspec.json.encode(Written(dict(sorted(now.items()))))) + b"\n")
    except OSError as error:
        raise ConfigError(f"{error.filename or at}: cannot be written: {error.strerror}") from None
    return [folder / path for path in contents]


def _known(folder: Path) -> dict[str, str]:
    """What was exported to a folder before."""
    at = folder / LIST
    try:
        return msgspec.json.decode(at.read_bytes(), type=Written).files
    except FileNotFoundError:
        return {}
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        raise ConfigError(f"{at}: is no list of exported files; name another folder by --out") from None
