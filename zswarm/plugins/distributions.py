"""What the distributions of plug-ins consist of: packages that pip installed."""

import importlib.util
from collections.abc import Iterable, Iterator
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from importlib.metadata import Distribution

SCRIPTS = ("console_scripts", "gui_scripts")
# How and where it was installed, which differs between machines; Python's own bytecode.
METADATA = (".dist-info", ".egg-info")
DERIVED = (".pyc", ".pth")
COMPILED = (*EXTENSION_SUFFIXES, ".so", ".dylib", ".pyd")


def plugin_files(package: str, source: "Distribution | None") -> list[Path]:
    """Return all files that may decide what a plug-in computes: code, libraries, maps, weights.

    Args:
        package: the top-level package or module; every file in its folders counts.
        source: the distribution that it came with; what this installed elsewhere counts, too.
    """
    found = list(_folder_files(package))
    if source is not None:
        known = {file.resolve() for file in found}
        installed = sorted(_installed(source))
        found += [file for file in installed if file.resolve() not in known]
    return found


def compiled_files(name: str) -> list[Path]:
    """Return a distribution's compiled modules."""
    from importlib.metadata import PackageNotFoundError, distribution

    try:
        installed = _installed(distribution(name))
    except PackageNotFoundError:
        return []
    return sorted(file for file in installed if file.name.endswith(COMPILED))


def regular(files: Iterable[Path]) -> list[Path]:
    """Return the regular files, sorted: an editor's lock file is a link to nothing."""
    return sorted(file for file in files if file.is_file())


def _folder_files(package: str) -> Iterator[Path]:
    spec = importlib.util.find_spec(package)
    if spec is None:
        return
    if spec.submodule_search_locations:
        for folder in spec.submodule_search_locations:
            every = Path(folder).rglob("*")
            yield from regular(file for file in every if not _derived(file))
    elif spec.origin:
        yield Path(spec.origin)


def _installed(source: "Distribution") -> Iterator[Path]:
    scripts = {point.name for point in source.entry_points if point.group in SCRIPTS}
    for name in source.files or ():
        # Wrappers name the interpreter; an editable install is a module that names a folder.
        wrapper = name.name in scripts or name.name.startswith("__editable__")
        if wrapper or name.parts[0].endswith(METADATA) or _derived(Path(name)):
            continue
        file = Path(str(source.locate_file(name)))
        if file.is_file():
            yield file


def _derived(file: Path) -> bool:
    return "__pycache__" in file.parts or file.suffix in DERIVED
