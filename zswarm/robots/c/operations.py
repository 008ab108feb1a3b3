"""Operations of kernels as C99; every floating-point operation is a statement of its own.

A compiler may contract a product and a sum to one operation that rounds once (C99, 6.5 paragraph
8), but only within an expression. Constants are folded by the same operations in the same types.
"""

import ast
import operator
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from zswarm.errors import ConfigError
from zswarm.robots.c.c_file import CFile
from zswarm.robots.c.c_types import (
    BOOL,
    FLOAT32,
    FLOAT64,
    FLOATS,
    INT64,
    UNSIGNED,
    WHOLE,
    Array,
    LanesType,
    Scalar,
    convert,
    joined,
    literal,
    type_of,
)
from zswarm.robots.c.kernel_function import KernelFunction, quoted
from zswarm.robots.c.tree import Callee, CLine, Local, Value, like

# The operator in C, and the function that computes it here.
Sign = tuple[str, Callable[..., Any]]

SIGNS: dict[type[ast.AST], Sign] = {
    ast.Add: ("+", operator.add),
    ast.Sub: ("-", operator.sub),
    ast.Mult: ("*", operator.mul),
    ast.Div: ("/", np.divide),  # Python refuses to divide by 0
    ast.FloorDiv: ("//", operator.floordiv),
    ast.Mod: ("%", operator.mod),
    ast.BitAnd: ("&", operator.and_),
    ast.BitOr: ("|", operator.or_),
    ast.BitXor: ("^", operator.xor),
    ast.LShift: ("<<", operator.lshift),
    ast.RShift: (">>", operator.rshift),
    ast.Lt: ("<", operator.lt),
    ast.LtE: ("<=", operator.le),
    ast.Gt: (">", operator.gt),
    ast.GtE: (">=", operator.ge),
    ast.Eq: ("==", operator.eq),
    ast.NotEq: ("!=", operator.ne),
}
NEUTRAL = {"+": 0, "-": 0, "*": 1}  # operands that change no whole number
BITWISE = ("&", "|", "^", "<<", ">>")
DIVISIONS = ("//", "%")  # Python rounds the quotient down, C to 0


@dataclass
class Operations:
    """The state of one function's translation for given types of its arguments; operations."""

    file: CFile
    source: KernelFunction
    # Translates a function.
    callee: Callable[["Operations", Any, Sequence[Value]], Callee]
    names: set[str]  # all that the Python source uses
    node: ast.AST = field(default_factory=ast.Pass)  # that is being translated
    constants: dict[str, Value] = field(default_factory=dict)
    locals: dict[str, Local] = field(default_factory=dict)
    lines: list[CLine] = field(default_factory=list)
    # Python names of arrays that it changes.
    written: set[str] = field(default_factory=set)
    lane: str = "lane"  # the counter in loops over lanes
    made: int = 0  # locals without a name in Python

    def error(self, text: str = "") -> ConfigError:
        """Return the error about the construct that is being translated."""
        return self.source.error(self.node, text or quoted(self.node))

    def constant(self, value: Any) -> Value:
        """Return a number, or a table of numbers."""
        if isinstance(value, tuple | list) and len({type(each) for each in value}) == 1:
            value = np.array(value)
        kind = type_of(value)
        if kind is None:
            raise self.error(f"{quoted(self.node)}, of type {type(value).__name__}")
        if isinstance(kind, Array):
            hint = ast.unparse(self.node).split(".")[-1]
            return Value(kind, self.file.table(hint, value), value)
        if kind in WHOLE and not -(1 << 63) <= int(value) < 1 << 64:
            raise self.error(f"{value}, which has more than 64 bits")
        text = literal(value)
        return Value(kind, text, value, loose=text.startswith("-"))

    def new(self, hint: str) -> str:
        """Return an unused name for a local."""
        self.made += 1
        while f"{hint}{self.made}" in self.names:
            self.made += 1
        return f"{hint}{self.made}"

    @contextmanager
    def captured(self) -> Iterator[list[CLine]]:
        """Collect the lines that are made in the block apart from the others."""
        outer, self.lines = self.lines, []
        yield self.lines
        self.lines = outer

    def emit(
        self, text: str, body: list[CLine] | None = None, sets: str = "", **how: bool
    ) -> None:
        """Add a line; see ``CLine``."""
        self.lines.append(CLine(text, body, sets, **how))

    def named(self, value: Value, *, once: bool = False) -> Value:
        """Give a value a name: a statement of its own."""
        name = self.new("t")
        self.emit(f"const {value.element.c} {name} = {value.text};", sets=name, once=once)
        return value._replace(text=name, loose=False)

    def apart(self, value: Value) -> Value:
        """Return a floating-point operation as a statement of its own."""
        return self.named(value, once=True)

    # ---- arithmetic ------------------------------------------------------------------------------

    def cast(self, value: Value, to: Scalar) -> Value:
        """Convert a number to another type as numba does."""
        if value.element == to:
            return value
        if value.element is None:
            raise self.error(f"{value.type} as {to.name}")
        if value.constant is not None:
            return self.constant(convert(value.constant, to))
        if value.loose and to != BOOL:
            # MISRA C, rule 10.8: no cast of a composite expression.
            value = self.named(value)
        text = f"{value.operand} != 0" if to == BOOL else f"({to.c}){value.operand}"
        return value._replace(type=like(to, value), text=text, loose=to == BOOL)

    def operation(self, sign: Sign, left: Value, right: Value) -> Value:
        """Translate ``left + right`` and its like; also ``&`` and ``|`` of conditions."""
        symbol, function = sign
        of = self._joined(symbol, left, right)
        if of == BOOL and symbol in ("&", "|"):
            return _binary(BOOL, symbol * 2, left, right)
        if of == BOOL or (symbol in BITWISE and of not in WHOLE):
            raise self._mismatch(symbol, left, right)
        if symbol in (*BITWISE, *DIVISIONS) and isinstance(
            like(of, left, right), LanesType
        ):
            raise self._mismatch(symbol, left, right)
        if symbol == "/" and of in WHOLE:
            of = FLOAT64
        left, right = self.cast(left, of), self.cast(right, of)
        if symbol in DIVISIONS:
            return self._division(sign, of, left, right)
        if (folded := self._folded(function, of, left, right)) is not None:
            return folded
        if of in FLOATS:
            return self.apart(_binary(of, symbol, left, right))
        return _whole(of, symbol, left, right)

    def _folded(
        self, function: Callable[..., Any], of: Scalar, left: Value, right: Value
    ) -> Value | None:
        """Return the constant that two constants give, else None."""
        if left.constant is None or right.constant is None:
            return None
        with np.errstate(all="ignore"):
            return self.constant(convert(function(left.constant, right.constant), of))

    def _joined(self, symbol: str, left: Value, right: Value) -> Any:
        of = joined(left.element, right.element)
        if of is None:
            raise self._mismatch(symbol, left, right)
        return of

    def _mismatch(self, symbol: str, left: Value, right: Value) -> ConfigError:
        return self.error(f"{left.type} {symbol} {right.type} in {quoted(self.node)}")

    def _division(self, sign: Sign, of: Scalar, left: Value, right: Value) -> Value:
        """Translate quotients and remainders."""
        symbol, function = sign
        folded = None if right.constant == 0 else self._folded(function, of, left, right)
        if folded is not None:
            return folded
        if of in UNSIGNED:
            return _binary(of, symbol[0], left, right)
        if of == FLOAT64 and symbol == "%":
            return self.apart(
                Value(of, f"{self.file.library('rest')}({left.text}, {right.text})")
            )
        if of != INT64:
            raise self._mismatch(symbol, left, right)
        name = self.file.library("floor_divide" if symbol == "//" else "floor_rest")
        return Value(of, f"{name}({left.text}, {right.text})")

    # ---- conditions ------------------------------------------------------------------------------

    def truth(self, value: Value) -> Value:
        """Return a number as a condition."""
        if not isinstance(value.type, Scalar):
            raise self.error(f"{value.type} as a condition")
        return self.cast(value, BOOL)

    def negated(self, value: Value) -> Value:
        """Translate ``not value``."""
        truth = self.truth(value)
        if truth.constant is not None:
            return self.constant(not truth.constant)
        return Value(BOOL, f"!({truth.text})")

    def compared(self, sign: Sign, left: Value, right: Value) -> Value:
        """Translate ``left < right`` and its like, also in lanes."""
        symbol, function = sign
        of = self._joined(symbol, left, right)
        is_single = _is_single(left.constant) or _is_single(right.constant)
        if of == FLOAT64 and FLOAT32 in (left.element, right.element) and is_single:
            of = FLOAT32
        left, right = self.cast(left, of), self.cast(right, of)
        return self._folded(function, BOOL, left, right) or _binary(
            BOOL, symbol, left, right
        )

    def all_of(self, symbol: str, parts: list[Value]) -> Value:
        """Join conditions by ``&&`` or ``||``; omit constants that decide nothing."""
        decides = symbol == "||"  # the constant after which the others do not matter
        remaining: list[Value] = []
        for part in parts:
            if part.constant is None or part.constant == decides:
                remaining.append(part)
            if part.constant == decides:
                break
        if not remaining:
            return self.constant(not decides)
        if len(remaining) == 1:
            return remaining[0]
        if any(isinstance(part.type, LanesType) for part in remaining):
            raise self.error("a condition of lanes; use `&` and `select`")
        return Value(
            BOOL, f" {symbol} ".join(part.operand for part in remaining), loose=True
        )

    def common(self, yes: Value, no: Value) -> Any:
        """Return the type of a choice between two numbers."""
        of = joined(yes.type, no.type)
        if not isinstance(of, Scalar):
            raise self.error(f"a choice between {yes.type} and {no.type}")
        return of


def _whole(of: Scalar, symbol: str, left: Value, right: Value) -> Value:
    """Return an operation on whole numbers, without an operand that changes nothing."""
    if symbol in NEUTRAL and right.constant == NEUTRAL[symbol]:
        return left
    if symbol in ("+", "*") and left.constant == NEUTRAL[symbol]:
        return right
    return _binary(of, symbol, left, right)


def _binary(of: Scalar, symbol: str, left: Value, right: Value) -> Value:
    text = f"{left.operand} {symbol} {right.operand}"
    return Value(like(of, left, right), text, loose=True, loads=left.loads or right.loads)


def _is_single(constant: Any) -> bool:
    """Return whether float32 holds a constant exactly: a comparison has the same result then."""
    return constant is not None and bool(float(convert(constant, FLOAT32)) == constant)
