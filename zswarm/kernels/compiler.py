"""Compile the kernels that ``jit.py`` declares.

Importing this module imports and configures numba.
"""

import os
from collections.abc import Callable
from typing import Any, get_type_hints

import numpy as np

from zswarm.kernels.cache import cache_folder
from zswarm.kernels.signatures import STEP, STEP_SIGNATURE, ArrayType

os.environ["NUMBA_CACHE_DIR"] = str(cache_folder())
# SVML's functions differ from LLVM's in the last bits.
os.environ["NUMBA_DISABLE_INTEL_SVML"] = "1"

# numba reads the two settings above when it is imported.
import numba
from numba import types

numba.config.reload_config()  # reads them again, in case numba was imported before
# Load now what numba loads for its first kernel, so that slots inherit it from the fork server.
numba.core.registry.cpu_target.typing_context.refresh()
numba.core.registry.cpu_target.target_context.refresh()

from zswarm.kernels import vectors as vectors  # noqa: E402  teaches numba the functions of lanes.py


def compiled(
    function: Callable[..., Any],
    declared: tuple[Any, ...] | None,
    options: dict[str, Any],
) -> Any:
    """Return numba's dispatcher for a function, with its declared signature and options."""
    signature = None if declared is None else _signature(declared)
    dispatcher: Any = numba.njit(signature, error_model="numpy", cache=True, **options)(
        function
    )
    # Each call of a kernel with a step looks up the step's compiled form, which takes 25 us: cache
    # the result.
    if declared == STEP_SIGNATURE and hasattr(dispatcher, "get_compile_result"):
        result = dispatcher.get_compile_result(signature)
        dispatcher.get_compile_result = lambda _: result
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
