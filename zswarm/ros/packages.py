"""ROS packages as folders: where one is, and a copy of it that a slot changes as it likes.

Slots side by side write candidates and logs each into a copy of its own; the user's package stays as it is.
"""

import os
import re
import shutil
from pathlib import Path
from xml.etree import ElementTree

from zswarm.errors import ConfigError, EvaluationError

EVERYWHERE = ("/usr/share", "/opt/ros")  # where ROS has its own, if nothing else is said
LEFT_OUT = shutil.ignore_patterns(".git", "__pycache__")


def find(package: str, beside: Path) -> Path:
    """The folder of a package.

    Args:
        package: a folder beside a manifest, or the name of a package.
        beside: the manifest's folder.

    Raises:
        ConfigError: there is none.
    """
    if (beside / package / "package.xml").is_file():
        return beside / package
    told = os.environ.get("ROS_PACKAGE_PATH", "")
    if re.fullmatch(r"[A-Za-z][A-Za-z0-9_-]*", package):
        for path in [*filter(None, told.split(os.pathsep)), *EVERYWHERE]:
            for description in sorted(Path(path).glob("**/package.xml")):
                if name(description.parent) == package:
                    return description.parent
    raise ConfigError(
        f"package {package!r} is not found: neither a folder {beside / package} with a package.xml in it, nor a package of that "
        f"name below ROS_PACKAGE_PATH ({told or 'not set'})"
    )


def name(folder: Path) -> str:
    """What a package calls itself in its ``package.xml``; nothing where that cannot be read."""
    try:
        found = ElementTree.parse(folder / "package.xml").getroot().findtext("name")  # noqa: S314
    except (ElementTree.ParseError, OSError):
        return ""
    return (found or "").strip()


def copy(package: Path, folder: Path) -> Path:
    """A copy of a package below a folder, which then is one for ``ROS_PACKAGE_PATH``.

    Raises:
        EvaluationError: it cannot be written.
    """
    into = folder / package.resolve().name
    try:
        shutil.copytree(package, into, ignore=LEFT_OUT, ignore_dangling_symlinks=True)
    except (shutil.Error, OSError) as error:
        raise EvaluationError(f"{package} cannot be copied to {into}: {error}") from None
    return into


def write(file: Path, text: str) -> None:
    """A file of a package, with the folders it is in.

    Raises:
        EvaluationError: it cannot be written.
    """
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8")
    except OSError as error:
        raise EvaluationError(f"{file.name} cannot be written into the package: {error.strerror}") from None
