"""Expressions of kernels as C99."""

import ast
import inspect
from dataclasses import dataclass
from typing import Any

from zswarm.kernels import lanes
from zswarm.robots.c import intrinsics
from zswarm.robots.c.c_types import (
    BOOL,
    FLOAT32,
    FLOATS,
    NOTHING,
    SCALARS,
    UNSIGNED,
    WHOLE,
    Array,
    LanesType,
    Scalar,
    convert,
    type_of,
)
from zswarm.robots.c.kernel_function import plain, quoted
from zswarm.robots.c.operations import SIGNS, Operations
from zswarm.robots.c.tree import CLine, Value

BUILTINS = {each.__name__: each for each in (int, float, bool, abs, min, max, len, range)}


@dataclass
class Expressions(Operations):
    """The expressions of one function."""

    def value(self, node: ast.expr, *, may_change: bool = False) -> Value:
        """Translate an expression.

        Args:
            may_change: a call in it may change arrays.
        """
        value = self.effect(node)
        if value.type == NOTHING:
            raise self.error(f"{quoted(node)}, which returns nothing")
        if value.changes and not may_change:
            raise self.error(
                f"{quoted(node)} changes arrays within an expression: give it a line"
            )
        return value

    def effect(self, node: ast.expr) -> Value:
        """Translate an expression that may also change arrays or return nothing."""
        outer, self.node = self.node, node
        value = self._translated(node)
        self.node = outer
        return value

    def _translated(self, node: ast.expr) -> Value:
        match node:
            case ast.Constant(value=value) if type_of(value) is not None:
                return self.constant(value)
            case ast.Name(id=name) if name in self.constants:
                return self.constants[name]
            case ast.Name(id=name) if name in self.locals:
                local = self.locals[name]
                in_lane = isinstance(local.type, LanesType)
                return Value(
                    local.type, f"{local.name}[{self.lane}]" if in_lane else local.name
                )
            case ast.Name() | ast.Attribute():
                return self.constant(self.known(node))
            case ast.BinOp(left=left, op=op, right=right) if type(op) in SIGNS:
                return self.operation(
                    SIGNS[type(op)], self.value(left), self.value(right)
                )
            case ast.UnaryOp():
                return self._unary(node)
            case ast.Compare(ops=ops) if all(type(op) in SIGNS for op in ops):
                return self._comparison(node)
            case ast.BoolOp():
                return self._logic(node)
            case ast.IfExp():
                return self._choice(node)
            case ast.Subscript():
                return self._element(node)
            case ast.Call():
                return self._call(node)
        raise self.error()

    def known(self, node: ast.expr) -> Any:
        """Return what a name, or a name in a module, stands for in Python."""
        match node:
            case ast.Name(id=name) if name in self.source.globals:
                return self.source.globals[name]
            case ast.Name(id=name) if name in BUILTINS:
                return BUILTINS[name]
            case ast.Attribute(value=owner, attr=name):
                module = self.known(owner)
                if hasattr(module, name):
                    return getattr(module, name)
        raise self.error(f"{quoted(node)} is not known")

    def condition(self, node: ast.expr) -> Value:
        """Translate an expression as a condition."""
        return self.truth(self.value(node))

    # ---- operators -------------------------------------------------------------------------------

    def _unary(self, node: ast.UnaryOp) -> Value:
        value = self.value(node.operand)
        of = value.element
        if isinstance(node.op, ast.Not):
            return self.negated(value)
        if not isinstance(node.op, ast.USub) or of in (None, BOOL, *UNSIGNED):
            raise self.error(f"{quoted(node)} of {value.type}")
        if value.constant is not None:
            return self.constant(convert(-value.constant, of))
        return value._replace(text=f"-{value.operand}", loose=True)

    def _comparison(self, node: ast.Compare) -> Value:
        values = [self.value(each) for each in (node.left, *node.comparators)]
        pairs = zip(node.ops, values, values[1:], strict=False)
        parts = [self.compared(SIGNS[type(op)], left, right) for op, left, right in pairs]
        return self.all_of("&&", parts)

    def _logic(self, node: ast.BoolOp) -> Value:
        """Translate ``and`` and ``or``: statements of a later operand run only where it counts."""
        symbol = "&&" if isinstance(node.op, ast.And) else "||"
        parts = [self.condition(node.values[0])]
        for each in node.values[1:]:
            with self.captured() as made:
                part = self.condition(each)
            first = self.all_of(symbol, parts)
            if not made or first.constant is not None:
                self.lines += made
                parts.append(part)
                continue
            name = self.new("t")
            self.emit(f"bool {name} = {first.text};", sets=name)
            made.append(CLine(f"{name} = {part.text};", sets=name))
            self.emit(f"if ({'' if symbol == '&&' else '!'}{name})", made)
            parts = [Value(BOOL, name)]
        return self.all_of(symbol, parts)

    def _choice(self, node: ast.IfExp) -> Value:
        test = self.condition(node.test)
        if test.constant is not None:
            return self.value(node.body if test.constant else node.orelse)
        with self.captured() as first:
            yes = self.value(node.body)
        with self.captured() as second:
            no = self.value(node.orelse)
        of = self.common(yes, no)
        yes, no = self.cast(yes, of), self.cast(no, of)
        if not first and not second:
            return Value(of, f"{test.operand} ? {yes.operand} : {no.operand}", loose=True)
        name = self.new("t")
        self.emit(f"{of.c} {name};", sets=name)
        self.emit(
            f"if ({test.text})", [*first, CLine(f"{name} = {yes.text};", sets=name)]
        )
        self.emit("else", [*second, CLine(f"{name} = {no.text};", sets=name)])
        return Value(of, name)

    # ---- arrays ----------------------------------------------------------------------------------

    def _element(self, node: ast.Subscript) -> Value:
        """Translate an element or a part of an array; of ``shape``, the array's length."""
        match node.value, node.slice:
            case ast.Attribute(value=owner, attr="shape"), ast.Constant(value=0):
                return intrinsics.length(self, self.value(owner))
        array = self.value(node.value)
        if not isinstance(array.type, Array):
            raise self.error(f"{quoted(node)} of {array.type}")
        if isinstance(node.slice, ast.Slice):
            return self._slice(array, array.type.element, node.slice)
        index = self.index(node.slice)
        if array.constant is None or index.constant is None:
            return Value(array.type.element, f"{array.operand}[{index.text}]")
        at, size = int(index.constant), len(array.constant)
        if at >= size:
            raise self.error(f"{quoted(node)}: index {at} of {size} numbers")
        value = array.constant[at]
        return self.constant(value if array.type.element == FLOAT32 else value.item())

    def index(self, node: ast.expr) -> Value:
        """Translate an index, which may not be negative."""
        index = self.whole(node, "an index")
        if index.constant is not None and index.constant < 0:
            raise self.error(f"{quoted(node)} as an index")
        return index

    def whole(self, node: ast.expr, role: str) -> Value:
        """Translate a whole number."""
        value = self.value(node)
        if value.type not in WHOLE or value.type == BOOL:
            raise self.error(f"{quoted(node)} as {role}")
        return value

    def _slice(self, array: Value, element: Scalar, cut: ast.Slice) -> Value:
        """Translate a part of an array that is passed to a function."""
        if cut.lower is None or cut.step is not None:
            raise self.error()
        begin, length = self.index(cut.lower), None
        match cut.upper:
            case ast.BinOp(left, ast.Add(), right) if ast.dump(left) == ast.dump(
                cut.lower
            ):
                length = self.index(right).constant
            case ast.expr() if begin.constant is not None:
                end = self.index(cut.upper).constant
                length = None if end is None else end - begin.constant
        of = Array(element, None if length is None else int(length))
        return Value(of, f"&{array.operand}[{begin.text}]", loose=True)

    # ---- calls -----------------------------------------------------------------------------------

    def _call(self, node: ast.Call) -> Value:
        if node.keywords or any(isinstance(each, ast.Starred) for each in node.args):
            raise self.error(f"{quoted(node)}: arguments are given by position")
        match node:
            case ast.Call(func=ast.Attribute(value=owner, attr="view"), args=[type_]):
                return intrinsics.view(self, self.value(owner), self.known(type_))
        function = plain(self.known(node.func))
        name = intrinsics.type_name(function)
        if name in SCALARS and len(node.args) == 1:
            return self.cast(self.value(node.args[0]), SCALARS[name])
        intrinsic = intrinsics.INTRINSICS.get(id(function))
        is_kernel = inspect.isfunction(function) and function.__module__ != lanes.__name__
        if intrinsic is None and not is_kernel:
            raise self.error(quoted(node.func))
        arguments = [self.value(each) for each in node.args]
        if intrinsic is not None:
            return intrinsic(self, *arguments)
        return self._call_kernel(node, function, arguments)

    def _call_kernel(
        self, node: ast.Call, function: Any, arguments: list[Value]
    ) -> Value:
        kinds = {type(each.type) for each in arguments}
        in_lanes = LanesType in kinds
        if in_lanes and Array in kinds:
            raise self.error(f"{quoted(node)}: lanes and arrays together")
        if in_lanes:  # the function is called for each lane
            arguments = [each._replace(type=each.element) for each in arguments]
        callee = self.callee(self, function, arguments)
        for at in callee.writes:
            self.change(node.args[at])
        of = callee.result
        if in_lanes:
            if of == NOTHING or not isinstance(of, Scalar):
                raise self.error(f"{quoted(node)}, which returns no lanes")
            of = LanesType(of)
        texts = ", ".join(arguments[at].text for at in callee.takes)
        loads, changes = any(each.loads for each in arguments), bool(callee.writes)
        value = Value(of, f"{callee.name}({texts})", loads=loads, changes=changes)
        return self.apart(value) if value.element in FLOATS and not changes else value

    def change(self, node: ast.expr) -> None:
        """Note that an array, or a part of one, is written to."""
        name = node.value if isinstance(node, ast.Subscript) else node
        if not isinstance(name, ast.Name) or name.id not in self.locals:
            raise self.error(f"{quoted(node)}, a constant, is changed")
        self.written.add(name.id)
