"""Operations of kernels as C99: their types, constants folded, every floating-point operation a statement of its own.

A compiler may join a product and a sum to one operation that rounds once (C99, 6.5 paragraph 8); standards let it do so within
an expression only. What is constant is computed here, by the same operations in the same types.
"""

import ast
import operator
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from zswarm.errors import ConfigError
from zswarm.robots.c_types import (
    BOOL,
    FLOAT32,
    FLOAT64,
    FLOATS,
    INT64,
    UNSIGNED,
    WHOLE,
    Array,
    Lanes,
    Scalar,
    convert,
    joined,
    literal,
    type_of,
)
from zswarm.robots.pieces import Local, Piece, Value, alike, element, scalar, shown, tight

if TYPE_CHECKING:
    from zswarm.robots.translate import Translation

Sign = tuple[str, Callable[..., Any]]  # in C, and what computes it here

SIGNS: dict[type[ast.AST], Sign] = {
    ast.Add: ("+", operator.add),
    ast.Sub: ("-", operator.sub),
    ast.Mult: ("*", operator.mul),
    ast.Div: ("/", operator.truediv),
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
NEUTRAL = {"+": 0, "-": 0, "*": 1}  # which changes no whole number
BITWISE = ("&", "|", "^", "<<", ">>")


@dataclass
class Operations:
    """What is computed in one function, translated for given types of its arguments."""

    unit: "Translation"
    function: str  # its name in Python
    file: str
    first_line: int
    globals: dict[str, Any]
    names: set[str] = field(default_factory=set)  # of Python, that its body uses
    constants: dict[str, Value] = field(default_factory=dict)
    locals: dict[str, Local] = field(default_factory=dict)
    pieces: list[Piece] = field(default_factory=list)
    written: set[str] = field(default_factory=set)  # arrays that it changes, by their names in Python
    lane: str = ""  # the place among eight numbers, in loops over them
    made: int = 0  # locals that Python has no name for

    def refusal(self, node: ast.AST, text: str) -> ConfigError:
        """What cannot be translated, and where it stands."""
        line = self.first_line + getattr(node, "lineno", 1) - 1
        return ConfigError(f"{self.file}, line {line}: cannot be said in C: {text}")

    def value(self, node: ast.expr) -> Value:
        """An expression; a child knows them all."""
        raise NotImplementedError

    def constant(self, node: ast.AST, value: Any) -> Value:
        """A number that is known, or an array of such."""
        if isinstance(value, tuple | list) and len({type(each) for each in value}) == 1:
            value = np.array(value)
        kind = type_of(value)
        if kind is None:
            raise self.refusal(node, f"`{ast.unparse(node):.60}`, which is {type(value).__name__}")
        if isinstance(kind, Array):
            hint = ast.unparse(node).split(".")[-1]
            return Value(kind, self.unit.table(hint, value), value)
        if kind in WHOLE and not -(1 << 63) <= int(value) < 1 << 64:
            raise self.refusal(node, f"{value}, which has more than 64 bits")
        text = literal(value)
        if "NAN" in text or "INFINITY" in text:
            self.unit.uses_math = True
        return Value(kind, text, value, loose=text.startswith("-"))

    def new(self, hint: str) -> str:
        """A name that no other local has."""
        self.made += 1
        while f"{hint}{self.made}" in self.names:
            self.made += 1
        return f"{hint}{self.made}"

    @contextmanager
    def captured(self) -> Iterator[list[Piece]]:
        """Statements that are made meanwhile, apart."""
        outer, self.pieces = self.pieces, []
        made = self.pieces
        try:
            yield made
        finally:
            self.pieces = outer

    def incompatible(self, node: ast.AST, symbol: str, left: Value, right: Value) -> ConfigError:
        """Two types beside one operator that do not go together."""
        return self.refusal(node, f"{shown(left.type)} {symbol} {shown(right.type)} in `{ast.unparse(node):.60}`")

    # ---- arithmetic ---------------------------------------------------------------------------------------------

    def cast(self, node: ast.AST, value: Value, to: Scalar) -> Value:
        """A number in another type, as numba converts it."""
        of = value.type.element if isinstance(value.type, Lanes) else value.type
        if of == to:
            return value
        if not isinstance(of, Scalar):
            raise self.refusal(node, f"{shown(of)} as {to.name}")
        if value.constant is not None:
            return self.constant(node, convert(value.constant, to))
        target = Lanes(to) if isinstance(value.type, Lanes) else to
        if value.loose and to != BOOL:  # MISRA C, rule 10.8: what is computed has a name before it is of another type
            value = self.kept(value)
        if to == BOOL:
            return value._replace(type=target, text=f"{tight(value)} != 0", loose=True)
        return value._replace(type=target, text=f"({to.c}){tight(value)}", loose=False)

    def operation(self, node: ast.AST, sign: Sign, left: Value, right: Value) -> Value:
        """Two numbers, or lanes of them, with an operator between."""
        symbol, function = sign
        both = element(left), element(right)
        if both[0] is None or both[1] is None:
            raise self.incompatible(node, symbol, left, right)
        if symbol in BITWISE:
            return self.bitwise(node, sign, left, right)
        of = joined(both[0], both[1])
        if of is None or of == BOOL:
            raise self.incompatible(node, symbol, left, right)
        if symbol == "/" and of in WHOLE:
            of = FLOAT64
        if symbol in ("//", "%"):
            return self.division(node, sign, self.cast(node, left, of), self.cast(node, right, of))
        left, right = self.cast(node, left, of), self.cast(node, right, of)
        if left.constant is not None and right.constant is not None:
            with np.errstate(all="ignore"):
                if symbol == "/":  # Python refuses to divide by 0
                    return self.constant(node, convert(np.divide(left.constant, right.constant), of))
                return self.constant(node, convert(function(left.constant, right.constant), of))
        if of in WHOLE and right.constant == NEUTRAL.get(symbol, right.text):
            return left
        if of in WHOLE and symbol != "-" and left.constant == NEUTRAL.get(symbol, left.text):
            return right
        text = f"{tight(left)} {symbol} {tight(right)}"
        value = Value(alike(of, left, right), text, loose=True, loads=left.loads or right.loads)
        return self.apart(value) if of in FLOATS else value

    def apart(self, value: Value) -> Value:
        """A floating-point operation as a statement of its own."""
        name = self.new("t")
        self.pieces.append(Piece(f"const {scalar(value).c} {name} = {value.text};", sets=name, once=True))
        return value._replace(text=name, loose=False)

    def kept(self, value: Value) -> Value:
        """A value that is read more than once, or later than what it is made of may change."""
        if value.text.isidentifier() and value.text not in {local.name for local in self.locals.values()}:
            return value
        name = self.new("t")
        self.pieces.append(Piece(f"const {scalar(value).c} {name} = {value.text};", sets=name))
        return value._replace(text=name, loose=False)

    def bitwise(self, node: ast.AST, sign: Sign, left: Value, right: Value) -> Value:
        """Bits of whole numbers; conditions, also of lanes."""
        symbol, function = sign
        of = joined(scalar(left), scalar(right))
        if of == BOOL and symbol in ("&", "|"):
            text = f"{tight(left)} {symbol * 2} {tight(right)}"
            return Value(alike(BOOL, left, right), text, loose=True, loads=left.loads or right.loads)
        if of not in WHOLE or of == BOOL or isinstance(alike(of, left, right), Lanes):
            raise self.incompatible(node, symbol, left, right)
        left, right = self.cast(node, left, of), self.cast(node, right, of)
        if left.constant is not None and right.constant is not None:
            return self.constant(node, convert(function(left.constant, right.constant), of))
        return Value(of, f"{tight(left)} {symbol} {tight(right)}", loose=True)

    def division(self, node: ast.AST, sign: Sign, left: Value, right: Value) -> Value:
        """Python's quotients and rests go down, C's to 0."""
        symbol, function = sign
        of = scalar(left)
        if left.constant is not None and right.constant:
            return self.constant(node, convert(function(left.constant, right.constant), of))
        if of == FLOAT64 and symbol == "%":
            self.unit.uses_math = True
            return self.apart(Value(of, f"{self.unit.library('rest')}({left.text}, {right.text})"))
        if of in UNSIGNED:
            return Value(of, f"{tight(left)} {symbol[0]} {tight(right)}", loose=True)
        if of != INT64 or isinstance(alike(of, left, right), Lanes):
            raise self.incompatible(node, symbol, left, right)
        name = self.unit.library("floor_divide" if symbol == "//" else "floor_rest")
        return Value(INT64, f"{name}({left.text}, {right.text})")

    def unary(self, node: ast.UnaryOp) -> Value:
        """``not a`` and ``-a``."""
        value = self.value(node.operand)
        of = element(value)
        if isinstance(node.op, ast.Not):
            return self.negated(node, value)
        if not isinstance(node.op, ast.USub) or of is None or of == BOOL or of in UNSIGNED:
            raise self.refusal(node, f"`{ast.unparse(node):.60}` of {shown(value.type)}")
        if value.constant is not None:
            return self.constant(node, convert(-value.constant, of))
        return value._replace(text=f"-{tight(value)}", loose=True)

    # ---- conditions ---------------------------------------------------------------------------------------------

    def negated(self, node: ast.AST, value: Value) -> Value:
        """Whether a number is no condition that holds."""
        truth = self.truth(node, value)
        if truth.constant is not None:
            return self.constant(node, not truth.constant)
        return Value(BOOL, f"!({truth.text})")

    def truth(self, node: ast.AST, value: Value) -> Value:
        """A number as a condition."""
        if not isinstance(value.type, Scalar):
            raise self.refusal(node, f"{shown(value.type)} as a condition")
        if value.constant is not None:
            return self.constant(node, bool(value.constant))
        return value if value.type == BOOL else Value(BOOL, f"{tight(value)} != 0", loose=True)

    def comparison(self, node: ast.Compare) -> Value:
        """``a < b``, and chains of such."""
        values = [self.value(each) for each in (node.left, *node.comparators)]
        parts = []
        for op, left, right in zip(node.ops, values, values[1:], strict=False):
            if type(op) not in SIGNS:
                raise self.refusal(node, f"`{ast.unparse(node):.60}`")
            parts.append(self.compared(node, SIGNS[type(op)], left, right))
        return self.all_of(node, "&&", parts)

    def compared(self, node: ast.AST, sign: Sign, left: Value, right: Value) -> Value:
        """Two numbers, or lanes of them."""
        symbol, function = sign
        both = element(left), element(right)
        if both[0] is None or both[1] is None:
            raise self.incompatible(node, symbol, left, right)
        of = both[0] if both[0] == both[1] else joined(both[0], both[1])
        if of is None:
            raise self.incompatible(node, symbol, left, right)
        if of == FLOAT64 and FLOAT32 in both:  # a whole number that float32 holds is the same there
            for value in (left, right):
                if value.constant is not None and float(convert(value.constant, FLOAT32)) == value.constant:
                    of = FLOAT32
        left, right = self.cast(node, left, of), self.cast(node, right, of)
        if left.constant is not None and right.constant is not None:
            return self.constant(node, bool(function(left.constant, right.constant)))
        text = f"{tight(left)} {symbol} {tight(right)}"
        return Value(alike(BOOL, left, right), text, loose=True, loads=left.loads or right.loads)

    def logic(self, node: ast.BoolOp) -> Value:
        """``and``, ``or``: what follows is computed only where it counts."""
        symbol = "&&" if isinstance(node.op, ast.And) else "||"
        parts = [self.truth(node.values[0], self.value(node.values[0]))]
        for each in node.values[1:]:
            with self.captured() as made:
                part = self.truth(each, self.value(each))
            before = self.all_of(node, symbol, parts)
            if not made or before.constant is not None:
                self.pieces += made
                parts.append(part)
                continue
            name = self.new("t")
            self.pieces += [
                Piece(f"bool {name} = {before.text};", sets=name),
                Piece(f"if ({'' if symbol == '&&' else '!'}{name})", [*made, Piece(f"{name} = {part.text};", sets=name)]),
            ]
            parts = [Value(BOOL, name)]
        return self.all_of(node, symbol, parts)

    def all_of(self, node: ast.AST, symbol: str, parts: list[Value]) -> Value:
        """Conditions, of which those that are known are left out."""
        decides = symbol == "||"  # the constant that makes the others idle
        open_: list[Value] = []
        for part in parts:
            if part.constant is None:
                open_.append(part)
            elif bool(part.constant) == decides:
                if not open_:
                    return self.constant(node, decides)
                open_.append(part)
                break
        if not open_:
            return self.constant(node, not decides)
        if len(open_) == 1:
            return open_[0]
        if any(isinstance(part.type, Lanes) for part in open_):
            raise self.refusal(node, "a condition of lanes; use `&` and `select`")
        return Value(BOOL, f" {symbol} ".join(f"({part.text})" if part.loose else part.text for part in open_), loose=True)

    def choice(self, node: ast.IfExp) -> Value:
        """``a if test else b``."""
        test = self.truth(node.test, self.value(node.test))
        if test.constant is not None:
            return self.value(node.body if test.constant else node.orelse)
        with self.captured() as first:
            yes = self.value(node.body)
        with self.captured() as second:
            no = self.value(node.orelse)
        of = self.common(node, yes, no)
        yes, no = self.cast(node.body, yes, of), self.cast(node.orelse, no, of)
        if not first and not second:
            return Value(of, f"{tight(test)} ? {tight(yes)} : {tight(no)}", loose=True)
        name = self.new("t")
        self.pieces += [
            Piece(f"{of.c} {name};", sets=name),
            Piece(f"if ({test.text})", [*first, Piece(f"{name} = {yes.text};", sets=name)]),
            Piece("else", [*second, Piece(f"{name} = {no.text};", sets=name)]),
        ]
        return Value(of, name)

    def common(self, node: ast.AST, yes: Value, no: Value) -> Scalar:
        """The type of what is one of two numbers."""
        if not isinstance(yes.type, Scalar) or not isinstance(no.type, Scalar):
            raise self.refusal(node, f"a choice between {shown(yes.type)} and {shown(no.type)}")
        of = yes.type if yes.type == no.type else joined(yes.type, no.type)
        if of is None:
            raise self.refusal(node, f"a choice between {shown(yes.type)} and {shown(no.type)}")
        return of
