"""What the distributions of plug-ins consist of: packages that pip installed."""

import ast
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
        source: the distribution that it came with; what this installed elsewhere counts, too. An
            editable installation lists no files: modules beside the package count if it imports
            them, in the order of a wheel, and data files do not.
    """
    found = list(_folder_files(package))
    if source is not None:
        site = Path(str(source.locate_file("")))
        found += sorted(_imported_beside(package, found, site))
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


def _imported_beside(package: str, own: list[Path], installed_in: Path) -> Iterator[Path]:
    """Yield the files of modules beside a package that it imports, directly or not.

    Not where all distributions are installed: there, each lists its files.
    """
    spec = importlib.util.find_spec(package)
    if spec is None or not spec.origin:
        return
    module = Path(spec.origin)
    folder = module.parent.parent if spec.submodule_search_locations else module.parent
    if folder.resolve() == installed_in.resolve():
        return
    waiting, seen = [file for file in own if file.suffix == ".py"], {package}
    while waiting:
        for name in _imports(waiting.pop()) - seen:
            seen.add(name)
            here = (folder / f"{name}.py", folder / name / "__init__.py")
            if any(file.is_file() for file in here):
                files = list(_folder_files(name))
                waiting += [file for file in files if file.suffix == ".py"]
                yield from files


def _imports(file: Path) -> set[str]:
    """Return the top-level modules that a file of Python imports; none if it is damaged."""
    try:
        tree = ast.parse(file.read_bytes())
    except (SyntaxError, ValueError):
        return set()
    found = set[str]()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            found.add(node.module.partition(".")[0])
    return found


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
