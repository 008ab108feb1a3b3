"""Kernels as plain Python text: functions, all that they call, and the constants that they use.

It is the source that is compiled for evolution, without decorators, annotations and comments. It
needs numpy only.
"""

import ast
import base64
import builtins
import copy
import textwrap
from collections.abc import Callable, Iterable
from types import FunctionType
from typing import Any

import numpy as np

from zswarm.errors import ConfigError
from zswarm.robots.c.kernel_function import parse, plain

TYPES = set(
    "bool_ int8 int16 int32 int64 uint8 uint16 uint32 uint64 float32 float64".split()
)
SHOWN = 32  # longer arrays are packed
WIDTH = 100  # columns of packed numbers


def functions(roots: Iterable[Callable[..., Any]]) -> str:
    """Return the text of functions and of all that they use; it needs ``import numpy as np``.

    The functions keep their names; what they use is renamed where two things have the same name.
    """
    gathered = _Gathered()
    plain_roots = [plain(root) for root in roots]
    for root in plain_roots:
        gathered.name(root, root)
    for root in plain_roots:
        gathered.add(root)
    return (
        "\n".join([*gathered.constants, *(f"\n\n{text}" for text in gathered.texts)])
        + "\n"
    )


def packed(array: np.ndarray) -> str:
    """Return an expression that gives an array of any shape, exactly."""
    little = array.astype(array.dtype.newbyteorder("<"))
    lines = textwrap.wrap(base64.b64encode(little.tobytes()).decode(), WIDTH)
    text = "".join(f'\n    "{line}"' for line in lines) or '""'
    kind = f'"{little.dtype.str}").astype(np.{array.dtype.name})'
    return f"np.frombuffer(base64.b64decode({text}\n), {kind}"


class _Gathered:
    """Functions and constants found so far.

    Attributes:
        constants: lines, in the order in which they are found.
        texts: of functions, each after those that it calls.
    """

    def __init__(self) -> None:
        self.constants: list[str] = []
        self.texts: list[str] = []
        self._names: dict[str, object] = {}  # values: a function, or a constant's text
        self._added: set[FunctionType] = set()

    def name(
        self, thing: FunctionType | str, function: FunctionType, wanted: str = ""
    ) -> str:
        """Return the name of a thing: its own if that is free, else with the module's."""
        own, module = wanted or function.__name__, function.__module__
        for name in (own, f"{own}_of_{module.rpartition('.')[2]}"):
            if self._names.setdefault(name, thing) == thing:
                return name
        raise ConfigError(f"{module}: has several things with the name {own}")

    def add(self, function: FunctionType) -> None:
        """Add a function after all that it uses, unless it was added before."""
        if function in self._added:
            return
        self._added.add(function)
        tree = copy.deepcopy(parse(function).tree)
        if function.__closure__:
            raise ConfigError(f"{_where(function)}: expected a function on the top level")
        tree.decorator_list, tree.returns = [], None
        local = {*function.__code__.co_varnames, *function.__code__.co_cellvars}
        renamed: dict[str, str] = {}
        for node in ast.walk(tree):
            if isinstance(node, ast.arg):
                node.annotation = None
        for node in ast.walk(tree):
            if isinstance(node, ast.Name) and node.id not in local | renamed.keys():
                renamed[node.id] = self._use(function, node.id)
        tree.name = self.name(function, function)
        self.texts.append(ast.unparse(_Renamed(renamed).visit(tree)))

    def _use(self, function: FunctionType, name: str) -> str:
        """Gather what a global name stands for, and return its name in the text."""
        if name not in function.__globals__:
            if hasattr(builtins, name):
                return name
            raise ConfigError(f"{_where(function)} uses {name}, which is not defined")
        value = function.__globals__[name]
        if value is np:
            return "np"
        if isinstance(used := plain(value), FunctionType):
            self.add(used)
            return self.name(used, used)
        # Types of numpy have __name__, those of numba name.
        kind = getattr(value, "__name__", None) or getattr(value, "name", None)
        if kind in TYPES and not isinstance(value, np.ndarray):
            return f"np.{kind}"
        text = _constant(value)
        if text is None:
            raise ConfigError(
                f"{_where(function)} uses {name}, of type {type(value).__name__}: "
                "only functions, numbers and arrays of numbers can be exported"
            )
        before = set(self._names)
        known = self.name(text, function, name)
        if known not in before:
            self.constants.append(f"{known} = {text}")
        return known


class _Renamed(ast.NodeTransformer):
    """Replaces global names by those in the gathered text."""

    def __init__(self, names: dict[str, str]) -> None:
        self._names = names

    def visit_Name(self, node: ast.Name) -> ast.AST:
        known = self._names.get(node.id, node.id)
        return ast.copy_location(ast.parse(known, mode="eval").body, node)


def _where(function: FunctionType) -> str:
    return f"{function.__module__}.{function.__name__}"


def _constant(value: object) -> str | None:
    """Return an expression that gives a number or an array exactly; None for anything else."""
    match value:
        case np.generic() if value.dtype.name in TYPES:
            return f"np.{value.dtype.name}({_float(value.item())})"
        case np.ndarray() if value.dtype.name in TYPES and value.ndim == 1:
            if value.size > SHOWN:
                return packed(value)
            return f"np.array([{', '.join(map(_float, value.tolist()))}], np.{value.dtype.name})"
        case bool() | int():
            return repr(value)
        case float():
            return _float(value)
    return None


def _float(value: float) -> str:
    is_finite = value - value == 0
    return repr(value) if is_finite else f'float("{value!r}")'
