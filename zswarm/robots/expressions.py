"""Expressions of kernels as C99: names, numbers of arrays, and calls."""

import ast
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from zswarm import jit, lanes
from zswarm.robots.c_types import (
    BOOL,
    FLOAT32,
    FLOAT64,
    FLOATS,
    INT64,
    SCALARS,
    UINT64,
    WHOLE,
    Array,
    Lanes,
    Scalar,
    convert,
    type_of,
)
from zswarm.robots.operations import SIGNS, Operations
from zswarm.robots.pieces import Value, alike, element, scalar, shown, tight

BUILTINS = {"int": int, "float": float, "bool": bool, "abs": abs, "min": min, "max": max, "len": len, "range": range}


@dataclass
class Expressions(Operations):
    """The expressions of one function, translated for given types of its arguments."""

    def value(self, node: ast.expr) -> Value:
        """An expression."""
        match node:
            case ast.Constant(value=value) if type_of(value) is not None:
                return self.constant(node, value)
            case ast.Name(id=name):
                return self.named(node, name)
            case ast.BinOp(left=left, op=op, right=right) if type(op) in SIGNS:
                return self.operation(node, SIGNS[type(op)], self.value(left), self.value(right))
            case ast.UnaryOp():
                return self.unary(node)
            case ast.Compare():
                return self.comparison(node)
            case ast.BoolOp():
                return self.logic(node)
            case ast.IfExp():
                return self.choice(node)
            case ast.Subscript():
                return self.numbered(node)
            case ast.Attribute():
                return self.constant(node, self.known(node))
            case ast.Call():
                return self.call(node)
        raise self.refusal(node, f"`{ast.unparse(node):.60}`")

    def known(self, node: ast.expr) -> Any:
        """What a name, or a name of a module, stands for where the function was written."""
        if isinstance(node, ast.Name):
            if node.id in self.globals:
                return self.globals[node.id]
            if node.id in BUILTINS:
                return BUILTINS[node.id]
        if isinstance(node, ast.Attribute):
            owner = self.known(node.value)
            if hasattr(owner, node.attr):
                return getattr(owner, node.attr)
        raise self.refusal(node, f"`{ast.unparse(node):.60}` is not known")

    def named(self, node: ast.expr, name: str) -> Value:
        """A variable, an argument, or a constant of the module."""
        if name in self.constants:
            return self.constants[name]
        if name in self.locals:
            local = self.locals[name]
            in_lane = isinstance(local.type, Lanes)
            return Value(local.type, f"{local.name}[{self.lane}]" if in_lane else local.name)
        return self.constant(node, self.known(node))

    # ---- arrays -------------------------------------------------------------------------------------------------

    def numbered(self, node: ast.Subscript) -> Value:
        """A number of an array; the length, of ``shape``."""
        match node.value, node.slice:
            case ast.Attribute(value=owner, attr="shape"), ast.Constant(value=0):
                return self.length(node, self.value(owner))
        array, place = self.value(node.value), self.place(node.slice)
        if not isinstance(array.type, Array):
            raise self.refusal(node, f"`{ast.unparse(node):.60}` of {shown(array.type)}")
        if array.constant is not None and place.constant is not None:
            if not 0 <= int(place.constant) < len(array.constant):
                raise self.refusal(node, f"`{ast.unparse(node):.60}`: number {int(place.constant)} of {len(array.constant)}")
            value = array.constant[int(place.constant)]
            return self.constant(node, value if array.type.element == FLOAT32 else value.item())
        return Value(array.type.element, f"{array.text}[{place.text}]")

    def place(self, node: ast.expr) -> Value:
        """A whole number, as a place in an array."""
        place = self.value(node)
        if place.type not in WHOLE or place.type == BOOL or (place.constant is not None and place.constant < 0):
            raise self.refusal(node, f"`{ast.unparse(node):.60}` as a place in an array")
        return place

    def length(self, node: ast.AST, owner: Value) -> Value:
        """How many numbers an array has."""
        if not isinstance(owner.type, Array) or owner.type.length is None:
            raise self.refusal(node, f"`{ast.unparse(node):.60}`, for nobody said how long it is")
        return self.constant(node, owner.type.length)

    def slice(self, node: ast.Subscript) -> Value:
        """A part of an array, for a function that is called with it."""
        owner, cut = self.value(node.value), node.slice
        if not isinstance(owner.type, Array) or not isinstance(cut, ast.Slice) or cut.step is not None or cut.lower is None:
            raise self.refusal(node, f"`{ast.unparse(node):.60}`")
        begin, length = self.place(cut.lower), None
        match cut.upper:
            case ast.BinOp(left=left, op=ast.Add(), right=right) if ast.dump(left) == ast.dump(cut.lower):
                length = self.place(right).constant
            case ast.expr() if begin.constant is not None and (end := self.place(cut.upper).constant) is not None:
                length = end - begin.constant
        text = f"&{owner.text}[{begin.text}]"
        return Value(Array(owner.type.element, None if length is None else int(length)), text)

    # ---- calls --------------------------------------------------------------------------------------------------

    def call(self, node: ast.Call) -> Value:
        """A call that gives a value."""
        if node.keywords or any(isinstance(each, ast.Starred) for each in node.args):
            raise self.refusal(node, f"`{ast.unparse(node):.60}`: arguments are given by their place")
        if isinstance(node.func, ast.Attribute) and node.func.attr == "view" and len(node.args) == 1:
            return self.view(node, self.value(node.func.value), self.known(node.args[0]))
        function = self.known(node.func)
        name = _type_name(function)
        if name in SCALARS and len(node.args) == 1:
            return self.cast(node, self.value(node.args[0]), SCALARS[name])
        if (special := SPECIAL.get(key(function))) is not None:
            return special(self, node, [self.value(each) for each in node.args])
        if not self.unit.is_own(function):
            raise self.refusal(node, f"`{ast.unparse(node.func):.60}`")
        value, changes = self.call_own(node, function)
        if changes:
            raise self.refusal(node, f"`{ast.unparse(node):.60}` changes arrays within an expression: give it a line")
        return value

    def call_own(self, node: ast.Call, function: Any) -> tuple[Value, bool]:
        """A call of another function of a kernel: its value, and whether it changes an array."""
        arguments = [
            self.slice(each) if isinstance(each, ast.Subscript) and isinstance(each.slice, ast.Slice) else self.value(each)
            for each in node.args
        ]
        in_lanes = any(isinstance(each.type, Lanes) for each in arguments)
        if in_lanes and any(isinstance(each.type, Array) for each in arguments):
            raise self.refusal(node, f"`{ast.unparse(node):.60}`: lanes and arrays together")
        given = [each._replace(type=scalar(each)) if isinstance(each.type, Lanes) else each for each in arguments]
        callee = self.unit.function(self, node, function, given)
        for index in callee.writes:
            self.change(node.args[index], given[index])
        of: Any = callee.result
        if in_lanes:
            if not isinstance(of, Scalar):
                raise self.refusal(node, f"`{ast.unparse(node):.60}`, which gives no lanes")
            of = Lanes(of)
        text = f"{callee.name}({', '.join(given[index].text for index in callee.takes)})"
        value = Value(of, text, loads=any(each.loads for each in arguments))
        return (self.apart(value) if element(value) in FLOATS and not callee.writes else value), bool(callee.writes)

    def change(self, node: ast.expr, array: Value) -> None:
        """Note that an array is written to."""
        name = node.value if isinstance(node, ast.Subscript) else node
        if not isinstance(name, ast.Name) or array.constant is not None or name.id in self.constants:
            raise self.refusal(node, f"`{ast.unparse(node):.60}`, a constant, is changed")
        self.written.add(name.id)

    def view(self, node: ast.Call, value: Value, as_: Any) -> Value:
        """The bits of a number as another one."""
        match value.type, _type_name(as_):
            case Scalar("uint64"), "float64":
                return Value(FLOAT64, f"{self.unit.library('double_of_bits')}({value.text})")
            case Scalar("float64"), "uint64":
                return Value(UINT64, f"{self.unit.library('bits_of_double')}({value.text})")
        raise self.refusal(node, f"`{ast.unparse(node):.60}`")

    # ---- what C or this file has for functions of Python, numpy and lanes.py --------------------------------------

    def absolute(self, node: ast.Call, arguments: list[Value]) -> Value:
        """``abs``."""
        (value,) = arguments
        of = element(value)
        if value.constant is not None:
            return self.constant(node, convert(abs(value.constant), scalar(value)))
        if of in FLOATS:
            self.unit.uses_math = True
            name = "fabs" if of == FLOAT64 else "fabsf"
            return value._replace(text=f"{name}({value.text})", loose=False)
        if value.type != INT64:
            raise self.refusal(node, f"`{ast.unparse(node):.60}`")
        return Value(INT64, f"({tight(value)} < 0) ? -{tight(value)} : {tight(value)}", loose=True)

    def extreme(self, node: ast.Call, arguments: list[Value], symbol: str) -> Value:
        """Python's min and max: a later one counts if it is truly less, or greater."""
        best = arguments[0]
        for other in arguments[1:]:
            of = self.common(node, best, other)
            best, value = self.cast(node, best, of), self.cast(node, other, of)
            if best.constant is not None and value.constant is not None:
                less = value.constant < best.constant if symbol == "<" else value.constant > best.constant
                best = value if less else best
                continue
            best, value = (
                each if each.constant is not None or each.text.isidentifier() else self.kept(each) for each in (best, value)
            )
            best = Value(of, f"({tight(value)} {symbol} {tight(best)}) ? {tight(value)} : {tight(best)}", loose=True)
        return best

    def root(self, node: ast.Call, arguments: list[Value]) -> Value:
        """``sqrt``."""
        (value,) = arguments
        of = element(value)
        if of not in FLOATS:
            raise self.refusal(node, f"the square root of {shown(value.type)}")
        self.unit.uses_math = True
        return self.apart(value._replace(text=f"{'sqrt' if of == FLOAT64 else 'sqrtf'}({value.text})", constant=None))

    def is_nan(self, node: ast.Call, arguments: list[Value]) -> Value:
        """Whether it is no number."""
        (value,) = arguments
        if element(value) not in FLOATS:
            raise self.refusal(node, f"`{ast.unparse(node):.60}`")
        return Value(alike(BOOL, value), f"{tight(value)} != {tight(value)}", loose=True, loads=value.loads)

    def select(self, node: ast.Call, arguments: list[Value]) -> Value:
        """``lanes.select``; C does not compute the other one, which makes no difference."""
        test, yes, no = arguments
        if element(test) != BOOL or element(yes) != element(no):
            raise self.refusal(node, f"`{ast.unparse(node):.60}`: choose by a condition, between numbers of one type")
        if isinstance(test.type, Scalar) and test.constant is not None:
            return yes if test.constant else no
        kind = alike(scalar(yes), test, yes, no)
        text = f"{tight(test)} ? {tight(yes)} : {tight(no)}"
        return Value(kind, text, loose=True, loads=any(each.loads for each in arguments))

    def fill(self, _: ast.Call, arguments: list[Value]) -> Value:
        """``lanes.fill``."""
        (value,) = arguments
        return value._replace(type=Lanes(scalar(value)), constant=None)

    def load(self, node: ast.Call, arguments: list[Value]) -> Value:
        """``lanes.load``."""
        array, at = arguments
        if not isinstance(array.type, Array) or at.type not in WHOLE:
            raise self.refusal(node, f"`{ast.unparse(node):.60}`")
        text = self.lane if at.constant == 0 else f"{_sum(at)} + {self.lane}"
        return Value(Lanes(array.type.element), f"{array.text}[{text}]", loads=array.constant is None)


def _sum(value: Value) -> str:
    """A place, to add to: sums and products need no brackets there."""
    return value.text if not value.loose or not set(value.text) & set("?:<>=&|!,") else f"({value.text})"


def _type_name(value: Any) -> str:
    """What a type of Python, numpy or numba is called here."""
    if value in (int, float, bool):
        return {int: "int64", float: "float64", bool: "bool"}[value]
    name = value.__name__ if isinstance(value, type) else str(value) if type(value).__module__.startswith("numba") else ""
    return "bool" if name in ("bool_", "boolean") else name


def key(function: Any) -> int:
    """By which ``SPECIAL`` knows a function."""
    return id(getattr(function, "py_func", function))


SPECIAL: dict[int, Callable[[Expressions, ast.Call, list[Value]], Value]] = {
    key(abs): Expressions.absolute,
    key(np.abs): Expressions.absolute,
    key(min): lambda self, node, values: self.extreme(node, values, "<"),
    key(max): lambda self, node, values: self.extreme(node, values, ">"),
    key(len): lambda self, node, values: self.length(node, values[0]),
    key(np.sqrt): Expressions.root,
    key(jit.sqrt): Expressions.root,
    key(np.isnan): Expressions.is_nan,
    key(lanes.select): Expressions.select,
    key(lanes.fill): Expressions.fill,
    key(lanes.load): Expressions.load,
}
