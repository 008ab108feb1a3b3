"""A kernel's Python source as a syntax tree, with what its names stand for."""

import ast
import functools
import inspect
import textwrap
from dataclasses import dataclass
from pathlib import Path
from types import FunctionType
from typing import Any, cast

from zswarm.errors import ConfigError


@dataclass(frozen=True)
class KernelFunction:
    """A Python function, its syntax tree, and its first line in a file."""

    plain: FunctionType
    tree: ast.FunctionDef
    file: str
    line: int

    @property
    def name(self) -> str:
        """The function's name in Python."""
        return self.plain.__name__

    @property
    def arguments(self) -> list[str]:
        """The names of the function's arguments."""
        return [each.arg for each in self.tree.args.args]

    @functools.cached_property
    def globals(self) -> dict[str, Any]:
        """The values of global names and of names in enclosing functions."""
        return {**self.plain.__globals__, **inspect.getclosurevars(self.plain).nonlocals}

    def error(self, node: ast.AST, text: str) -> ConfigError:
        """Return the error about a construct that cannot be translated."""
        line = self.line + getattr(node, "lineno", 1) - 1
        return ConfigError(f"{self.file}, line {line}: cannot be translated to C: {text}")

    def check(self) -> None:
        """Raise ``ConfigError`` if arguments have defaults or may not be given by position."""
        args = self.tree.args
        if (
            args.posonlyargs
            or args.kwonlyargs
            or args.vararg
            or args.kwarg
            or args.defaults
        ):
            expected = (
                "a function whose arguments have no defaults and may be given by position"
            )
            raise self.error(self.tree, f"`{self.name}`; expected {expected}")

    def tested(self) -> set[str]:
        """Return names in conditions: a constant there decides which branch remains."""
        tests = [
            each.test
            for each in ast.walk(self.tree)
            if isinstance(each, ast.If | ast.IfExp)
        ]
        return set().union(*map(names_in, tests))

    def measured(self) -> set[str]:
        """Return arrays whose length is used here, or in a function that they are passed to."""
        found = set()
        for each in ast.walk(self.tree):
            match each:
                case ast.Attribute(value=ast.Name(id=name), attr="shape"):
                    found.add(name)
                case ast.Call(func=ast.Name(id="load" | "store")):
                    pass
                case ast.Call(args=arguments):
                    found |= {each.id for each in arguments if isinstance(each, ast.Name)}
        return found


def plain(function: Any) -> FunctionType:
    """Return a kernel's Python function."""
    return cast(FunctionType, getattr(function, "py_func", function))


def names_in(tree: ast.AST) -> set[str]:
    """Return the names in an expression or statement."""
    return {each.id for each in ast.walk(tree) if isinstance(each, ast.Name)}


def quoted(node: ast.AST) -> str:
    """Return the beginning of a node's source, in backquotes."""
    return f"`{ast.unparse(node).splitlines()[0]:.60}`"


@functools.cache
def parse(function: FunctionType) -> KernelFunction:
    """Read a function's source; the tree is shared, so copy it before changing it.

    Raises:
        ConfigError: the source cannot be read, or is not a ``def``.
    """
    name = f"{function.__module__}.{function.__name__}"
    try:
        lines, line = inspect.getsourcelines(function)
        tree = ast.parse(textwrap.dedent("".join(lines))).body[0]
    except (OSError, TypeError, SyntaxError):
        raise ConfigError(f"{name}: its source cannot be read") from None
    if not isinstance(tree, ast.FunctionDef):
        raise ConfigError(f"{name}: expected a function on the top level of a module")
    return KernelFunction(function, tree, Path(function.__code__.co_filename).name, line)
