"""Spell the signatures of kernels without importing numba."""

from collections.abc import Callable
from typing import Annotated, Any, NamedTuple

import numpy as np

uint8: Any = np.uint8
int32: Any = np.int32
int64: Any = np.int64
uint64: Any = np.uint64
float32: Any = np.float32
float64: Any = np.float64


class ArrayType(NamedTuple):
    """The type of a C-contiguous array."""

    dtype: Any
    dimensions: int = 1


array = ArrayType


def void(*arguments: Any) -> tuple[Any, ...]:
    """Return the signature of a kernel, which returns nothing.

    Args:
        arguments: types; a ``NamedTuple`` passes several arguments as one. Its fields are annotated
            with ``int``, ``float`` or one of the arrays below.
    """
    return arguments


# Arrays in C order as fields of a ``NamedTuple``; ``Rows`` have two dimensions.
Float32Rows = Annotated[np.ndarray, array(float32, 2)]
Float64s = Annotated[np.ndarray, array(float64)]
Float64Rows = Annotated[np.ndarray, array(float64, 2)]
Int32s = Annotated[np.ndarray, array(int32)]
Int32Rows = Annotated[np.ndarray, array(int32, 2)]
Int64s = Annotated[np.ndarray, array(int64)]
Int64Rows = Annotated[np.ndarray, array(int64, 2)]
UInt64s = Annotated[np.ndarray, array(uint64)]


# A controller's decision: (parameters, state, observation, output). Every representation's ``step``
# has this signature, so a simulator's kernel is compiled once and takes any of them.
FLOATS = array(float32)
STEP_SIGNATURE = void(FLOATS, FLOATS, FLOATS, FLOATS)
STEP = "step"  # the type of such a function, as an argument of a kernel
Step = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], None]
