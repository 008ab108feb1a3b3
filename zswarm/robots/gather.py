"""Kernels as plain Python text: functions, all that they call, and the constants that they use, in one namespace.

It is the source that is compiled for evolution, read from its files, without decorators, annotations and comments. Whoever runs
it needs numpy alone.
"""

import ast
import base64
import builtins
import inspect
import textwrap
from collections.abc import Callable, Iterable
from types import FunctionType
from typing import Any, cast

import numpy as np

from zswarm.errors import ConfigError

TYPES = {"bool_", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64", "float32", "float64"}
SHOWN = 32  # numbers of an array that are written out; more are packed
WIDTH = 100  # columns of packed numbers


def functions(roots: Iterable[Callable[..., Any]]) -> str:
    """The text of functions and of all that they use; it needs ``import numpy as np`` before it.

    Args:
        roots: kernels or plain functions; they keep their names, what they use is renamed where two things have one name.

    Raises:
        ConfigError: one uses what is no function, number, array or numpy.
    """
    gathered = _Gathered()
    plain_roots = [plain(root) for root in roots]
    for root in plain_roots:
        gathered.name(root, root)
    for root in plain_roots:
        gathered.add(root)
    return "\n".join([*gathered.constants, *(f"\n\n{text}" for text in gathered.texts)]) + "\n"


def plain(function: Callable[..., Any]) -> FunctionType:
    """A kernel's Python function."""
    return cast(FunctionType, getattr(function, "py_func", function))


def packed(array: np.ndarray) -> str:
    """An expression that gives an array of any shape again, exactly."""
    little = array.astype(array.dtype.newbyteorder("<"))
    lines = textwrap.wrap(base64.b64encode(little.tobytes()).decode(), WIDTH)
    text = "".join(f'\n    "{line}"' for line in lines) or '""'
    return f'np.frombuffer(base64.b64decode({text}\n), "{little.dtype.str}").astype(np.{array.dtype.name})'


class _Gathered:
    """What was found so far.

    Attributes:
        constants: lines, in the order in which they are found.
        texts: of functions, each behind those that it calls.
    """

    def __init__(self) -> None:
        self.constants: list[str] = []
        self.texts: list[str] = []
        self._names: dict[str, object] = {}  # what each name stands for: a function, or a constant's text
        self._added: set[FunctionType] = set()

    def name(self, thing: FunctionType | str, function: FunctionType, wanted: str = "") -> str:
        """The name under which a thing goes, its own if that is free."""
        own = wanted or function.__name__
        for name in (own, f"{own}_of_{function.__module__.rpartition('.')[2]}"):
            if self._names.setdefault(name, thing) == thing:
                return name
        raise ConfigError(f"{function.__module__}: has several things with the name {own}")

    def add(self, function: FunctionType) -> None:
        """A function, once, behind what it uses."""
        if function in self._added:
            return
        self._added.add(function)
        tree = _tree(function)
        renamed = {name: self._use(function, name) for name in _globals(tree, function)}
        tree.name = self.name(function, function)
        self.texts.append(ast.unparse(_Renamed(renamed).visit(tree)))

    def _use(self, function: FunctionType, name: str) -> str:
        """What a function calls by a global name is gathered; under which name it is there."""
        value = function.__globals__[name]
        if value is np:
            return "np"
        if isinstance(plain(value), FunctionType):
            self.add(plain(value))
            return self.name(plain(value), plain(value))
        kind = getattr(value, "__name__", None) or getattr(value, "name", None)  # of numpy's types, and of numba's
        if kind in TYPES and not isinstance(value, np.ndarray):
            return f"np.{kind}"
        text = _constant(value)
        if text is None:
            what = f"{function.__module__}.{function.__name__} uses {name}, of type {type(value).__name__}"
            raise ConfigError(f"{what}: only functions, numbers and arrays of numbers can be exported")
        before = set(self._names)
        known = self.name(text, function, name)
        if known not in before:
            self.constants.append(f"{known} = {text}")
        return known


class _Renamed(ast.NodeTransformer):
    """Global names as they are in the gathered text."""

    def __init__(self, names: dict[str, str]) -> None:
        self._names = names

    def visit_Name(self, node: ast.Name) -> ast.AST:
        known = self._names.get(node.id)
        return node if known is None else ast.copy_location(ast.parse(known, mode="eval").body, node)


def _tree(function: FunctionType) -> ast.FunctionDef:
    """A function's own source, without decorators and annotations.

    Raises:
        ConfigError: there is none, or it is no plain function.
    """
    where = f"{function.__module__}.{function.__name__}"
    try:
        tree = ast.parse(textwrap.dedent(inspect.getsource(function))).body[0]
    except (OSError, TypeError, SyntaxError):
        raise ConfigError(f"{where}: its source cannot be read") from None
    if not isinstance(tree, ast.FunctionDef) or function.__closure__:
        raise ConfigError(f"{where}: expected a function on the top level of a module")
    tree.decorator_list, tree.returns = [], None
    for argument in [*tree.args.posonlyargs, *tree.args.args, *tree.args.kwonlyargs]:
        argument.annotation = None
    return tree


def _globals(tree: ast.FunctionDef, function: FunctionType) -> list[str]:
    """The global names that it reads, in their order.

    Raises:
        ConfigError: one that is not there.
    """
    local = {*function.__code__.co_varnames, *function.__code__.co_cellvars}
    read = (node.id for node in ast.walk(tree) if isinstance(node, ast.Name))
    names = [name for name in dict.fromkeys(read) if name not in local]
    for name in names:
        if name not in function.__globals__ and not hasattr(builtins, name):
            raise ConfigError(f"{function.__module__}.{function.__name__} uses {name}, which is not there")
    return [name for name in names if name in function.__globals__]


def _constant(value: object) -> str | None:
    """An expression that gives a number or an array of them again, exactly; None for anything else."""
    match value:
        case bool() | int() if not isinstance(value, np.generic):
            return repr(value)
        case float() if not isinstance(value, np.generic):
            return _float(value)
        case np.generic() if value.dtype.name in TYPES:
            return f"np.{value.dtype.name}({_float(value.item())})"
        case np.ndarray() if value.dtype.name in TYPES and value.ndim == 1:
            if value.size > SHOWN:
                return packed(value)
            return f"np.array([{', '.join(map(_float, value.tolist()))}], np.{value.dtype.name})"
    return None


def _float(value: float) -> str:
    return repr(value) if value - value == 0 else f'float("{value!r}")'
