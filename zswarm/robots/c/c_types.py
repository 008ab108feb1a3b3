"""Types of the kernels' values, and how C writes values and names.

They follow numba's rules, since numba compiled what evolved: whole numbers are int64, a Python
float is float64, and float32 with int64 is float64.
"""

import math
import re
import unicodedata
from typing import Any, NamedTuple

import numpy as np

LONGEST = 40  # letters of a controller's name


class Scalar(NamedTuple):
    """The type of a number: its names in numpy and in C."""

    name: str
    c: str

    def __str__(self) -> str:
        return self.name


class Array(NamedTuple):
    """The type of numbers in the caller's memory; ``length`` is None where it is unknown."""

    element: Scalar
    length: int | None = None

    def __str__(self) -> str:
        return f"an array of {self.element}"


class LanesType(NamedTuple):
    """The type of the numbers in all lanes of a vector."""

    element: Scalar

    def __str__(self) -> str:
        return f"lanes of {self.element}"


class StructType(NamedTuple):
    """The type of a tuple that a function returns: a struct, its name, and its members."""

    c: str
    of: tuple[Scalar, ...]
    names: tuple[str, ...]

    def __str__(self) -> str:
        return "a tuple"


FLOAT32, FLOAT64 = Scalar("float32", "float"), Scalar("float64", "double")
INT32, INT64 = Scalar("int32", "int32_t"), Scalar("int64", "int64_t")
UINT32, UINT64 = Scalar("uint32", "uint32_t"), Scalar("uint64", "uint64_t")
UINT8, BOOL = Scalar("uint8", "uint8_t"), Scalar("bool", "bool")
ALL = (FLOAT32, FLOAT64, INT32, INT64, UINT32, UINT64, UINT8, BOOL)
NOTHING = Scalar("nothing", "void")  # the result of functions without one
SCALARS = {scalar.name: scalar for scalar in ALL}
FLOATS, SIGNED, UNSIGNED = (FLOAT32, FLOAT64), (INT32, INT64), (UINT8, UINT32, UINT64)
WHOLE = (*SIGNED, *UNSIGNED, BOOL)

Type = Scalar | Array | LanesType | StructType

# Not valid as names: keywords of C and C++, and names that headers define.
WORDS = set(
    """
    alignas alignof and and_eq asm auto bitand bitor bool break case catch char class compl const
    constexpr continue decltype default delete do double dynamic_cast else enum explicit export
    extern false float for friend goto if inline int long main mutable namespace new noexcept not
    not_eq nullptr operator or or_eq private protected public register reinterpret_cast restrict
    return short signed sizeof static static_assert static_cast struct switch template this
    thread_local throw true try typedef typeid typename typeof union unsigned using virtual void
    volatile wchar_t while xor xor_eq linux unix near far fabs fmod fmodf sqrt sqrtf isnan memcpy
    div log exp sin cos tan tanh y0 y1 yn j0 j1 jn gamma
    """.split()
)


def type_of(value: Any) -> Type | None:
    """Return the type of a constant of Python or numpy; None if kernels cannot hold it."""
    match value:
        case bool() | np.bool_():
            return BOOL
        case int():
            return INT64
        case np.ndarray() if value.ndim == 1 and value.dtype.name in SCALARS:
            return Array(SCALARS[value.dtype.name], len(value))
        case np.generic() if value.dtype.name in SCALARS:
            return SCALARS[value.dtype.name]
        case float():
            return FLOAT64
    return None


def joined(left: Type | None, right: Type | None) -> Any:
    """Return the type of an operation on two types; None where numba's choice would surprise."""
    if left == right:
        return left
    if BOOL in (left, right) or not {left, right} <= set(ALL):
        return None
    if left in FLOATS or right in FLOATS:
        return FLOAT64
    if left in UNSIGNED and right in UNSIGNED:
        return UINT64
    return INT64 if left in SIGNED and right in SIGNED else None


def convert(value: Any, to: Scalar) -> Any:
    """Convert a constant to another type as numba does."""
    for python, type_ in ((float, FLOAT64), (int, INT64), (bool, BOOL)):
        if to == type_:
            return python(value)
    if to in WHOLE:
        bits = 8 * np.dtype(to.name).itemsize
        return np.array(int(value) % (1 << bits), f"uint{bits}").astype(to.name)[()]
    with np.errstate(over="ignore"):
        return np.dtype(to.name).type(value)


def literal(value: Any) -> str:
    """Return a constant as C99 writes it; floating-point numbers in hexadecimal, exactly."""
    kind = type_of(value)
    if kind in FLOATS:
        return _hexadecimal(float(value), is_single=kind == FLOAT32)
    if kind == BOOL:
        return "true" if value else "false"
    if kind == UINT64:
        return f"UINT64_C({value})"
    if kind in UNSIGNED:
        return f"{value}U"
    if -(2**31) < value < 2**31:
        return str(value)
    if value == -(2**31):
        return "(-2147483647 - 1)"
    return f"INT64_C({value})" if value > -(2**63) else "INT64_MIN"


def _hexadecimal(number: float, *, is_single: bool) -> str:
    """Write a floating-point number; the macros of C are of type float."""
    if math.isfinite(number):
        mantissa, exponent = number.hex().split("p")
        suffix = "f" if is_single else ""
        return f"{mantissa.rstrip('0').rstrip('.')}p{exponent}{suffix}"
    sign = "-" if number < 0 else ""
    macro = "NAN" if math.isnan(number) else "INFINITY"
    return f"{sign}{'' if is_single else '(double)'}{macro}"


def spelled(name: str) -> str:
    """Return a Python name as a part of a C name."""
    plain = re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_")
    return plain if plain and not plain[0].isdigit() else f"n{plain}"


def identifier(name: str) -> str:
    """Return a Python name as the name of a local variable in C."""
    return f"{spelled(name)}_" if spelled(name) in WORDS else spelled(name)


def folded(name: str) -> str:
    """Return any name as a part of C names: a letter, then letters, digits and single ``_``.

    Accents are removed; everything else becomes ``_``; an empty name becomes ``controller``.
    """
    plain = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode().lower()
    plain = re.sub(r"[^a-z0-9]+", "_", plain)[:LONGEST].strip("_")
    if not plain:
        return "controller"
    return plain if plain[0].isalpha() else f"n{plain}"[:LONGEST].rstrip("_")
