"""Tags and a note that people give a run: a file in its folder, next to the record."""

from pathlib import Path
from typing import Any

import msgspec
import tomli_w

from zswarm.config.decode import convert, read
from zswarm.errors import ConfigError
from zswarm.ot.record.database import describe
from zswarm.system.files import write_whole
from zswarm.system.text import clean

FILE = "notes.toml"
LARGEST = 1 << 16  # bytes of the file
TAGS, TAG = 50, 40  # tags of a run, and characters of one
PIECE = 20  # characters of a line that are made safe at a time


class Annotations(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Tags, and a note of any number of lines."""

    tags: list[str] = []
    note: str = ""


def load(folder: Path) -> Annotations:
    """Return the annotations of a run, safe to show; empty ones without a file.

    Raises:
        ConfigError: the file cannot be used.
    """
    path = folder / FILE
    try:
        size = path.stat().st_size
    except OSError:
        return Annotations()
    if size > LARGEST:
        raise ConfigError(f"{path}: {size:,} bytes; expected {LARGEST:,} at most")
    return checked(convert(read(path), Annotations, str(path)), str(path))


def save(folder: Path, annotations: Annotations) -> None:
    """Replace the annotations of a run.

    Raises:
        ConfigError: a tag is impossible, or the folder cannot be written.
    """
    found = checked(annotations, str(folder))
    text = tomli_w.dumps(msgspec.to_builtins(found), multiline_strings=True)
    if len(text.encode()) > LARGEST:
        raise ConfigError(f"{folder}: note: expected {LARGEST:,} bytes at most")
    try:
        write_whole(folder / FILE, text.encode())
    except OSError as error:
        raise ConfigError(
            f"{folder}: cannot be written: {describe(error, folder)}"
        ) from None


def shown(folder: Path) -> dict[str, Any]:
    """Return tags and note; the note of a file that cannot be used says why."""
    try:
        return msgspec.structs.asdict(load(folder))
    except ConfigError as error:
        return {"tags": [], "note": clean(str(error))}


def checked(given: Annotations, where: str) -> Annotations:
    """Return annotations with distinct tags, sorted, and a note that is safe to show.

    Raises:
        ConfigError: a tag is impossible, or there are too many.
    """
    tags = sorted({tag.strip() for tag in given.tags})
    for tag in tags:
        if not tag or tag != clean(tag) or "," in tag or len(tag) > TAG:
            raise ConfigError(
                f"{where}: tag {clean(tag)!r}: expected 1 to {TAG} printable characters "
                "without a comma"
            )
    if len(tags) > TAGS:
        raise ConfigError(f"{where}: {len(tags)} tags; expected {TAGS} at most")
    lines = [_clean(line.expandtabs(4)) for line in given.note.strip().splitlines()]
    return Annotations(tags=tags, note="\n".join(lines))


def _clean(line: str) -> str:
    """Return a line of any length safe to show; ``clean`` shortens long ones."""
    return "".join(clean(line[at : at + PIECE]) for at in range(0, len(line), PIECE))
