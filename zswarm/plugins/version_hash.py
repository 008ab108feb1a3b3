"""The version hash: two machines compute the same results only with the same code.

It covers Python's minor version, the shared files, the simulator, the representation, the versions
of the distributions that these came with, and of the libraries that compile them; if a library
itself plays trials (``LIBRARIES`` of a module), also its version, the processor's architecture,
and pymunk's compiled module. Servers with another hash than the optimizer's are reported and not
used.

The cache hash names the folder of compiled kernels; those that call no function of a plug-in have
one that plug-ins do not change. It covers all code that may be compiled, and
the processor, since machines with different processors may share a home folder: numba distinguishes
them in one folder, but two that compile at the same time choose the same file name, and then one
runs the other's machine code.
"""

import contextlib
import hashlib
import os
import platform
import re
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from itertools import takewhile
from pathlib import Path

from zswarm.plugins import registry as plugins
from zswarm.plugins.distributions import compiled_files, regular

LIBRARIES = ("llvmlite", "numba", "numpy", "pymunk")
PROPOSING = {"cmaes": "cmaes", "cma-me": "ribs", "map-elites": "ribs"}  # by optimizer
CODE, BUILD, NONE = "code of ", "build of ", "none"
PHYSICS = "pymunk"  # compiled differently by PyPI, conda and distributions of Linux
PACKAGE_VERSION = re.compile(r"\w[\w.!+-]*")
CPUINFO = Path("/proc/cpuinfo")
# On x86-64 and aarch64. Compiled code depends on these; others differ between equal machines.
KEYS = (
    "vendor_id|cpu family|model|flags|"
    "CPU implementer|CPU architecture|CPU variant|CPU part|Features"
)
PACKAGE = Path(__file__).parents[1]
SHARED = [
    "evaluate.py",
    "probe.py",
    "config/ranges.py",
    *(f"sims/{name}.py" for name in ("raised", "randomized", "simulator", "turns")),
    *(
        f"kernels/{name}.py"
        for name in ("angles", "compiler", "jit", "lanes", "portable")
    ),
    *(f"kernels/{name}.py" for name in ("random", "signatures", "sums", "vectors")),
    *(f"nets/{name}.py" for name in ("meshed", "networks", "neurons")),
    *(f"nets/{name}.py" for name in ("representation", "vector")),
]


@cache
def version_hash(simulator: str, representation: str) -> str:
    """Return 32 hex digits for the code of a simulator and a representation."""
    further = _further(_libraries(simulator, representation))
    further = further | _distributions(simulator, representation)
    total = _shared().copy()
    total.update("".join(f"{name} {found}\n" for name, found in further.items()).encode())
    total.update(_contents("simulator", simulator))
    total.update(_contents("representation", representation))
    return total.hexdigest()


@cache
def _contents(kind: plugins.Kind, name: str) -> bytes:
    """Return what the files of a part add to a hash."""
    return b"".join(_hashed(_files(kind, name)))


@cache  # a server asks for each part as often as there are parts of the other kind
def _files(kind: plugins.Kind, name: str) -> tuple[Path, ...]:
    return tuple(plugins.source_files(kind, name))


@cache
def _named(kind: plugins.Kind, name: str) -> tuple[str, ...]:
    return tuple(plugins.libraries(_files(kind, name)))


def _libraries(simulator: str, representation: str) -> tuple[str, ...]:
    named = {*_named("simulator", simulator), *_named("representation", representation)}
    return tuple(sorted(named))


def versions(simulator: str, representation: str) -> dict[str, str]:
    """Return what the version hash covers: versions of libraries, short digests of code."""
    return {
        **_common(),
        **_further(_libraries(simulator, representation)),
        **_distributions(simulator, representation),
        f"{CODE}simulator {simulator}": _code("simulator", simulator),
        f"{CODE}representation {representation}": _code("representation", representation),
    }


def proposing(optimizer: str) -> dict[str, str]:
    """Return the versions of the packages that propose an optimizer's candidates."""
    name = PROPOSING.get(optimizer)
    packages = {name: _version(name)} if name else {}
    return packages | plugins.distribution_versions("optimizer", optimizer)


def differing(
    found: Mapping[str, str],
    asked: Mapping[str, str],
    at: str = "here",
    other: str = "there",
) -> list[str]:
    """Describe how versions differ.

    Args:
        found: on this machine.
        asked: of another one, or of an earlier time.
        at: where ``found`` is, in the words of the reader.
        other: where ``asked`` is.
    """
    parts = []
    for name, theirs in asked.items():
        if found.get(name) == theirs:
            continue
        if name.startswith((CODE, BUILD)):
            parts.append(f"other {name}")
        elif name in found:
            parts.append(f"{name} {found[name]} {at}, {theirs} {other}")
        else:
            parts.append(f"no {name} {at}")
    return parts


def lacking(here: Mapping[str, str], asked: Mapping[str, str]) -> list[str]:
    """Return the packages to install here, as arguments of pip."""
    missing = {
        name: asked[name]
        for name, found in here.items()
        if found == NONE != asked.get(name, NONE)
    }
    return [
        f"{name}=={theirs}" if PACKAGE_VERSION.fullmatch(theirs) else name
        for name, theirs in missing.items()
    ]


@cache
def cache_hash() -> str:
    """Return 32 hex digits for all code that may be compiled here, and for the processor."""
    return digest([*_compiled(), *plugins.plugin_files()], _processor())


@cache
def bundled_cache_hash() -> str:
    """Return the cache hash without plug-ins."""
    return digest(_compiled(), _processor())


def _compiled() -> list[Path]:
    folders = [PACKAGE / "nets", PACKAGE / "sims"]
    return [file for folder in folders for file in regular(folder.rglob("*.py"))]


def digest(files: Iterable[Path], text: str = "") -> str:
    """Return 32 hex digits for the shared and given files, the libraries' versions, and a text."""
    total = _shared().copy()
    total.update(text.encode() + b"".join(_hashed(files)))
    return total.hexdigest()


@cache
def _shared() -> "hashlib.blake2b":
    total = hashlib.blake2b(digest_size=16)
    for name, found in _installed().items():
        total.update(f"{name} {found}\n".encode())
    total.update(b"".join(_hashed(_shared_files())))
    return total


def _shared_files() -> list[Path]:
    return [PACKAGE / name for name in SHARED]


@cache
def _common() -> dict[str, str]:
    return _installed() | {f"{CODE}zswarm": _short(_shared_files())}


def _installed() -> dict[str, str]:
    # Patch releases of Python compute the same; 3.12 added floats otherwise than 3.11.
    python = {"Python": ".".join(platform.python_version_tuple()[:2])}
    return python | {library: version(library) for library in LIBRARIES}


@cache
def _code(kind: plugins.Kind, name: str) -> str:
    return hashlib.blake2b(_contents(kind, name), digest_size=4).hexdigest()


def _short(files: Iterable[Path]) -> str:
    return hashlib.blake2b(b"".join(_hashed(files)), digest_size=4).hexdigest()


@cache
def _further(libraries: tuple[str, ...]) -> dict[str, str]:
    """Return the versions of libraries that parts name, and the processor's architecture.

    zswarm cannot promise their bits. The name of an entry-point group stands for all packages that
    add to it.
    """
    if not libraries:
        return {}
    adding = [
        point.dist
        for name in libraries
        for point in plugins.entry_points().select(group=name)
    ]
    found = {library: _version(library) for library in libraries}
    found |= {package.name: package.version for package in adding if package is not None}
    if PHYSICS in libraries:
        found[f"{BUILD}{PHYSICS}"] = _short(compiled_files(PHYSICS))
    return dict(sorted(found.items())) | {"architecture": platform.machine()}


def _distributions(simulator: str, representation: str) -> dict[str, str]:
    return {
        **plugins.distribution_versions("simulator", simulator),
        **plugins.distribution_versions("representation", representation),
    }


def _version(library: str) -> str:
    try:
        return version(library)
    except PackageNotFoundError:
        return NONE


def _hashed(files: Iterable[Path]) -> Iterator[bytes]:
    """Yield what each file adds to a hash: its name and the digest of its content."""
    for file in files:
        # One that was removed since it was listed, such as an editor's, counts for nothing.
        with contextlib.suppress(FileNotFoundError):
            found = file.stat()
            content = _content(file, found.st_mtime_ns, found.st_size, found.st_ino)
            yield file.name.encode() + content


@cache  # files are in the hashes of many problems, and may be large
def _content(file: Path, *_: int) -> bytes:
    """Return the digest of a file's content, computed again when the file was changed."""
    with file.open("rb") as content:
        made = hashlib.file_digest(content, lambda: hashlib.blake2b(digest_size=16))
    return made.digest()


def _processor() -> str:
    """Return the processor's kind, and the one for which numba is told to compile instead."""
    target = [
        os.environ.get(name, "") for name in ("NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES")
    ]
    try:
        # The first processor's entry: a large machine has hundreds.
        with CPUINFO.open() as lines:
            first = "".join(takewhile(str.strip, lines))
    except OSError:  # macOS
        first = ""
    kind = re.findall(rf"^(?:{KEYS})\t*:.*", first, re.M)
    return "\n".join([platform.machine(), *kind, *target])
