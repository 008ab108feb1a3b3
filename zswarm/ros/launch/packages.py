"""ROS packages as folders: how to find one, and a copy for each slot.

Slots write candidates and logs into their copies; the user's package is not changed.
"""

import os
import re
import shutil
from pathlib import Path
from xml.etree import ElementTree

from zswarm.errors import ConfigError, EvaluationError

EVERYWHERE = ("/usr/share", "/opt/ros")  # where ROS is installed
LEFT_OUT = shutil.ignore_patterns(".git", "__pycache__")


def find(package: str, near: Path) -> Path:
    """Return the folder of a package: one near a manifest, or by the package's name."""
    if (near / package / "package.xml").is_file():
        return near / package
    search = os.environ.get("ROS_PACKAGE_PATH", "")
    if re.fullmatch(r"[A-Za-z][A-Za-z0-9_-]*", package):
        for path in [*filter(None, search.split(os.pathsep)), *EVERYWHERE]:
            for description in sorted(Path(path).glob("**/package.xml")):
                if name(description.parent) == package:
                    return description.parent
    raise ConfigError(
        f"package {package!r} is not found: neither a folder {near / package} with a package.xml, "
        f"nor a package of that name below ROS_PACKAGE_PATH ({search or 'not set'})"
    )


def name(folder: Path) -> str:
    """Return a package's name from its ``package.xml``; "" if that cannot be read."""
    try:
        found = ElementTree.parse(folder / "package.xml").getroot().findtext("name")  # noqa: S314
    except (ElementTree.ParseError, OSError):
        return ""
    return (found or "").strip()


def copy(package: Path, folder: Path) -> Path:
    """Copy a package below a folder, which then can be in ``ROS_PACKAGE_PATH``."""
    into = folder / package.resolve().name
    try:
        shutil.copytree(package, into, ignore=LEFT_OUT, ignore_dangling_symlinks=True)
    except (shutil.Error, OSError) as error:
        raise EvaluationError(f"{package} cannot be copied to {into}: {error}") from None
    return into


def write(file: Path, text: str) -> None:
    """Write a file of a package, and create its folders."""
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8")
    except OSError as error:
        raise EvaluationError(
            f"{file.name} cannot be written into the package: {error.strerror}"
        ) from None
