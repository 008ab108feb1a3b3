"""Where the variables of a function are declared in C: as late as they can be, and early enough for all that use them."""

import ast
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field

LOOPS = (ast.For, ast.While)
Path = tuple[tuple[int, int], ...]  # of a statement: from outside in, which list of statements, and which of them


@dataclass
class Scope:
    """Variables of a function.

    Attributes:
        sets: how often each is assigned to, but for loops that it counts.
        here: those that their first assignment declares.
        before: by the ``id`` of a statement, those that are declared in front of it.
    """

    sets: Counter[str] = field(default_factory=Counter)
    here: set[str] = field(default_factory=set)
    before: dict[int, list[str]] = field(default_factory=dict)

    def give(self, argument: str) -> None:
        """It has a value, and a place, from the beginning."""
        self.sets[argument] += 1
        self.here.discard(argument)
        for names in self.before.values():
            if argument in names:
                names.remove(argument)

    def is_set_once(self, name: str) -> bool:
        """Whether one assignment is all there is."""
        return self.sets[name] == 1


def scope(function: ast.FunctionDef) -> Scope:
    """Look where its variables are assigned and used."""
    found = Scope(Counter(assigned(function)))
    for each in ast.walk(function):
        if isinstance(each, ast.For) and isinstance(each.target, ast.Name):
            found.sets[each.target.id] -= 1
    for name, paths in _occurrences(function.body).items():
        if found.sets[name] > 0:
            _place(found, function.body, name, paths)
    return found


def assigned(tree: ast.AST) -> Iterator[str]:
    """Names that are assigned to, as often as they are."""
    for each in ast.walk(tree):
        if isinstance(each, ast.Name) and isinstance(each.ctx, ast.Store):
            yield each.id


def _place(found: Scope, body: list[ast.stmt], name: str, paths: list[Path]) -> None:
    """Choose where a variable is declared: in the innermost block that has all of it."""
    depth = 0
    while all(len(path) > depth + 1 for path in paths) and len({(path[depth], path[depth + 1][0]) for path in paths}) == 1:
        depth += 1
    first = min(paths)
    if len(first) == depth + 1 and isinstance(_statement(body, first), ast.Assign | ast.AnnAssign):
        found.here.add(name)
        return
    for outer in range(depth):
        if isinstance(_statement(body, first[: outer + 1]), LOOPS):
            depth = outer  # it may keep its value from turn to turn
            break
    found.before.setdefault(id(_statement(body, first[: depth + 1])), []).append(name)


def _occurrences(body: list[ast.stmt]) -> dict[str, list[Path]]:
    """Where each name stands: paths of the statements."""
    found: dict[str, list[Path]] = {}

    def look(statements: list[ast.stmt], path: Path, which: int, counted: frozenset[str]) -> None:
        for index, statement in enumerate(statements):
            here = (*path, (which, index))
            blocks = [getattr(statement, name, []) for name in ("body", "orelse")]
            inner = {id(each) for block in blocks for part in block for each in ast.walk(part)}
            counting = counted
            if isinstance(statement, ast.For) and isinstance(statement.target, ast.Name):
                counting = counted | {statement.target.id}  # this name is the loop's own there
            for each in ast.walk(statement):
                if isinstance(each, ast.Name) and id(each) not in inner and each.id not in counting:
                    found.setdefault(each.id, []).append(here)
            for number, block in enumerate(blocks):
                look(block, here, number, counting)

    look(body, (), 0, frozenset())
    return found


def _statement(body: list[ast.stmt], path: Path) -> ast.stmt:
    """The statement at a path."""
    statement = body[path[0][1]]
    for which, index in path[1:]:
        statement = getattr(statement, ("body", "orelse")[which])[index]
    return statement
