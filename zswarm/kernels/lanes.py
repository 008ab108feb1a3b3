"""Compute with SIMD vectors of eight lanes.

``load`` reads eight numbers from an array, operators (``+ - * / < <= > >= == != & |``) work lane by
lane, ``select`` replaces a branch, ``store`` writes. In a kernel a vector is one register, or two
of four lanes where the processor has no wider ones; in Python it is a numpy array. Both round each
operation once and reorder nothing, so the bits are those of eight scalars. Elements are float32,
float64, int32 or boolean, which is the result of a comparison.
"""

from typing import Any

import numpy as np

LANES = 8


def load(array: np.ndarray, at: int) -> np.ndarray:
    """Return ``array[at]`` to ``array[at + 7]`` of a flat float32, float64 or int32 array."""
    return array[at : at + LANES].copy()


def store(array: np.ndarray, at: int, numbers: np.ndarray) -> None:
    """Write eight numbers to ``array[at]`` to ``array[at + 7]``."""
    array[at : at + LANES] = numbers


def fill(number: Any) -> np.ndarray:
    """Return a vector with one number, ``np.float32``, ``np.int32`` or a float64, in all lanes."""
    return np.full(LANES, number)


def select(which: Any, yes: Any, no: Any) -> Any:
    """Return, lane by lane, ``yes`` where ``which`` is true, else ``no``.

    ``yes`` and ``no`` may be scalars; if ``which`` is a scalar as well, so is the result.
    """
    return np.where(which, yes, no)[()]


def any_of(which: np.ndarray) -> bool:
    """Return whether any lane is true."""
    return bool(which.any())


def list_true(which: np.ndarray, first: int, array: np.ndarray, at: int) -> int:
    """Write ``first`` + lane for each true lane to an int32 array from ``array[at]`` on.

    Returns:
        the number of true lanes. The array must reach to ``array[at + 7]``; elements up to there
        may be overwritten.
    """
    lanes = np.flatnonzero(which)
    array[at : at + len(lanes)] = first + lanes
    return len(lanes)


def window(
    array: np.ndarray, places: np.ndarray, offset: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Gather four consecutive numbers per lane, from index ``place + offset`` of the lane.

    ``array`` is a flat float32 array and must contain all four.
    """
    return (
        array[places + offset],
        array[places + (offset + 1)],
        array[places + (offset + 2)],
        array[places + (offset + 3)],
    )


def scatter(array: np.ndarray, places: np.ndarray, numbers: np.ndarray) -> None:
    """Write the number of each lane at its index; if indices are equal, the last lane wins."""
    for place, number in zip(places, numbers, strict=True):
        array[place] = number


def sqrt(x: Any) -> Any:
    """Return the square root of a number or of lanes, correctly rounded; NaN for negative numbers.

    numba's ``np.sqrt`` is a slow call; this is the processor's instruction.
    """
    return np.sqrt(x)


def floor(x: Any) -> Any:
    """Return the largest whole number that is not above a number, or those of lanes."""
    return np.floor(x)
