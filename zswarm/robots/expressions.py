"""Expressions of kernels as C99: their types, constants folded, every floating-point operation a statement of its own.

A compiler may join a product and a sum to one operation that rounds once (C99, 6.5 paragraph 8); standards let it do so within
an expression only. What is constant is computed here, by the same operations in the same types.
"""

import ast
import operator
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn

import numpy as np

from zswarm import jit, lanes
from zswarm.errors import ConfigError
from zswarm.robots.c_types import (
    BOOL,
    FLOAT32,
    FLOAT64,
    FLOATS,
    INT64,
    SCALARS,
    UINT64,
    UNSIGNED,
    WHOLE,
    Array,
    Lanes,
    Scalar,
    Together,
    Type,
    convert,
    joined,
    literal,
    type_of,
)

if TYPE_CHECKING:
    from zswarm.robots.translate import Translation

SIGNS: dict[type[ast.AST], tuple[str, Callable[..., Any]]] = {
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
BITWISE = ("&", "|", "^", "<<", ">>")
HELD_BACK = 1 << 53  # whole numbers up to here are exact in float64

# What C has no operator for, or where it leaves to the compiler what Python says.
LIBRARY = {
    "floor_divide": """static int64_t {name}(int64_t a, int64_t b)
{{
    int64_t quotient = 0;
    if (b != 0) {{
        quotient = a / b;
        if (((a % b) != 0) && ((a < 0) != (b < 0))) {{
            quotient = quotient - 1;
        }}
    }}
    return quotient;
}}
""",
    "floor_rest": """static int64_t {name}(int64_t a, int64_t b)
{{
    int64_t rest = 0;
    if (b != 0) {{
        rest = a % b;
        if ((rest != 0) && ((rest < 0) != (b < 0))) {{
            rest = rest + b;
        }}
    }}
    return rest;
}}
""",
    "rest": """static double {name}(double a, double b)
{{
    double rest = fmod(a, b);
    if ((rest != 0.0) && ((rest < 0.0) != (b < 0.0))) {{
        rest = rest + b;
    }}
    return rest;
}}
""",
    "double_of_bits": """static double {name}(uint64_t bits)
{{
    union {{
        uint64_t bits;
        double number;
    }} both;
    both.bits = bits;
    return both.number;
}}
""",
    "bits_of_double": """static uint64_t {name}(double number)
{{
    union {{
        uint64_t bits;
        double number;
    }} both;
    both.number = number;
    return both.bits;
}}
""",
}


class Value(NamedTuple):
    """What an expression is in C: of ``Lanes``, in one lane."""

    type: Type
    text: str
    constant: Any = None
    loose: bool = False  # needs brackets beside an operator
    loads: bool = False  # lanes of an array that may change


@dataclass
class Piece:
    """A line of C, or the head of a block.

    Attributes:
        sets: the local that it sets, and does nothing else.
        once: that local is read once, by what comes next.
    """

    text: str
    body: "list[Piece] | None" = None
    sets: str = ""
    once: bool = False


@dataclass
class Local:
    """A variable of a function."""

    type: Type
    name: str


@dataclass
class Expressions:
    """The expressions of one function, translated for given types of its arguments."""

    unit: "Translation"
    file: str
    first_line: int
    globals: dict[str, Any]
    constants: dict[str, Value] = field(default_factory=dict)
    locals: dict[str, Local] = field(default_factory=dict)
    pieces: list[Piece] = field(default_factory=list)
    written: set[str] = field(default_factory=set)  # arrays, by their names in Python
    names: set[str] = field(default_factory=set)  # of Python
    fresh: int = 0
    lane: str = ""
    pure: bool = True

    def refuse(self, node: ast.AST, text: str) -> NoReturn:
        """Say what cannot be translated, and where it stands."""
        line = self.first_line + getattr(node, "lineno", 1) - 1
        raise ConfigError(f"{self.file}, line {line}: cannot be said in C: {text}")

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
                return self.element(node)
            case ast.Attribute():
                return self.constant(node, self.known(node))
            case ast.Call():
                return self.call(node)
        self.refuse(node, f"`{ast.unparse(node):.60}`")

    # ---- constants and names ------------------------------------------------------------------------------------

    def known(self, node: ast.expr) -> Any:
        """What a name, or a name of a module, stands for where the function was written.

        Raises:
            ConfigError: nothing.
        """
        if isinstance(node, ast.Name):
            if node.id in self.globals:
                return self.globals[node.id]
            if node.id in ("int", "float", "bool", "abs", "min", "max", "len", "range"):
                return {"int": int, "float": float, "bool": bool, "abs": abs, "min": min, "max": max, "len": len}.get(
                    node.id, range
                )
        if isinstance(node, ast.Attribute):
            owner = self.known(node.value)
            if hasattr(owner, node.attr):
                return getattr(owner, node.attr)
        self.refuse(node, f"`{ast.unparse(node):.60}` is not known")

    def constant(self, node: ast.AST, value: Any) -> Value:
        """A number that is known, or an array of such."""
        if isinstance(value, tuple | list) and len({type(each) for each in value}) == 1:
            value = np.array(value)
        kind = type_of(value)
        if kind is None:
            self.refuse(node, f"`{ast.unparse(node):.60}`, which is {type(value).__name__}")
        if isinstance(kind, Array):
            hint = ast.unparse(node).split(".")[-1]
            return Value(kind, self.unit.table(hint, value), value)
        if kind in WHOLE and not -(1 << 63) <= int(value) < 1 << 64:
            self.refuse(node, f"{value}, which has more than 64 bits")
        text = literal(value)
        if "NAN" in text or "INFINITY" in text:
            self.unit.uses_math = True
        return Value(kind, text, value, loose=text.startswith("-"))

    def named(self, node: ast.expr, name: str) -> Value:
        if name in self.constants:
            return self.constants[name]
        if name in self.locals:
            local = self.locals[name]
            in_lane = isinstance(local.type, Lanes)
            return Value(local.type, f"{local.name}[{self.lane}]" if in_lane else local.name)
        return self.constant(node, self.known(node))

    def new(self, hint: str) -> str:
        """A name that no other local has."""
        self.fresh += 1
        while f"{hint}{self.fresh}" in self.names:
            self.fresh += 1
        return f"{hint}{self.fresh}"

    # ---- operations ---------------------------------------------------------------------------------------------

    def cast(self, node: ast.AST, value: Value, to: Scalar) -> Value:
        """A number in another type, as numba converts it."""
        of = value.type.element if isinstance(value.type, Lanes) else value.type
        if of == to:
            return value
        if not isinstance(of, Scalar):
            self.refuse(node, f"{_shown(of)} as {to.name}")
        if value.constant is not None:
            return self.constant(node, convert(value.constant, to))
        target = Lanes(to) if isinstance(value.type, Lanes) else to
        if to == BOOL:
            return value._replace(type=target, text=f"{_tight(value)} != 0", loose=True)
        return value._replace(type=target, text=f"({to.c}){_tight(value)}", loose=False)

    def operation(self, node: ast.AST, sign: tuple[str, Callable[..., Any]], left: Value, right: Value) -> Value:
        """Two numbers, or lanes of them, with an operator between."""
        symbol, function = sign
        both = _element(left), _element(right)
        if both[0] is None or both[1] is None:
            self.refuse(node, f"{_shown(left.type)} {symbol} {_shown(right.type)}")
        if symbol in BITWISE:
            return self.bitwise(node, sign, left, right)
        of = joined(both[0], both[1])
        if of is None or of == BOOL:
            self.refuse(node, f"{_shown(left.type)} {symbol} {_shown(right.type)}")
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
        if of in WHOLE and symbol in ("+", "-"):
            if right.constant == 0:
                return left
            if left.constant == 0 and symbol == "+":
                return right
        text = f"{_tight(left)} {symbol} {_tight(right)}"
        value = Value(_alike(of, left, right), text, loose=True, loads=left.loads or right.loads)
        return self.apart(value) if of in FLOATS else value

    def apart(self, value: Value) -> Value:
        """A floating-point operation as a statement of its own."""
        name = self.new("t")
        element = _element(value)
        assert element is not None  # noqa: S101  a number
        self.pieces.append(Piece(f"const {element.c} {name} = {value.text};", sets=name, once=True))
        return value._replace(text=name, loose=False)

    def bitwise(self, node: ast.AST, sign: tuple[str, Callable[..., Any]], left: Value, right: Value) -> Value:
        symbol, function = sign
        of = joined(_scalar(left), _scalar(right)) if BOOL not in (left.type, right.type) or left.type != right.type else BOOL
        lane_logic = isinstance(left.type, Lanes) or isinstance(right.type, Lanes)
        if of == BOOL and symbol in ("&", "|"):
            text = f"{_tight(left)} {symbol * 2} {_tight(right)}"
            return Value(_alike(BOOL, left, right), text, loose=True, loads=left.loads or right.loads)
        if of is None or of not in WHOLE or of == BOOL or lane_logic:
            self.refuse(node, f"{_shown(left.type)} {symbol} {_shown(right.type)}")
        left, right = self.cast(node, left, of), self.cast(node, right, of)
        if left.constant is not None and right.constant is not None:
            return self.constant(node, convert(function(left.constant, right.constant), of))
        return Value(of, f"{_tight(left)} {symbol} {_tight(right)}", loose=True)

    def division(self, node: ast.AST, sign: tuple[str, Callable[..., Any]], left: Value, right: Value) -> Value:
        """Python's quotients and rests go down, C's to 0."""
        symbol, function = sign
        of = _scalar(left)
        if left.constant is not None and right.constant:
            return self.constant(node, convert(function(left.constant, right.constant), of))
        if of == FLOAT64 and symbol == "%":
            self.unit.uses_math = True
            return self.apart(Value(of, f"{self.unit.library('rest')}({left.text}, {right.text})"))
        if of in UNSIGNED:
            return Value(of, f"{_tight(left)} {symbol[0]} {_tight(right)}", loose=True)
        if of != INT64 or isinstance(left.type, Lanes) or isinstance(right.type, Lanes):
            self.refuse(node, f"{_shown(left.type)} {symbol} {_shown(right.type)}")
        name = self.unit.library("floor_divide" if symbol == "//" else "floor_rest")
        return Value(INT64, f"{name}({left.text}, {right.text})")

    def unary(self, node: ast.UnaryOp) -> Value:
        value = self.value(node.operand)
        of = _element(value)
        if isinstance(node.op, ast.Not) and isinstance(value.type, Scalar):
            return self.negated(node, value)
        if isinstance(node.op, ast.UAdd | ast.Invert | ast.Not) or of is None or of == BOOL or of in UNSIGNED:
            self.refuse(node, f"`{ast.unparse(node):.60}` of {_shown(value.type)}")
        if value.constant is not None:
            return self.constant(node, convert(-value.constant, of))
        return value._replace(text=f"-{_tight(value)}", loose=True)

    def negated(self, node: ast.AST, value: Value) -> Value:
        truth = self.truth(node, value)
        if truth.constant is not None:
            return self.constant(node, not truth.constant)
        return Value(BOOL, f"!({truth.text})")

    def truth(self, node: ast.AST, value: Value) -> Value:
        """A number as a condition."""
        if not isinstance(value.type, Scalar):
            self.refuse(node, f"{_shown(value.type)} as a condition")
        if value.constant is not None:
            return self.constant(node, bool(value.constant))
        return value if value.type == BOOL else Value(BOOL, f"{_tight(value)} != 0", loose=True)

    def comparison(self, node: ast.Compare) -> Value:
        values = [self.value(each) for each in (node.left, *node.comparators)]
        parts = []
        for op, left, right in zip(node.ops, values, values[1:], strict=False):
            if type(op) not in SIGNS:
                self.refuse(node, f"`{ast.unparse(node):.60}`")
            parts.append(self.compared(node, SIGNS[type(op)], left, right))
        return self.all_of(node, "&&", parts)

    def compared(self, node: ast.AST, sign: tuple[str, Callable[..., Any]], left: Value, right: Value) -> Value:
        symbol, function = sign
        both = _element(left), _element(right)
        if both[0] is None or both[1] is None:
            self.refuse(node, f"{_shown(left.type)} {symbol} {_shown(right.type)}")
        of = both[0] if both[0] == both[1] else joined(both[0], both[1])
        if of is None:
            self.refuse(node, f"{_shown(left.type)} {symbol} {_shown(right.type)}")
        if of == FLOAT64 and FLOAT32 in both:  # a whole number that float32 holds is the same there
            for value in (left, right):
                if value.constant is not None and float(convert(value.constant, FLOAT32)) == value.constant:
                    of = FLOAT32
        left, right = self.cast(node, left, of), self.cast(node, right, of)
        if left.constant is not None and right.constant is not None:
            return self.constant(node, bool(function(left.constant, right.constant)))
        text = f"{_tight(left)} {symbol} {_tight(right)}"
        return Value(_alike(BOOL, left, right), text, loose=True, loads=left.loads or right.loads)

    def logic(self, node: ast.BoolOp) -> Value:
        symbol = "&&" if isinstance(node.op, ast.And) else "||"
        parts = [self.truth(node.values[0], self.value(node.values[0]))]
        for each in node.values[1:]:
            with self.captured() as made:
                parts.append(self.truth(each, self.value(each)))
            if made:  # what follows is computed whether or not it counts, which only arrays' bounds could notice
                if not _harmless(each):
                    self.refuse(each, f"`{ast.unparse(each):.60}` behind {'and' if symbol == '&&' else 'or'}: give it a line")
                self.pieces += made
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
            self.refuse(node, "a condition of lanes; use `&` and `select`")
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
            return Value(of, f"{_tight(test)} ? {_tight(yes)} : {_tight(no)}", loose=True)
        name = self.new("t")
        self.pieces += [
            Piece(f"{of.c} {name};", sets=name),
            Piece(f"if ({test.text})", [*first, Piece(f"{name} = {yes.text};", sets=name)]),
            Piece("else", [*second, Piece(f"{name} = {no.text};", sets=name)]),
        ]
        return Value(of, name)

    def common(self, node: ast.AST, yes: Value, no: Value) -> Scalar:
        if not isinstance(yes.type, Scalar) or not isinstance(no.type, Scalar):
            self.refuse(node, f"a choice between {_shown(yes.type)} and {_shown(no.type)}")
        of = yes.type if yes.type == no.type else joined(yes.type, no.type)
        if of is None:
            self.refuse(node, f"a choice between {_shown(yes.type)} and {_shown(no.type)}")
        return of

    @contextmanager
    def captured(self) -> Iterator[list[Piece]]:
        """Statements that are made meanwhile, apart."""
        outer, self.pieces = self.pieces, []
        made = self.pieces
        try:
            yield made
        finally:
            self.pieces = outer

    # ---- arrays -------------------------------------------------------------------------------------------------

    def element(self, node: ast.Subscript) -> Value:
        """A number of an array; of ``shape``, its length; of a tuple, a part."""
        match node.value, node.slice:
            case ast.Attribute(value=owner, attr="shape"), ast.Constant(value=0):
                return self.length(node, self.value(owner))
        owner, place = self.value(node.value), self.place(node.slice)
        if not isinstance(owner.type, Array):
            self.refuse(node, f"`{ast.unparse(node):.60}` of {_shown(owner.type)}")
        if owner.constant is not None and place.constant is not None:
            if not 0 <= int(place.constant) < len(owner.constant):
                self.refuse(node, f"`{ast.unparse(node):.60}`: number {int(place.constant)} of {len(owner.constant)}")
            value = owner.constant[int(place.constant)]
            return self.constant(node, value if owner.type.element == FLOAT32 else value.item())
        return Value(owner.type.element, f"{owner.text}[{place.text}]")

    def place(self, node: ast.expr) -> Value:
        place = self.value(node)
        if place.type not in WHOLE or place.type == BOOL or (place.constant is not None and place.constant < 0):
            self.refuse(node, f"`{ast.unparse(node):.60}` as a place in an array")
        return place

    def length(self, node: ast.AST, owner: Value) -> Value:
        if not isinstance(owner.type, Array) or owner.type.length is None:
            self.refuse(node, "the length of what has none that is known")
        return self.constant(node, owner.type.length)

    def slice(self, node: ast.Subscript) -> Value:
        """A part of an array, for a function that is called with it."""
        owner, cut = self.value(node.value), node.slice
        if not isinstance(owner.type, Array) or not isinstance(cut, ast.Slice) or cut.step is not None or cut.lower is None:
            self.refuse(node, f"`{ast.unparse(node):.60}`")
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
            self.refuse(node, f"`{ast.unparse(node):.60}`: arguments are given by their place")
        if isinstance(node.func, ast.Attribute) and node.func.attr == "view" and len(node.args) == 1:
            return self.view(node, self.value(node.func.value), self.known(node.args[0]))
        function = self.known(node.func)
        name = _type_name(function)
        if name in SCALARS and len(node.args) == 1:
            value = self.value(node.args[0])
            if name == "int64" and _element(value) in WHOLE:  # int of a number that is whole already
                return self.cast(node, value, SCALARS[name])
            return self.cast(node, value, SCALARS[name])
        if (special := SPECIAL.get(_key(function))) is not None:
            return special(self, node, [self.value(each) for each in node.args])
        if not callable(getattr(function, "py_func", None)) and not hasattr(function, "__code__"):
            self.refuse(node, f"`{ast.unparse(node.func):.60}`")
        value, pure = self.call_own(node, function)
        if not pure:
            self.refuse(node, f"`{ast.unparse(node):.60}` changes arrays within an expression: give it a line")
        return value

    def call_own(self, node: ast.Call, function: Any) -> tuple[Value, bool]:
        """A call of another function of a kernel: its value, and whether it changes no array."""
        slices = [isinstance(each, ast.Subscript) and isinstance(each.slice, ast.Slice) for each in node.args]
        arguments = [
            self.slice(each) if cut and isinstance(each, ast.Subscript) else self.value(each)
            for each, cut in zip(node.args, slices, strict=True)
        ]
        in_lanes = any(isinstance(each.type, Lanes) for each in arguments)
        if in_lanes and any(isinstance(each.type, Array) for each in arguments):
            self.refuse(node, f"`{ast.unparse(node):.60}`: lanes and arrays together")
        given = [each._replace(type=_scalar(each)) if isinstance(each.type, Lanes) else each for each in arguments]
        callee = self.unit.function(self, node, function, given)
        texts = [given[index].text for index in callee.takes]
        for index in callee.writes:
            if given[index].constant is not None:
                self.refuse(node, f"`{ast.unparse(node):.60}` changes a constant")
            self.written |= {each.id for each in ast.walk(node.args[index]) if isinstance(each, ast.Name)}
        self.pure = self.pure and not callee.writes
        of: Any = callee.result
        if in_lanes:
            if not isinstance(of, Scalar):
                self.refuse(node, f"`{ast.unparse(node):.60}`, which gives no lanes")
            of = Lanes(of)
        text = f"{callee.name}({', '.join(texts)})"
        value = Value(of, text, loads=any(each.loads for each in arguments))
        return (self.apart(value) if _element(value) in FLOATS and not callee.writes else value), not callee.writes

    def view(self, node: ast.Call, value: Value, as_: Any) -> Value:
        """The bits of a number as another one."""
        match value.type, _type_name(as_):
            case Scalar("uint64"), "float64":
                return Value(FLOAT64, f"{self.unit.library('double_of_bits')}({value.text})")
            case Scalar("float64"), "uint64":
                return Value(UINT64, f"{self.unit.library('bits_of_double')}({value.text})")
        self.refuse(node, f"`{ast.unparse(node):.60}`")

    # ---- what C or this file has for functions of Python, numpy and lanes.py --------------------------------------

    def absolute(self, node: ast.Call, arguments: list[Value]) -> Value:
        (value,) = arguments
        of = _element(value)
        if value.constant is not None:
            return self.constant(node, convert(abs(value.constant), _scalar(value)))
        if of in FLOATS:
            self.unit.uses_math = True
            name = "fabs" if of == FLOAT64 else "fabsf"
            return value._replace(text=f"{name}({value.text})", loose=False)
        if value.type != INT64:
            self.refuse(node, f"`{ast.unparse(node):.60}`")
        return Value(INT64, f"({_tight(value)} < 0) ? -{_tight(value)} : {_tight(value)}", loose=True)

    def extreme(self, node: ast.Call, arguments: list[Value], symbol: str) -> Value:
        """Python's min and max: a later one counts if it is truly less, or greater."""
        best = arguments[0]
        for value in arguments[1:]:
            of = self.common(node, best, value)
            best, value = self.cast(node, best, of), self.cast(node, value, of)  # noqa: PLW2901
            sign = SIGNS[ast.Lt if symbol == "<" else ast.Gt]
            if best.constant is not None and value.constant is not None:
                best = value if sign[1](value.constant, best.constant) else best
                continue
            best, value = (self.apart(each) if "(" in each.text or each.loose else each for each in (best, value))  # noqa: PLW2901
            best = Value(of, f"({_tight(value)} {symbol} {_tight(best)}) ? {_tight(value)} : {_tight(best)}", loose=True)
        return best

    def root(self, node: ast.Call, arguments: list[Value]) -> Value:
        (value,) = arguments
        of = _element(value)
        if of not in FLOATS:
            self.refuse(node, f"the square root of {_shown(value.type)}")
        self.unit.uses_math = True
        return self.apart(value._replace(text=f"{'sqrt' if of == FLOAT64 else 'sqrtf'}({value.text})", constant=None))

    def is_nan(self, node: ast.Call, arguments: list[Value]) -> Value:
        (value,) = arguments
        if _element(value) not in FLOATS:
            self.refuse(node, f"`{ast.unparse(node):.60}`")
        return Value(_alike(BOOL, value), f"{_tight(value)} != {_tight(value)}", loose=True, loads=value.loads)

    def select(self, node: ast.Call, arguments: list[Value]) -> Value:
        test, yes, no = arguments
        if _element(test) != BOOL or _element(yes) != _element(no):
            self.refuse(node, f"`{ast.unparse(node):.60}`: choose by a condition, between numbers of one type")
        if isinstance(test.type, Scalar) and test.constant is not None:
            return yes if test.constant else no
        kind = _alike(_scalar(yes), test, yes, no)
        text = f"{_tight(test)} ? {_tight(yes)} : {_tight(no)}"
        return Value(kind, text, loose=True, loads=any(each.loads for each in arguments))

    def fill(self, node: ast.Call, arguments: list[Value]) -> Value:
        (value,) = arguments
        return value._replace(type=Lanes(_scalar(value)), constant=None)

    def load(self, node: ast.Call, arguments: list[Value]) -> Value:
        array, at = arguments
        if not isinstance(array.type, Array) or at.type not in WHOLE:
            self.refuse(node, f"`{ast.unparse(node):.60}`")
        text = self.lane if at.constant == 0 else f"{_sum(at)} + {self.lane}"
        return Value(Lanes(array.type.element), f"{array.text}[{text}]", loads=array.constant is None)


def _sum(value: Value) -> str:
    """A place, to add to: sums and products need no brackets there."""
    return value.text if not value.loose or not set(value.text) & set("?:<>=&|!,") else f"({value.text})"


def _tight(value: Value) -> str:
    return f"({value.text})" if value.loose else value.text


def _element(value: Value) -> Scalar | None:
    """The type of a number, or of each of eight."""
    if isinstance(value.type, Lanes):
        return value.type.element
    return value.type if isinstance(value.type, Scalar) else None


def _scalar(value: Value) -> Scalar:
    of = _element(value)
    assert of is not None  # noqa: S101  asked before
    return of


def _alike(of: Scalar, *values: Value) -> Type:
    return Lanes(of) if any(isinstance(each.type, Lanes) for each in values) else of


def _shown(kind: Type | None) -> str:
    match kind:
        case Scalar(name=name):
            return name
        case Array(element=element):
            return f"an array of {element.name}"
        case Lanes(element=element):
            return f"lanes of {element.name}"
        case Together():
            return "a tuple"
    return "nothing"


def _harmless(node: ast.expr) -> bool:
    """Whether an expression may be computed where it does not count: it reads no array, and calls nothing."""
    return not any(isinstance(each, ast.Subscript | ast.Call) for each in ast.walk(node))


def _type_name(value: Any) -> str:
    """What a type of Python, numpy or numba is called here."""
    if value in (int, float, bool):
        return {int: "int64", float: "float64", bool: "bool"}[value]
    name = value.__name__ if isinstance(value, type) else str(value) if type(value).__module__.startswith("numba") else ""
    return "bool" if name in ("bool_", "boolean") else name


def _key(function: Any) -> Any:
    return id(getattr(function, "py_func", function))


SPECIAL: dict[Any, Callable[[Expressions, ast.Call, list[Value]], Value]] = {
    _key(abs): Expressions.absolute,
    _key(np.abs): Expressions.absolute,
    _key(min): lambda self, node, values: self.extreme(node, values, "<"),
    _key(max): lambda self, node, values: self.extreme(node, values, ">"),
    _key(len): lambda self, node, values: self.length(node, values[0]),
    _key(np.sqrt): Expressions.root,
    _key(jit.sqrt): Expressions.root,
    _key(np.isnan): Expressions.is_nan,
    _key(lanes.select): Expressions.select,
    _key(lanes.fill): Expressions.fill,
    _key(lanes.load): Expressions.load,
}
