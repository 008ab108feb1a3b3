"""Compiles kernels with numba: the same bits on every machine, and a cache that notices every change.

numba's own cache looks only at the file a function stands in and would return old results after a change elsewhere.
So the cache lies in a folder named by the hash of all code that may be compiled (``version_hash.cache_hash``), chosen
here before numba is imported. Import numba's names from this module only.
"""

import os
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import platformdirs

from zswarm.version_hash import cache_hash


def cache_folder() -> Path:
    """The first of ``$ZSWARM_CACHE``, systemd's ``$CACHE_DIRECTORY``, the user's cache, the temporary folder that can be written."""
    choices = [
        os.environ.get("ZSWARM_CACHE"),
        os.environ.get("CACHE_DIRECTORY"),
        platformdirs.user_cache_dir("zswarm"),
        f"{tempfile.gettempdir()}/zswarm-{os.getuid()}",
    ]
    for choice in filter(None, choices):
        folder = Path(choice) / cache_hash()
        try:
            folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        except OSError:
            continue
        if os.access(folder, os.W_OK | os.X_OK):
            return folder
    return Path(tempfile.mkdtemp(prefix="zswarm-"))


def is_warm() -> bool:
    """Whether kernels of this version were compiled on this machine before."""
    return any(cache_folder().glob("*/*.nbi"))


os.environ["NUMBA_CACHE_DIR"] = str(cache_folder())
os.environ["NUMBA_DISABLE_INTEL_SVML"] = "1"  # its functions differ from LLVM's in the last bits

import numba  # noqa: E402  the two settings above are read by this import
from numba import types  # noqa: E402

void = types.void
uint8 = types.uint8
int32 = types.int32
int64 = types.int64
uint64 = types.uint64
float32 = types.float32
float64 = types.float64


def array(dtype: types.Type, dimensions: int = 1) -> types.Type:
    """The type of a C-contiguous array."""
    return types.Array(dtype, dimensions, "C")


def kernel(signature):  # type: ignore[no-untyped-def]  # numba is untyped
    """Compile a function for one signature, strictly: no fast-math, no reordering, division by zero as in numpy."""
    return numba.njit(signature, cache=True, error_model="numpy")


def inline(function):  # type: ignore[no-untyped-def]  # numba is untyped
    """Compile a function into the kernels that call it."""
    return numba.njit(function, error_model="numpy", cache=True)


# One decision of a controller: (parameters, state, observation, output). Every representation's ``step`` has this type,
# so a simulator's kernel is compiled once and takes any of them.
FLOATS = array(float32)
STEP_SIGNATURE = void(FLOATS, FLOATS, FLOATS, FLOATS)
STEP = types.FunctionType(STEP_SIGNATURE)
Step = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], None]
