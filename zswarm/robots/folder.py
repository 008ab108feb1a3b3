"""Exported files in a folder that may also hold others: other people's files are never replaced.

The file ``.zswarm-export`` lists what was exported, by hash: only files in it are replaced, and
only as long as they are unchanged.
"""

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import msgspec

from zswarm.errors import ConfigError
from zswarm.system.files import write_whole

LIST = ".zswarm-export"
EXECUTABLE, PLAIN = 0o777, 0o666


class ExportedFiles(
    msgspec.Struct,
    frozen=True,
    forbid_unknown_fields=True,
    tag="zswarm-export",
    tag_field="format",
):
    """That list, as JSON: the SHA-256 of each file by its path, 64 hex digits."""

    files: dict[str, str]
    version: Literal[1] = 1


def write(folder: Path, files: Mapping[str, str | bytes]) -> list[Path]:
    """Write files, each whole; write none if one would replace a file that was not exported.

    Args:
        folder: created if it is missing.
        files: contents by path; a file that begins with ``#!`` becomes executable.

    Returns:
        their paths.

    Raises:
        ConfigError: another file has such a path, or something cannot be written.
    """
    contents = {
        path: each.encode() if isinstance(each, str) else each
        for path, each in files.items()
    }
    hashes = {path: _hash(content) for path, content in contents.items()}
    at = folder
    try:
        known = _known(folder)
        for path, new in hashes.items():
            at = folder / path
            if not at.is_symlink() and not at.exists():
                continue
            if _hash(at.read_bytes()) not in (known.get(path), new):
                raise ConfigError(
                    f"{at}: exists and differs from the exported one; name another folder by "
                    "--out, or remove it"
                )
        for path, content in contents.items():
            at = folder / path
            at.parent.mkdir(parents=True, exist_ok=True)
            write_whole(at, content, EXECUTABLE if content.startswith(b"#!") else PLAIN)
        at = folder / LIST
        listed = ExportedFiles(dict(sorted((known | hashes).items())))
        write_whole(at, msgspec.json.format(msgspec.json.encode(listed)) + b"\n")
    except OSError as error:
        raise ConfigError(
            f"{error.filename or at}: cannot be written: {error.strerror}"
        ) from None
    return [folder / path for path in contents]


def _hash(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _known(folder: Path) -> dict[str, str]:
    """Return the hashes of what was exported to a folder."""
    at = folder / LIST
    try:
        return msgspec.json.decode(at.read_bytes(), type=ExportedFiles).files
    except FileNotFoundError:
        return {}
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        raise ConfigError(
            f"{at}: is not a list of exported files; name another folder by --out"
        ) from None
