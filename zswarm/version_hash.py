"""The version hash: two machines compute the same only if the code that computes is the same.

It covers the shared files, the simulator, the representation, and the versions of the libraries that turn them into
machine code. Servers whose hash differs from the optimizer's are named and not used.
"""

import hashlib
from collections.abc import Iterable
from functools import cache
from importlib.metadata import version
from pathlib import Path

from zswarm import plugins

LIBRARIES = ("llvmlite", "numba", "numpy", "pymunk")
SHARED = ("draws.py", "evaluate.py", "jit.py", "portable.py", "nets/representation.py", "sims/simulator.py")


@cache
def version_hash(simulator: str, representation: str) -> str:
    """32 hex digits for the code behind a simulator and a representation, by name."""
    files = [*plugins.source_files("simulator", simulator), *plugins.source_files("representation", representation)]
    return digest(files)


@cache
def cache_hash() -> str:
    """32 hex digits for all code that may be compiled on this machine: bundled and plug-ins."""
    package = Path(__file__).parent
    bundled = [file for folder in ("nets", "sims") for file in sorted((package / folder).glob("*.py"))]
    return digest([*bundled, *plugins.plugin_files()])


def digest(files: Iterable[Path]) -> str:
    """32 hex digits over the shared files, the given ones (name and content) and the libraries' versions."""
    total = _shared().copy()
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


def _add(total: "hashlib.blake2b", file: Path) -> None:
    total.update(file.name.encode() + hashlib.blake2b(file.read_bytes(), digest_size=16).digest())
