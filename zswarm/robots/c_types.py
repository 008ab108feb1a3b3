"""Types of the kernels' values, and how C writes them.

They follow numba's rules, for what evolved was compiled by it: whole numbers are int64, a bare decimal is float64, and
float32 with int64 is float64.
"""

import math
import re
from typing import Any, NamedTuple

import numpy as np


class Scalar(NamedTuple):
    """A number: numpy's name of its type, and C's."""

    name: str
    c: str


class Array(NamedTuple):
    """Numbers in memory that the caller owns; ``length`` is None where nobody said it."""

    element: Scalar
    length: int | None = None


class Lanes(NamedTuple):
    """Eight numbers side by side."""

    element: Scalar


class Together(NamedTuple):
    """What a function returns as a tuple: a struct, its name, and its members."""

    c: str
    of: tuple[Scalar, ...]
    names: tuple[str, ...]


FLOAT32, FLOAT64 = Scalar("float32", "float"), Scalar("float64", "double")
INT32, INT64 = Scalar("int32", "int32_t"), Scalar("int64", "int64_t")
UINT32, UINT64 = Scalar("uint32", "uint32_t"), Scalar("uint64", "uint64_t")
UINT8, BOOL = Scalar("uint8", "uint8_t"), Scalar("bool", "bool")
SCALARS = {scalar.name: scalar for scalar in (FLOAT32, FLOAT64, INT32, INT64, UINT32, UINT64, UINT8, BOOL)}
FLOATS, SIGNED, UNSIGNED = (FLOAT32, FLOAT64), (INT32, INT64), (UINT8, UINT32, UINT64)
WHOLE = (*SIGNED, *UNSIGNED, BOOL)

Type = Scalar | Array | Lanes | Together

# What the next compiler, or a later one, takes for something else: words of C and C++, and names that headers give.
WORDS = set(
    "alignas alignof and and_eq asm auto bitand bitor bool break case catch char class compl const constexpr continue decltype "
    "default delete do double dynamic_cast else enum explicit export extern false float for friend goto if inline int long main "
    "mutable namespace new noexcept not not_eq nullptr operator or or_eq private protected public register reinterpret_cast "
    "restrict return short signed sizeof static static_assert static_cast struct switch template this thread_local throw true "
    "try typedef typeid typename typeof union unsigned using virtual void volatile wchar_t while xor xor_eq linux unix near far "
    "fabs fmod fmodf sqrt sqrtf isnan memcpy div log exp sin cos tan tanh y0 y1 yn j0 j1 jn gamma".split()
)


def type_of(value: Any) -> Type | None:
    """The type of a constant of Python or numpy; None of what a kernel cannot hold."""
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


def joined(left: Scalar, right: Scalar) -> Scalar | None:
    """The type in which two numbers meet; None where numba's choice would surprise."""
    if left == right:
        return left
    if BOOL in (left, right):
        return None
    if left in FLOATS or right in FLOATS:
        return FLOAT64
    if left in UNSIGNED and right in UNSIGNED:
        return UINT64
    return INT64 if left in SIGNED and right in SIGNED else None


def convert(value: Any, to: Scalar) -> Any:
    """A constant in another type, as numba converts it."""
    if to == FLOAT64:
        return float(value)
    if to == INT64:
        return int(value)
    if to == BOOL:
        return bool(value)
    if to in WHOLE:
        bits = 8 * np.dtype(to.name).itemsize
        return np.array(int(value) % (1 << bits), f"uint{bits}").astype(to.name)[()]
    with np.errstate(over="ignore"):
        return np.dtype(to.name).type(value)


def literal(value: Any) -> str:
    """A constant as C99 writes it; floating-point numbers in hexadecimal, exactly."""
    kind = type_of(value)
    if kind in FLOATS:
        return _decimal(float(value), "f" if kind == FLOAT32 else "")
    if kind == BOOL:
        return "true" if value else "false"
    number = int(value)
    if kind in UNSIGNED:
        return f"UINT64_C({number})" if kind == UINT64 else f"{number}U"
    if number < -(2**31) or number >= 2**31:
        return f"INT64_C({number})" if number > -(2**63) else "INT64_MIN"
    return str(number) if number > -(2**31) else "(-2147483647 - 1)"


def _decimal(number: float, suffix: str) -> str:
    if math.isnan(number):
        return "NAN" if suffix else "(double)NAN"
    if math.isinf(number):
        return ("-" if number < 0 else "") + ("INFINITY" if suffix else "(double)INFINITY")
    mantissa, exponent = number.hex().split("p")
    return f"{mantissa.rstrip('0').rstrip('.')}p{exponent}{suffix}"


def spelled(name: str) -> str:
    """A name of Python as a part of a name of C."""
    plain = re.sub(r"_+", "_", "".join(letter if letter.isascii() and letter.isalnum() else "_" for letter in name)).strip("_")
    return plain if plain and not plain[0].isdigit() else f"n{plain}"


def identifier(name: str) -> str:
    """A name of Python as a local name of C."""
    return f"{spelled(name)}_" if spelled(name) in WORDS else spelled(name)


def comment(text: str) -> str:
    """Any text as what a comment of C may hold: one line, printable ASCII, nothing that ends it or that begins a trigraph."""
    shown = text.encode("ascii", "backslashreplace").decode()
    shown = "".join(letter if letter.isprintable() else " " for letter in shown)
    return shown.replace("*/", "* /").replace("/*", "/ *").replace("??", "? ?").replace("//", "/ /").rstrip("\\ ")
