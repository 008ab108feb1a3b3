"""Compile and load C, for tests that call it."""

import ctypes
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Werror", "-pedantic")


def require(*programs: str) -> None:
    """Skip the test if one of the programs is missing."""
    for name in programs:
        if shutil.which(name) is None:
            pytest.skip(f"no {name} on this machine")


def library(
    sources: dict[str, str], folder: Path, *flags: str, compiler: str = "gcc"
) -> ctypes.CDLL:
    """Compile sources and headers, by their names, into one shared library; warnings are errors."""
    require(compiler)
    for name, text in sources.items():
        (folder / name).write_text(text, "ascii")
    made = folder / "compiled.so"
    files = [folder / name for name in sources if name.endswith(".c")]
    done = subprocess.run(
        [compiler, *STRICT, *flags, "-shared", "-fPIC", "-o", made, *files, "-lm"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return ctypes.CDLL(str(made))


def floats(numbers: np.ndarray) -> ctypes.c_void_p:
    """Return a pointer to an array."""
    return numbers.ctypes.data_as(ctypes.c_void_p)


def decisions(
    library: ctypes.CDLL, stem: str, observations: np.ndarray, outputs: int, size: int
) -> list[str]:
    """Return the decisions of a pair from the start of a trial, as hexadecimal bytes."""
    state, action = np.full(size + 1, 7, np.float32), np.zeros(outputs, np.float32)
    getattr(library, f"{stem}_reset")(floats(state))
    decided = []
    for row in observations:
        getattr(library, f"{stem}_step")(floats(state), floats(row), floats(action))
        decided.append(action.tobytes().hex())
    assert state[size] == 7, "the state has room for more numbers than it says"
    return decided
