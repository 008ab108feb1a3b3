"""Compile the kernels that ``jit.py`` declares.

Importing this module imports and configures numba.
"""

import functools
import os
import secrets
from collections.abc import Callable
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np

from zswarm.kernels.cache import cache_folder, claimed
from zswarm.kernels.signatures import STEP, STEP_SIGNATURE, ArrayType
from zswarm.plugins.registry import plugin_files
from zswarm.plugins.version_hash import PACKAGE, bundled_cache_hash

os.environ["NUMBA_CACHE_DIR"] = str(claimed(cache_folder()))
# SVML's functions differ from LLVM's in the last bits.
os.environ["NUMBA_DISABLE_INTEL_SVML"] = "1"

# numba reads the two settings above when it is imported.
import numba
from numba import types
from numba.core import (
    boxing as boxing,
)  # this and others: so that slots need not load them
from numba.core import typeinfer
from numba.core.caching import FunctionCache, IndexDataCacheFile
from numba.core.runtime.nrt import rtsys
from numba.cpython import numbers as numbers
from numba.experimental import function_type as function_type
from numba.np import arrayobj as arrayobj

numba.config.reload_config()  # reads them again, in case numba was imported before

from zswarm.kernels import vectors as vectors  # noqa: E402  teaches numba the functions of lanes.py

BUNDLED = claimed(cache_folder(bundled_cache_hash()))  # kernels that call no plug-in
# The folders that its hash covers.
COMPILED = tuple(f"{PACKAGE / name}{os.sep}" for name in ("kernels", "nets", "sims"))
# Load now what the first kernel needs, so that slots inherit it from the fork server. Where all are
# zswarm's and compiled, that is numba's runtime, and not its compiler, which takes half a second.
rtsys.initialize(numba.core.registry.cpu_target.target_context)
if plugin_files() or not any(BUNDLED.rglob("*.nbi")):
    numba.core.registry.cpu_target.typing_context.refresh()
    numba.core.registry.cpu_target.target_context.refresh()


class Cache(FunctionCache):
    """The compiled forms of one function on disk, safe for programs that compile at once.

    numba's cache depends on where a file is, and in some versions on its time. zswarm's own
    functions are found wherever they are installed: their folder's name stands for the code.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)  # type: ignore[no-untyped-call]
        locator = self._impl.locator
        stamp = locator.get_source_stamp()
        self._is_ours = is_bundled(function)
        if self._is_ours:
            file = Path(function.__code__.co_filename).relative_to(PACKAGE)
            self._cache_path = locator._cache_path = str(BUNDLED / file.parent)
            stamp = ""
        self._cache_file = CacheFile(  # type: ignore[no-untyped-call]
            self._cache_path, self._impl.filename_base, stamp
        )
        self.index = Path(self._cache_file._index_path)

    def load_overload(self, signature: Any, target_context: Any) -> Any:
        """Return a compiled form, or None.

        numba would load its compiler first, because a compiled form may call C functions that the
        compiler's modules register. Those of zswarm's kernels call numba's runtime only.
        """
        if not self._is_ours:
            return super().load_overload(signature, target_context)  # type: ignore[no-untyped-call]
        with self._guard_against_spurious_io_errors():
            return self._load_overload(signature, target_context)  # type: ignore[no-untyped-call]
        return None


class CacheFile(IndexDataCacheFile):
    """An index and data files, whose names no other program chooses.

    numba numbers data files by the index that it read. Two programs that compile a function for
    different types at the same time choose one number, and then the entry of one leads to the
    machine code of the other.
    """

    def _data_name(self, number: int) -> str:  # noqa: ARG002
        return f"{self._index_name.removesuffix('.nbi')}.{secrets.token_hex(8)}.nbc"


@functools.cache
def is_bundled(function: Callable[..., Any]) -> bool:
    """Return whether a function and those that it calls by name are zswarm's own."""
    found: set[Callable[..., Any]] = set()
    waiting = [function]
    while waiting:
        one = waiting.pop()
        if one in found:
            continue
        if not one.__code__.co_filename.startswith(COMPILED):
            return False
        found.add(one)
        # Attributes are among a function's names, too; one may be called as a function is.
        names: dict[str, Any] = one.__globals__
        named = [names[name] for name in one.__code__.co_names if name in names]
        waiting += [each.py_func for each in named if hasattr(each, "py_func")]
    return True


def is_cached(function: Callable[..., Any]) -> bool:
    """Return whether a program compiled a function before, for any types."""
    return Cache(function).index.exists()


def compiled(
    function: Callable[..., Any],
    declared: tuple[Any, ...] | None,
    options: dict[str, Any],
) -> Any:
    """Return numba's dispatcher for a function, with its declared signature and options."""
    signature = None if declared is None else _signature(declared)
    dispatcher: Any = numba.njit(error_model="numpy", **options)(function)
    if not numba.config.DISABLE_JIT:  # type: ignore[attr-defined]  # set when it is loaded
        dispatcher._cache = Cache(function)
        if signature is not None:
            # As ``njit`` does with a signature; with ``cache=True`` it makes the cache, too.
            with typeinfer.register_dispatcher(dispatcher):
                dispatcher.compile(signature)
            dispatcher.disable_compile()
    # Each call of a kernel with a step looks up the step's compiled form and its addresses, which
    # takes 35 us: cache them.
    if declared == STEP_SIGNATURE and hasattr(dispatcher, "get_compile_result"):
        result = dispatcher.get_compile_result(signature)
        dispatcher.get_compile_result = lambda _: result
        library = result.library
        library.get_pointer_to_function = functools.cache(library.get_pointer_to_function)
    return dispatcher


def _signature(declared: tuple[Any, ...]) -> Any:
    return types.void(*map(_type, declared))


def _type(declared: Any) -> Any:
    if declared is STEP:
        return types.FunctionType(_signature(STEP_SIGNATURE))
    if isinstance(declared, ArrayType):
        return types.Array(_type(declared.dtype), declared.dimensions, "C")
    if hasattr(declared, "__metadata__"):  # of ``Annotated``
        return _type(declared.__metadata__[0])
    if hasattr(declared, "_fields"):  # a ``NamedTuple``
        fields = get_type_hints(declared, include_extras=True).values()
        return types.BaseTuple.from_types(list(map(_type, fields)), declared)
    return (
        declared
        if isinstance(declared, types.Type)
        else numba.from_dtype(np.dtype(declared))
    )
