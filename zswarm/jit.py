"""Compiles kernels with numba: the same bits on every machine, and a cache that notices every change.

numba's own cache looks only at the file a function stands in and would return old results after a change elsewhere.
So the cache lies in a folder named by the hash of all code that may be compiled and of the processor
(``version_hash.cache_hash``), chosen here before numba is imported. Import numba's names from this module only;
``lanes.py``, which teaches numba a type, imports more.

With ``ZSWARM_PLAIN=1`` kernels stay Python functions, which do the same, slowly: for tests, and for programs that look at
genomes but evaluate nothing.
"""

import contextlib
import os
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import platformdirs

from zswarm.version_hash import cache_hash


def cache_folder() -> Path:
    """The first that can be written of ``$ZSWARM_CACHE``, systemd's ``$CACHE_DIRECTORY``, the user's and a temporary one."""
    for choice in _choices():
        folder = choice / cache_hash()
        try:
            folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        except OSError:
            continue
        if os.access(folder, os.W_OK | os.X_OK) and _is_ours(folder.parent) and _is_ours(folder):
            return folder
    return Path(tempfile.mkdtemp(prefix="zswarm-"))


def _choices() -> Iterator[Path]:
    for name in ("ZSWARM_CACHE", "CACHE_DIRECTORY"):
        if folder := os.environ.get(name):
            yield Path(folder)
    with contextlib.suppress(RuntimeError):  # nobody knows where this user is at home, as in a container with users of its own
        if (folder := platformdirs.user_cache_dir("zswarm")).startswith("/"):  # older versions of platformdirs say it with ~
            yield Path(folder)
    yield Path(tempfile.gettempdir(), f"zswarm-{os.getuid()}")


def _is_ours(folder: Path) -> bool:
    """Whether nobody else can put files there: what lies in a cache is run."""
    status = folder.stat()
    return status.st_uid == os.getuid() and not status.st_mode & 0o022


PLAIN = os.environ.get("ZSWARM_PLAIN", "") == "1"  # kernels stay Python, numba is not imported

uint8: Any
int32: Any
int64: Any
uint64: Any
float32: Any
float64: Any
if PLAIN:
    uint8, int32, int64, uint64 = np.uint8, np.int32, np.int64, np.uint64
    float32, float64 = np.float32, np.float64
    np.seterr(over="ignore")  # kernels count on integers that wrap
else:
    os.environ["NUMBA_CACHE_DIR"] = str(cache_folder())
    os.environ["NUMBA_DISABLE_INTEL_SVML"] = "1"  # its functions differ from LLVM's in the last bits

    import numba  # the two settings above are read by this import

    numba.config.reload_config()  # or they are read now: somebody imported numba before
    # What numba loads for the first kernel. Here the fork server of the slots has it, so that they share it.
    numba.core.registry.cpu_target.typing_context.refresh()
    numba.core.registry.cpu_target.target_context.refresh()

    uint8, int32, int64, uint64 = numba.types.uint8, numba.types.int32, numba.types.int64, numba.types.uint64
    float32, float64 = numba.types.float32, numba.types.float64


def void(*arguments: Any) -> Any:
    """The signature of a kernel, which returns nothing."""
    return None if PLAIN else numba.types.void(*arguments)


def array(dtype: Any, dimensions: int = 1) -> Any:
    """The type of a C-contiguous array."""
    return None if PLAIN else numba.types.Array(dtype, dimensions, "C")


def kernel(signature: Any) -> Any:
    """Compile a function for one signature, strictly: no fast-math, no reordering, division by zero as in numpy."""
    if signature == STEP_SIGNATURE and not PLAIN:
        return _decision
    return _as_it_is if PLAIN else numba.njit(signature, cache=True, error_model="numpy")


def _decision(function: Any) -> Any:
    """Compile a controller's decision. It makes no arrays, so numba need not count who uses those that it is given.

    numba asks for the compiled form whenever a kernel is called with it, and looks for it 25 us long.
    """
    step = numba.njit(STEP_SIGNATURE, cache=True, error_model="numpy", _nrt=False)(function)  # type: ignore[call-overload]  # private
    if hasattr(step, "get_compile_result"):  # not with NUMBA_DISABLE_JIT
        compiled = step.get_compile_result(STEP_SIGNATURE)
        step.get_compile_result = lambda _: compiled
    return step


def inline(function: Any = None, *, counts: bool = True, inner: bool = False) -> Any:
    """Compile a function into the kernels that call it.

    Without ``counts`` it becomes a part of them, and numba does not count who uses an array, which costs two atomic additions for
    each that a function is given or takes a row of. Such a function must make no arrays and return none, nor call one that does.

    An ``inner`` one is called by compiled functions only, which takes a sixth less to compile: a call from Python would crash.
    """
    if function is None:
        return lambda function: inline(function, counts=counts, inner=inner)
    options: dict[str, Any] = {} if counts else {"_nrt": False, "forceinline": True}
    if inner:
        options |= {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    return function if PLAIN else numba.njit(function, error_model="numpy", cache=True, **options)


def _as_it_is(function: Any) -> Any:
    return function


# One decision of a controller: (parameters, state, observation, output). Every representation's ``step`` has this type,
# so a simulator's kernel is compiled once and takes any of them.
FLOATS = array(float32)
STEP_SIGNATURE = void(FLOATS, FLOATS, FLOATS, FLOATS)
STEP = None if PLAIN else numba.types.FunctionType(STEP_SIGNATURE)
Step = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], None]


def sqrt(x: Any) -> Any:
    """The square root of a number or of lanes, rounded once; NaN of what is negative. numba's ``np.sqrt`` is a slow call."""
    return np.sqrt(x)


if not PLAIN:
    import llvmlite.ir

    @numba.extending.intrinsic
    def _root(_, x):  # type: ignore[no-untyped-def]  # numba looks at its arguments
        def generate(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
            kind = context.get_value_type(signature.return_type)
            suffix = f"v{kind.count}{kind.element.intrinsic_name}" if hasattr(kind, "count") else kind.intrinsic_name
            root = numba.core.cgutils.get_or_insert_function(
                builder.module, llvmlite.ir.FunctionType(kind, [kind]), f"llvm.sqrt.{suffix}"
            )
            return builder.call(root, arguments)

        return (x(x), generate) if isinstance(getattr(x, "element", x), numba.types.Float) else None

    @numba.extending.overload(sqrt)
    def _sqrt(x):  # type: ignore[no-untyped-def]  # noqa: ARG001
        return lambda x: _root(x)  # type: ignore[call-arg]
