"""Where C declares the variables of a function: as late as all their uses allow."""

import ast
import functools
from collections import Counter, defaultdict
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field


@dataclass
class Scope:
    """The variables of a function.

    Attributes:
        sets: the number of assignments to each, other than as a loop's counter.
        here: those that their first assignment declares.
        before: by the ``id`` of a statement, those that are declared in front of it.
    """

    sets: Counter[str]
    here: set[str] = field(default_factory=set)
    before: dict[int, list[str]] = field(default_factory=lambda: defaultdict(list))


def scope(function: ast.FunctionDef, arguments: Collection[str]) -> Scope:
    """Find where the variables of a function, except its arguments, are assigned and used."""
    found = Scope(Counter([*arguments, *assigned(function)]))
    found.sets.subtract(
        _counter(each) for each in ast.walk(function) if isinstance(each, ast.For)
    )
    for name in dict.fromkeys(name for each in function.body for name in _uses(each)):
        if found.sets[name] > 0 and name not in arguments:
            _place(found, function.body, name, None)
    return found


def assigned(tree: ast.AST) -> Iterator[str]:
    """Yield names that are assigned to, once per assignment."""
    for each in ast.walk(tree):
        if isinstance(each, ast.Name) and isinstance(each.ctx, ast.Store):
            yield each.id


def _place(found: Scope, block: list[ast.stmt], name: str, loop: ast.stmt | None) -> None:
    """Declare a variable in the innermost block that has all its uses, which are in this block.

    Args:
        loop: the outermost loop around the block, if any.
    """
    first, *others = [each for each in block if name in _uses(each)]
    inner = [each for each in _blocks(first) if any(name in _uses(part) for part in each)]
    if not others and len(inner) == 1 and name not in _head(first):
        if loop is None and isinstance(first, ast.For | ast.While):
            loop = first
        _place(found, inner[0], name, loop)
    elif isinstance(first, ast.Assign | ast.AnnAssign):
        found.here.add(name)
    else:  # in front of the loop: the variable may keep its value from one iteration to the next
        found.before[id(loop or first)].append(name)


@functools.cache
def _uses(statement: ast.stmt) -> list[str]:
    """Return the names that a statement uses, other than as a loop's counter."""
    parts = [part for block in _blocks(statement) for part in block]
    names = [*_head(statement), *(name for part in parts for name in _uses(part))]
    return [name for name in names if name != _counter(statement)]


def _head(statement: ast.stmt) -> list[str]:
    """Return the names in a statement outside of its blocks."""
    inner = {
        id(each)
        for block in _blocks(statement)
        for part in block
        for each in ast.walk(part)
    }
    nodes = (each for each in ast.walk(statement) if id(each) not in inner)
    return [each.id for each in nodes if isinstance(each, ast.Name)]


def _blocks(statement: ast.stmt) -> list[list[ast.stmt]]:
    return [getattr(statement, name, []) for name in ("body", "orelse")]


def _counter(statement: ast.stmt) -> str:
    """Return the name of a loop's counter; "" for other statements."""
    match statement:
        case ast.For(target=ast.Name(id=name)):
            return name
    return ""
