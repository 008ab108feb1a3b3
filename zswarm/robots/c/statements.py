"""Statements of kernels as C99: variables are declared late, lanes are loops."""

import ast
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from zswarm.kernels import lanes
from zswarm.kernels.lanes import LANES
from zswarm.robots.c import intrinsics
from zswarm.robots.c.c_file import free
from zswarm.robots.c.c_types import (
    INT64,
    NOTHING,
    Array,
    LanesType,
    Scalar,
    StructType,
    Type,
    convert,
    identifier,
    joined,
    literal,
)
from zswarm.robots.c.expressions import Expressions
from zswarm.robots.c.kernel_function import names_in, quoted
from zswarm.robots.c.scopes import Scope, assigned
from zswarm.robots.c.tree import CLine, Local, Value, inline


@dataclass(kw_only=True)
class Statements(Expressions):
    """The body of one function."""

    scope: Scope
    arguments: set[str]
    declared: set[str] = field(default_factory=set)
    result: Any = NOTHING  # a Scalar or StructType

    def block(self, body: Sequence[ast.stmt]) -> bool:
        """Translate statements; return whether the last one ends the function."""
        for statement in body:
            self.node = statement
            for name in self.scope.before.get(id(statement), ()):
                if name in self.locals:
                    self._declare(name)
            if self._statement(statement):
                return True
        return False

    def _statement(self, node: ast.stmt) -> bool:
        """Translate a statement; return whether it ends the function."""
        match node:
            case (
                ast.Assign(targets=[target], value=value)
                | ast.AnnAssign(target=target, value=ast.expr() as value)
            ):
                self._assign(target, value)
            case ast.AugAssign(target=target, op=op, value=value):
                self._assign(
                    target, ast.copy_location(ast.BinOp(target, op, value), node)
                )
            case ast.Expr(value=value):
                self._expression(value)
            case ast.Break() | ast.Continue():
                self.emit(f"{ast.unparse(node)};")
            case ast.For(target=ast.Name(id=counter), orelse=[]):
                self._for(node, counter)
            case ast.If():
                return self._if(node)
            case ast.While(orelse=[]):
                return self._while(node)
            case ast.Return(value=value):
                self._return(value)
                return True
            case ast.Pass():
                pass
            case _:
                raise self.error()
        return False

    # ---- assignments -----------------------------------------------------------------------------

    def _assign(self, target: ast.expr, expression: ast.expr) -> None:
        match target:
            case ast.Name(id=name):
                with self.captured() as made:
                    value = self.value(expression, may_change=True)
                self._set(name, value, made)
            case ast.Subscript():
                self._put(target, self.value(expression))
            case ast.Tuple(elts=targets):
                names = [each.id for each in targets if isinstance(each, ast.Name)]
                if len(names) != len(targets):
                    raise self.error(
                        f"{quoted(self.node)}: expected variables as targets"
                    )
                for name, value in zip(
                    names, self._values(names, expression), strict=True
                ):
                    self._set(name, value, [])
            case _:
                raise self.error()

    def _set(self, name: str, value: Value, made: list[CLine]) -> None:
        """Give a variable its value, after the lines that were made for it."""
        is_set_once = self.scope.sets[name] == 1
        if value.constant is not None and is_set_once:
            self.constants[name] = value
            return
        if value.element is None:
            raise self.error(f"`{name}`: {value.type} as a variable")
        local = self._local(name, value.type)
        declares = name in self.scope.here and name not in self.declared
        if isinstance(local.type, LanesType):
            if declares:
                self._declare(name)
            text = inline(value, made)
            body = [*made, CLine(f"{local.name}[{self.lane}] = {text};")]
            self.lines.append(self._lane_loop(body, local.name))
            return
        self.lines += made
        number = self.cast(value, local.type)
        text = f"{local.name} = {inline(number, self.lines)};"
        self.declared.add(name)
        if declares:
            text = f"{'const ' if is_set_once else ''}{local.type.c} {text}"
        self.emit(text, sets=local.name, changes=value.changes)

    def _lane_loop(self, body: list[CLine], sets: str = "") -> CLine:
        return CLine(
            f"for (int {self.lane} = 0; {self.lane} < {LANES}; {self.lane}++)", body, sets
        )

    def _local(self, name: str, kind: Type) -> Local:
        """Return the local for a variable, of a type that also holds its earlier values."""
        if name not in self.locals:
            self.locals[name] = Local(kind, self._free(name))
        local = self.locals[name]
        both = joined(local.type, kind)
        if both is None or (name in self.arguments and both != local.type):
            raise self.error(f"`{name}` changes its type")
        local.type = both
        return local

    def _free(self, name: str) -> str:
        """Return a name that no local has."""
        taken = {local.name for local in self.locals.values()}
        return free(identifier(name), taken | {self.lane})

    def _declare(self, name: str) -> None:
        """Declare a variable with a value: compilers warn of variables that may have none."""
        local, size = self.locals[name], ""
        self.declared.add(name)
        of = Value(local.type, local.name).element
        text = literal(convert(0, of))
        if isinstance(local.type, LanesType):
            size, text = f"[{LANES}]", f"{{{', '.join([text] * LANES)}}}"
        self.emit(f"{of.c} {local.name}{size} = {text};", sets=local.name)

    def _values(self, names: list[str], expression: ast.expr) -> list[Value]:
        """Translate the values that a tuple of variables is set to."""
        match expression:
            case ast.Tuple(elts=parts) if len(parts) == len(names):
                return self._parts(names, parts)
            case ast.Call():
                return self._members(self.value(expression, may_change=True), len(names))
        raise self.error()

    def _parts(self, names: list[str], parts: list[ast.expr]) -> list[Value]:
        values = [self.value(part) for part in parts]
        if any(isinstance(value.type, LanesType) for value in values):
            raise self.error(f"{quoted(self.node)}: lanes need a line each")
        for index, part in enumerate(parts):
            if names_in(part) & set(names[:index]):  # overwritten before it is read
                values[index] = self._stable(values[index])
        return values

    def _members(self, value: Value, count: int) -> list[Value]:
        of = value.type
        if not isinstance(of, StructType) or len(of.of) != count:
            text = f"expected a call that returns {count} values"
            raise self.error(f"{quoted(self.node)}: {text}")
        name = self.new("t")
        text = f"const {of.c} {name} = {value.text};"
        self.emit(text, sets=name, changes=value.changes)
        members = zip(of.of, of.names, strict=True)
        return [Value(type_, f"{name}.{member}") for type_, member in members]

    def _stable(self, value: Value) -> Value:
        """Return a number to read later, when its variables may have changed."""
        if value.constant is not None or not isinstance(value.type, Scalar):
            return value
        variables = {local.name for local in self.locals.values()}
        is_fixed = value.text.isidentifier() and value.text not in variables
        return value if is_fixed else self.named(value)

    def _put(self, target: ast.Subscript, value: Value) -> None:
        """Set an element of an array."""
        array, index = self.value(target.value), self.index(target.slice)
        if not isinstance(array.type, Array):
            raise self.error(f"{quoted(target)} is assigned to")
        self.change(target.value)
        if not isinstance(value.type, Scalar):
            raise self.error("lanes in one element of an array; use `store`")
        text = inline(self.cast(value, array.type.element), self.lines)
        self.emit(f"{array.operand}[{index.text}] = {text};")

    def _expression(self, node: ast.expr) -> None:
        """Translate an expression for its effect: a call, or nothing for a docstring."""
        match node:
            case ast.Constant():
                return
            case ast.Call(func=func, args=[array, at, numbers]) if (
                self.known(func) is lanes.store
            ):
                self._store(array, at, numbers)
                return
        with self.captured() as made:
            value = self.effect(node)
        if value.changes:
            void = "" if value.type == NOTHING else "(void)"
            self.lines += made
            self.emit(f"{void}{value.text};")

    def _store(self, target: ast.expr, at: ast.expr, numbers: ast.expr) -> None:
        """Translate ``lanes.store``: all lanes are read first if they may be overwritten."""
        array, begin = self.value(target), self.index(at)
        if not isinstance(array.type, Array):
            raise self.error()
        self.change(target)
        with self.captured() as made:
            value = self.value(numbers)
        element = array.type.element
        if value.type != LanesType(element):
            raise self.error(f"{quoted(self.node)}: expected lanes of {element}")
        place = intrinsics.load(self, array, begin).text
        text = inline(value, made)
        if value.loads:
            name = self.new("eight")
            copy = f"{name}[{self.lane}]"
            self.emit(f"{element.c} {name}[{LANES}];")
            self.lines.append(self._lane_loop([*made, CLine(f"{copy} = {text};")]))
            made, text = [], copy
        self.lines.append(self._lane_loop([*made, CLine(f"{place} = {text};")]))

    # ---- branches and loops ----------------------------------------------------------------------

    def _if(self, node: ast.If) -> bool:
        test = self.condition(node.test)
        if test.constant is not None:
            return self.block(node.body if test.constant else node.orelse)
        with self.captured() as first:
            ends = self.block(node.body)
        with self.captured() as second:
            ends_otherwise = self.block(node.orelse)
        if first or second:
            self.emit(f"if ({test.text})", first)
        if second:
            self.emit("else", second)
        return ends and ends_otherwise

    def _for(self, node: ast.For, name: str) -> None:
        begin, end, step = self._range(node)
        if name in assigned(ast.Module(node.body, [])):
            raise self.error(f"`{name}`, which counts a loop, is assigned to")
        counter, outer = self._free(name), self.locals.get(name)
        self.locals[name] = Local(INT64, counter)
        with self.captured() as made:
            self.block(node.body)
        # After the loop C's counter has another value than Python's.
        del self.locals[name]
        if outer is not None:
            self.locals[name] = outer
        change = "++" if step == 1 else f" += {step}" if step > 0 else f" -= {-step}"
        test = f"{counter} {'<' if step > 0 else '>'} {end}"
        self.emit(f"for (int64_t {counter} = {begin}; {test}; {counter}{change})", made)

    def _range(self, node: ast.For) -> tuple[str, str, int]:
        """Return begin, end and step of a loop."""
        match node.iter:
            case ast.Call(func=func, args=args, keywords=[]) if self.known(func) is range:
                bounds = [
                    self.cast(self.whole(each, "a bound of a loop"), INT64)
                    for each in args
                ]
            case _:
                raise self.error(f"a loop over {quoted(node.iter)}; use range")
        begin, end = bounds[:2] if len(bounds) > 1 else [self.constant(0), bounds[0]]
        step = bounds[2].constant if len(bounds) > 2 else 1
        if not step:
            raise self.error(
                f"the step of {quoted(node.iter)}; expected a constant but 0"
            )
        is_plain = not end.loose and "(" not in end.text
        if not is_plain or names_in(node.iter) & set(assigned(node)):
            end = self._stable(end)
        return begin.text, end.text, step

    def _while(self, node: ast.While) -> bool:
        with self.captured() as made:
            test = self.condition(node.test)
        if test.constant is False:
            return False
        with self.captured() as body:
            self.block(node.body)
        if test.constant is True:
            self.emit("for (;;)", body)
            return not any(isinstance(each, ast.Break) for each in ast.walk(node))
        if made:
            leave = CLine(f"if (!({test.text}))", [CLine("break;")])
            self.emit("for (;;)", [*made, leave, *body])
        else:
            self.emit(f"while ({test.text})", body)
        return False

    # ---- results ---------------------------------------------------------------------------------

    def _return(self, expression: ast.expr | None) -> None:
        match expression:
            case None | ast.Constant(value=None):
                self.emit("return;")
            case ast.Tuple(elts=parts):
                self._return_tuple(parts)
            case _:
                value = self.value(expression, may_change=True)
                if not isinstance(value.type, Scalar):
                    raise self.error("a function that returns an array or lanes")
                self._returns(value.type)
                self.emit(f"return {inline(self.cast(value, self.result), self.lines)};")

    def _returns(self, of: Type) -> None:
        """Join the type of a result with those before."""
        self.result = of if self.result == NOTHING else joined(self.result, of)
        if self.result is None:
            raise self.error("a function that returns values of different types")

    def _return_tuple(self, parts: list[ast.expr]) -> None:
        values = [self.value(each) for each in parts]
        names = [each.id if isinstance(each, ast.Name) else "" for each in parts]
        of = tuple(value.type for value in values if isinstance(value.type, Scalar))
        if len(of) != len(values):
            raise self.error("a function that returns arrays or lanes")
        struct = self.result
        if not isinstance(struct, StructType) or struct.of != of:
            members = tuple(
                identifier(name) if name and names.count(name) == 1 else f"n{at}"
                for at, name in enumerate(names)
            )
            struct = self.file.struct(self.source.name, of, members)
        self._returns(struct)
        result = self.new("t")
        self.emit(f"{struct.c} {result};")
        for member, value in zip(struct.names, values, strict=True):
            self.emit(f"{result}.{member} = {value.text};")
        self.emit(f"return {result};")
