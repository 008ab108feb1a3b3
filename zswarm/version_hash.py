"""The version hash: two machines compute the same only if the code that computes is the same.

It covers the shared files, the simulator, the representation, and the versions of the libraries that turn them into
machine code; where a library itself plays trials (``LIBRARIES`` of a module), its version and the processor's
architecture, too. Servers whose hash differs from the optimizer's are named and not used.

The cache hash names the folder of the compiled kernels. It covers all code that may be compiled, and the processor: a home
folder may be shared by machines of unlike processors. numba does tell them apart in one folder, but two that compile at the same
time choose the same file name, and one of them then runs the other's machine code.
"""

import hashlib
import os
import platform
import re
from collections.abc import Iterable, Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, entry_points, version
from itertools import takewhile
from pathlib import Path

from zswarm import plugins

LIBRARIES = ("llvmlite", "numba", "numpy", "pymunk")
CODE, NONE = "code of ", "none"
PACKAGE_VERSION = re.compile(r"\w[\w.!+-]*")
CPUINFO = Path("/proc/cpuinfo")
# What compiled code depends on: x86-64, then aarch64. The rest differs between equal machines, or from day to day.
KIND = "vendor_id|cpu family|model|flags|CPU implementer|CPU architecture|CPU variant|CPU part|Features"
SHARED = (
    *("draws.py", "evaluate.py", "jit.py", "lanes.py", "portable.py", "ranges.py", "varied.py"),
    *("nets/networks.py", "nets/neurons.py", "nets/representation.py", "nets/vector.py", "sims/simulator.py"),
)


@cache
def version_hash(simulator: str, representation: str) -> str:
    """32 hex digits for the code behind a simulator and a representation, by name."""
    files = _files(simulator, representation)
    further = _further(tuple(plugins.libraries(files)))
    return digest(files, "".join(f"{library} {said}\n" for library, said in further.items()))


def _files(simulator: str, representation: str) -> list[Path]:
    return [*plugins.source_files("simulator", simulator), *plugins.source_files("representation", representation)]


def versions(simulator: str, representation: str) -> dict[str, str]:
    """What the version hash is of, by name, to say what differs: versions of libraries, short digests of code."""
    return {
        **_common(),
        **_further(tuple(plugins.libraries(_files(simulator, representation)))),
        f"{CODE}simulator {simulator}": _code("simulator", simulator),
        f"{CODE}representation {representation}": _code("representation", representation),
    }


def differing(here: Mapping[str, str], asked: Mapping[str, str]) -> list[str]:
    """What is not the same in two versions, in words of the program that has the first."""
    return [
        f"other {name}" if name.startswith(CODE) else f"{name} {here[name]}, not {theirs}" if name in here else f"no {name}"
        for name, theirs in asked.items()
        if here.get(name) != theirs
    ]


def lacking(here: Mapping[str, str], asked: Mapping[str, str]) -> list[str]:
    """Packages that are not installed for the first of two versions, but for the second, as pip is told of them."""
    missing = {name: asked[name] for name, said in here.items() if said == NONE != asked.get(name, NONE)}
    return [f"{name}=={said}" if PACKAGE_VERSION.fullmatch(said) else name for name, said in missing.items()]


@cache
def cache_hash() -> str:
    """32 hex digits for all code that may be compiled on this machine, bundled and plug-ins, and for its processor."""
    package = Path(__file__).parent
    bundled = [file for folder in ("nets", "sims") for file in sorted((package / folder).glob("*.py"))]
    return digest([*bundled, *plugins.plugin_files()], _processor())


def digest(files: Iterable[Path], text: str = "") -> str:
    """32 hex digits over the shared files, the given ones (name and content), the libraries' versions, and a text."""
    total = _shared().copy()
    total.update(text.encode())
    for file in files:
        _add(total, file)
    return total.hexdigest()


@cache
def _shared() -> "hashlib.blake2b":
    total = hashlib.blake2b(digest_size=16)
    for library in LIBRARIES:
        total.update(f"{library} {version(library)}\n".encode())
    for name in SHARED:
        _add(total, Path(__file__).parent / name)
    return total


@cache
def _common() -> dict[str, str]:
    shared = _short(Path(__file__).parent / name for name in SHARED)
    return {library: version(library) for library in LIBRARIES} | {f"{CODE}zswarm": shared}


@cache
def _code(kind: plugins.Kind, name: str) -> str:
    return _short(plugins.source_files(kind, name))


def _short(files: Iterable[Path]) -> str:
    total = hashlib.blake2b(digest_size=4)
    for file in files:
        _add(total, file)
    return total.hexdigest()


@cache
def _further(libraries: tuple[str, ...]) -> dict[str, str]:
    """Versions of libraries that parts name, and the processor's architecture: their bits are not ours to promise.

    A name may be that of a group of entry points, for all packages that add to it.
    """
    if not libraries:
        return {}
    found = {library: _version(library) for library in libraries}
    points = entry_points()
    adding = {point.dist for name in libraries for point in points.select(group=name) if point.dist is not None}
    found |= {package.name: package.version for package in adding}
    return {library: found[library] for library in sorted(found)} | {"architecture": platform.machine()}


def _version(library: str) -> str:
    try:
        return version(library)
    except PackageNotFoundError:
        return NONE


def _add(total: "hashlib.blake2b", file: Path) -> None:
    total.update(file.name.encode() + hashlib.blake2b(file.read_bytes(), digest_size=16).digest())


def _processor() -> str:
    """Its kind, and the one that numba is told to compile for instead."""
    told = [os.environ.get(name, "") for name in ("NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES")]
    try:
        with CPUINFO.open() as lines:  # the first processor's; a text for each would take long on a large machine
            first = "".join(takewhile(str.strip, lines))
    except OSError:  # macOS
        first = ""
    kind = re.findall(rf"^(?:{KIND})\t*:.*", first, re.M)
    return "\n".join([platform.machine(), *kind, *told])
