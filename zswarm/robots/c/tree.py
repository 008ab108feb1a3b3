"""Values and lines of C while a function is translated, and the text that lines become."""

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from zswarm.robots.c.c_types import LanesType, Scalar, Type

INDENT = "    "


class Value(NamedTuple):
    """An expression in C; one of ``LanesType`` is that of a single lane.

    Attributes:
        loose: it needs brackets next to an operator.
        loads: it reads lanes of an array that may change.
        changes: it also changes arrays.
    """

    type: Type
    text: str
    constant: Any = None
    loose: bool = False
    loads: bool = False
    changes: bool = False

    @property
    def operand(self) -> str:
        """The text next to an operator."""
        return f"({self.text})" if self.loose else self.text

    @property
    def element(self) -> Any:
        """The type of a number, or of the number in each lane; None for other types."""
        of = self.type.element if isinstance(self.type, LanesType) else self.type
        return of if isinstance(of, Scalar) else None


@dataclass
class CLine:
    """A line of C, or the head of a block.

    Attributes:
        body: the lines of the block.
        sets: the local variable that it sets; the line is dropped if no other reads that.
        once: only the next line reads that variable.
        changes: its expression also changes arrays; that effect is not dropped.
    """

    text: str
    body: "list[CLine] | None" = None
    sets: str = ""
    once: bool = False
    changes: bool = False


@dataclass
class Local:
    """A local variable, and its ``Type``."""

    type: Any
    name: str


class Callee(NamedTuple):
    """A function in C.

    Attributes:
        takes: numbers of the Python arguments that it takes; others are constant or never read.
        writes: those of them that are arrays which it changes.
        result: a ``Scalar`` or ``StructType``.
    """

    name: str
    takes: tuple[int, ...]
    writes: tuple[int, ...]
    result: Any


def like(of: Scalar, *values: Value) -> Type:
    """Return the type of a result of these values: lanes if one of them is."""
    return (
        LanesType(of) if any(isinstance(each.type, LanesType) for each in values) else of
    )


def inline(value: Value, lines: list[CLine]) -> str:
    """Return a value's text; if the last line only computes it, remove that line instead."""
    if lines and lines[-1].once and lines[-1].sets == value.text:
        return lines.pop().text.split(f" {value.text} = ", 1)[1].removesuffix(";")
    return value.text


def drop_unused(lines: list[CLine]) -> list[CLine]:
    """Return lines without the variables that are never read."""
    remaining = _reading(lines, {"", *_reads(lines, set())})
    return lines if remaining == lines else drop_unused(remaining)


def _reads(lines: list[CLine], own: set[str]) -> Iterator[str]:
    """Yield the words of lines, except of each line, and of the block around it, what it sets."""
    for line in lines:
        setting = own | {line.sets}
        yield from set(re.findall(r"\w+", line.text)) - setting
        yield from _reads(line.body or [], setting)


def _reading(lines: list[CLine], read: set[str]) -> list[CLine]:
    """Return lines without those that set other variables than these."""
    remaining = []
    for line in lines:
        if line.sets in read:
            remaining.append(replace(line, body=line.body and _reading(line.body, read)))
        elif line.changes:
            remaining.append(CLine(f"(void){line.text.split(' = ', 1)[1]}"))
    return remaining


def render(lines: list[CLine], indent: str = INDENT) -> list[str]:
    """Return the text of lines; a lone ``if`` in an ``else`` becomes ``else if``."""
    texts: list[str] = []
    for line in lines:
        if line.body is None:
            texts.append(indent + line.text)
        elif line.text != "else":
            texts += [
                f"{indent}{line.text} {{",
                *render(line.body, indent + INDENT),
                f"{indent}}}",
            ]
        elif _is_chain(line.body):
            first, *others = render(line.body, indent)
            texts[-1] += f" else {first.lstrip()}"
            texts += others
        else:
            texts[-1] += " else {"
            texts += [*render(line.body, indent + INDENT), f"{indent}}}"]
    return texts


def _is_chain(body: list[CLine]) -> bool:
    """Return whether lines are an ``if`` with its ``else``."""
    head, *others = [line.text for line in body] or [""]
    return head.startswith("if (") and all(text == "else" for text in others)
