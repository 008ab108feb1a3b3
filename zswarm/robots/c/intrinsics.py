"""Functions of Python, numpy and ``lanes.py`` that have their own form in C."""

from collections.abc import Callable
from typing import Any

import numpy as np

from zswarm.kernels import jit, lanes
from zswarm.robots.c.c_types import (
    BOOL,
    FLOAT64,
    FLOATS,
    INT64,
    UINT64,
    WHOLE,
    Array,
    LanesType,
    Scalar,
    convert,
)
from zswarm.robots.c.kernel_function import plain, quoted
from zswarm.robots.c.operations import Operations
from zswarm.robots.c.tree import Value, like

Intrinsic = Callable[..., Value]  # of the translation, and of the call's arguments


def length(to: Operations, owner: Value) -> Value:
    """Translate the length of an array."""
    if not isinstance(owner.type, Array) or owner.type.length is None:
        raise to.error(f"{quoted(to.node)}: expected an array of known length")
    return to.constant(owner.type.length)


def view(to: Operations, value: Value, type_: Any) -> Value:
    """Translate ``value.view(type)``: the bits of a number as another one."""
    match value.type, type_name(type_):
        case Scalar("uint64"), "float64":
            return Value(FLOAT64, f"{to.file.library('double_of_bits')}({value.text})")
        case Scalar("float64"), "uint64":
            return Value(UINT64, f"{to.file.library('bits_of_double')}({value.text})")
    raise to.error()


def type_name(value: Any) -> str:
    """Return the name of a type of Python, numpy or numba as ``SCALARS`` has it; "" for others."""
    is_numba = type(value).__module__.startswith("numba")
    name = value.__name__ if isinstance(value, type) else str(value) if is_numba else ""
    names = {"int": "int64", "float": "float64", "bool_": "bool", "boolean": "bool"}
    return names.get(name, name)


def load(to: Operations, array: Value, at: Value) -> Value:
    """Translate ``lanes.load``."""
    if not isinstance(array.type, Array) or at.type not in WHOLE:
        raise to.error()
    # Sums and products need no brackets before +.
    begin = at.operand if set(at.text) & set("?:<>=&|!,") else at.text
    text = to.lane if at.constant == 0 else f"{begin} + {to.lane}"
    loads = array.constant is None
    return Value(LanesType(array.type.element), f"{array.operand}[{text}]", loads=loads)


def _fill(_: Operations, value: Value) -> Value:
    return value._replace(type=LanesType(value.element), constant=None)


def _select(to: Operations, test: Value, yes: Value, no: Value) -> Value:
    """Translate ``lanes.select``; C computes only one side, which changes no result."""
    if test.element != BOOL or yes.element != no.element:
        raise to.error(
            f"{quoted(to.node)}: expected a condition and two numbers of one type"
        )
    if test.constant is not None:
        return yes if test.constant else no
    text = f"{test.operand} ? {yes.operand} : {no.operand}"
    loads = test.loads or yes.loads or no.loads
    return Value(like(yes.element, test, yes, no), text, loose=True, loads=loads)


def _absolute(to: Operations, value: Value) -> Value:
    if value.constant is not None:
        return to.constant(convert(abs(value.constant), value.element))
    if value.element in FLOATS:
        name = "fabs" if value.element == FLOAT64 else "fabsf"
        return value._replace(text=f"{name}({value.text})", loose=False)
    if value.type != INT64:
        raise to.error()
    text = value.operand
    return Value(INT64, f"({text} < 0) ? -{text} : {text}", loose=True)


def _extreme(symbol: str) -> Intrinsic:
    """Return Python's min or max: a later value counts only if it is less, or greater."""

    def extreme(to: Operations, best: Value, *others: Value) -> Value:
        for other in others:
            of = to.common(best, other)
            best, value = to.cast(best, of), to.cast(other, of)
            a, b = best.constant, value.constant
            if a is not None and b is not None:
                best = value if (b < a if symbol == "<" else b > a) else best
                continue
            best, value = _nameable(to, best), _nameable(to, value)
            test = f"({value.operand} {symbol} {best.operand})"
            best = Value(of, f"{test} ? {value.operand} : {best.operand}", loose=True)
        return best

    return extreme


def _nameable(to: Operations, value: Value) -> Value:
    """Return a value that may be read twice: a constant or a variable."""
    is_simple = value.constant is not None or value.text.isidentifier()
    return value if is_simple else to.named(value)


def _root(to: Operations, value: Value) -> Value:
    if value.element not in FLOATS:
        raise to.error(f"the square root of {value.type}")
    name = "sqrt" if value.element == FLOAT64 else "sqrtf"
    return to.apart(value._replace(text=f"{name}({value.text})", constant=None))


def _is_nan(to: Operations, value: Value) -> Value:
    if value.element not in FLOATS:
        raise to.error()
    text = f"{value.operand} != {value.operand}"
    return Value(like(BOOL, value), text, loose=True, loads=value.loads)


INTRINSICS: dict[int, Intrinsic] = {  # by the identity of the Python function
    id(plain(function)): intrinsic
    for function, intrinsic in (
        (abs, _absolute),
        (np.abs, _absolute),
        (min, _extreme("<")),
        (max, _extreme(">")),
        (len, length),
        (np.sqrt, _root),
        (jit.sqrt, _root),
        (np.isnan, _is_nan),
        (lanes.select, _select),
        (lanes.fill, _fill),
        (lanes.load, load),
    )
}
