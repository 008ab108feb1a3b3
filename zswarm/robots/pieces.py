"""What C is made of on its way: values, lines and blocks, and the few functions that C lacks."""

import re
from dataclasses import dataclass
from typing import Any, NamedTuple

from zswarm.robots.c_types import Array, Lanes, Scalar, Together, Type

INDENT = "    "

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


def tight(value: Value) -> str:
    """Its text, to stand beside an operator."""
    return f"({value.text})" if value.loose else value.text


def element(value: Value) -> Scalar | None:
    """The type of a number, or of each of eight; None of others."""
    if isinstance(value.type, Lanes):
        return value.type.element
    return value.type if isinstance(value.type, Scalar) else None


def scalar(value: Value) -> Scalar:
    """The same of what is a number, or are eight."""
    of = element(value)
    assert of is not None  # noqa: S101  asked before
    return of


def alike(of: Scalar, *values: Value) -> Type:
    """What comes of these, in that type: lanes if one of them is."""
    return Lanes(of) if any(isinstance(each.type, Lanes) for each in values) else of


def shown(kind: Type | None) -> str:
    """A type in words."""
    match kind:
        case Scalar(name=name):
            return name
        case Array(element=of):
            return f"an array of {of.name}"
        case Lanes(element=of):
            return f"lanes of {of.name}"
        case Together():
            return "a tuple"
    return "nothing"


def taken_back(value: Value, pieces: list[Piece]) -> str:
    """A value's text; of an operation that has just become a statement, what stands there, which is then left out."""
    if pieces and pieces[-1].once and pieces[-1].sets == value.text:
        return pieces.pop().text.split(f" {value.text} = ", 1)[1].removesuffix(";")
    return value.text


def without_idle(pieces: list[Piece]) -> list[Piece]:
    """Without variables that nothing reads."""
    while True:
        uses = {each.sets: 0 for each in _all(pieces) if each.sets}
        for each in _all(pieces):
            for word in set(re.findall(r"\w+", each.text)):
                if word in uses and each.sets != word:
                    uses[word] += 1
        for each in _all(pieces):  # a loop over lanes that sets a variable has it in its body, too
            if each.sets and each.body is not None:
                inside = " ".join(part.text for part in _all(each.body))
                uses[each.sets] -= (
                    sum(bool(re.search(rf"\b{each.sets}\b", part.text)) for part in _all(each.body)) if inside else 0
                )
        idle = {name for name, count in uses.items() if count <= 0}
        if not idle:
            return pieces
        pieces = _dropped(pieces, idle)


def _dropped(pieces: list[Piece], idle: set[str]) -> list[Piece]:
    return [
        Piece(each.text, None if each.body is None else _dropped(each.body, idle), each.sets)
        for each in pieces
        if each.sets not in idle
    ]


def _all(pieces: list[Piece]) -> list[Piece]:
    return [part for each in pieces for part in (each, *_all(each.body or []))]


def rendered(pieces: list[Piece], depth: int) -> list[str]:
    """Lines of C."""
    lines = []
    for each in pieces:
        if each.body is None:
            lines.append(INDENT * depth + each.text)
            continue
        head, body = each.text, each.body
        is_chain = head == "else" and body and body[0].text.startswith("if (") and all(part.text == "else" for part in body[1:])
        if is_chain:
            inner = rendered(body, depth)
            lines[-1] = f"{lines[-1]} else {inner[0].lstrip()}"
            lines += inner[1:]
            continue
        if head == "else":
            lines[-1] += " else {"
        else:
            lines.append(f"{INDENT * depth}{head} {{")
        lines += [*rendered(body, depth + 1), f"{INDENT * depth}}}"]
    return lines
