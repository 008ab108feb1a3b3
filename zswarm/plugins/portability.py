"""Find what computes other bits on other machines, in the source of a simulator.

Only what the class reaches is read: its own code, and functions, classes and constants of its
package that it names. Types are unknown here, so counts are told apart by their form: a sum inside
``int(...)``, or of a comparison. ``frame`` only draws and is left out, as is a line with a comment
that begins with ``# portable:`` and gives the reason.
"""

import ast
import sys
from collections.abc import Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

PORTABLE = "of zswarm.kernels.portable"
SUM = f"adds floats in no fixed order; use ordered_sum or mean {PORTABLE}"
PRODUCT = "adds floats in no fixed order; write the sum of products as a loop"
LINALG = "has other bits on other machines; write it with + - * / and square roots"
NORM = f"adds floats in no fixed order; use norm or distances {PORTABLE}"
DRAW = "may change with its version; draw from zswarm.kernels.random.Stream(seed)"
GLOBAL_DRAW = f"is not seeded by the trial, and {DRAW}"
SEEDED = {"default_rng", "Generator", "PCG64", "Random", "RandomState", "SeedSequence"}
BUILTIN_SUM = (
    f"adds floats differently from Python 3.12 on; use ordered_sum {PORTABLE}, or int(sum(...)) "
    "for integers"
)
POWER = "has other last bits on other machines; use np.sqrt, or products"
OWN = {  # functions of ``portable`` by those of numpy and math
    **{name: name for name in ("exp", "log", "sin", "cos", "tanh", "atan2")},
    "arctan2": "atan2",
    "hypot": "norm",
    "dist": "norm",
}
OTHERS = (
    "tan asin acos atan arcsin arccos arctan sinh cosh asinh acosh atanh arcsinh arccosh arctanh "
    "exp2 expm1 log2 log10 log1p logaddexp pow power float_power cbrt erf erfc gamma lgamma sinc"
)
TRANSCENDENTAL = {*OWN, *OTHERS.split()}
SUMS = set(
    "sum nansum mean nanmean average std nanstd var nanvar trace trapezoid".split()
)
PRODUCTS = set("prod dot vdot inner matmul tensordot einsum convolve correlate".split())
METHODS = {"sum", "mean", "std", "var", "dot"}  # of arrays
HARMLESS = {"seed", "getstate", "setstate", "get_state", "set_state"}
REASON = "# portable:"
CONTRACT = "zswarm.sims.simulator"
SHARED_FOLDERS = {"site-packages", "dist-packages"}


class UnportableLine(NamedTuple):
    """A place that breaks the rule of equal bits."""

    file: Path
    line: int
    text: str  # what is wrong, and what to use instead

    def __str__(self) -> str:
        return f"{self.file}:{self.line}: {self.text}"


def findings(simulator_class: type) -> list[UnportableLine]:
    """Return what breaks the rule of equal bits in a class and what it reaches, by place.

    Classes without source, such as those of third-party programs, have no findings.
    """
    source = _Source(simulator_class.__module__)
    waiting = [(source.name, simulator_class.__qualname__.partition(".")[0])]
    sources, seen, found = {source.name: source}, set(waiting), set[UnportableLine]()
    while waiting:
        module, name = waiting.pop()
        if module not in sources:
            sources[module] = _Source(module)
        source = sources[module]
        for node in source.defined.get(name, ()):
            found.update(_Reader(source, node).findings())
        more = {
            each for each in source.reached(name) if _is_own(each[0], simulator_class)
        }
        waiting += more - seen
        seen |= more
    return sorted(found)


def _is_own(module: str, simulator_class: type) -> bool:
    """Return whether a module belongs to the simulator, not to a library."""
    own = simulator_class.__module__
    package, root = own.partition(".")[0], module.partition(".")[0]
    if package == "zswarm":
        return module.startswith("zswarm.sims.") and module != CONTRACT
    if root == package:
        return True
    folders = [_file(name).parent for name in (root, package)]
    return folders[0] == folders[1] and folders[0].name not in SHARED_FOLDERS


def _file(module: str) -> Path:
    found = getattr(sys.modules.get(module), "__file__", None) or ""
    return Path(found if found.endswith(".py") else "no source")


class _Source:
    """An imported module's source.

    Attributes:
        imported: full dotted names by local names.
        defined: the top-level statements that define or change each name.
    """

    def __init__(self, name: str) -> None:
        self.name, self.file = name, _file(name)
        self.text = self.file.read_text(encoding="utf-8") if self.file.is_file() else ""
        self.lines = self.text.splitlines()
        self.tree = ast.parse(self.text)

    @cached_property
    def imported(self) -> dict[str, str]:
        found = {}
        for node in ast.walk(self.tree):
            match node:
                case ast.Import(names=names):
                    for name in names:
                        root = name.name.partition(".")[0]
                        found[name.asname or root] = name.name if name.asname else root
                case ast.ImportFrom(names=names):
                    for name in names:
                        found[name.asname or name.name] = (
                            f"{self._origin(node)}.{name.name}"
                        )
        return found

    def _origin(self, node: ast.ImportFrom) -> str:
        """Return the absolute name of the module that an import statement names."""
        if not node.level:
            return node.module or ""
        up = node.level - (self.file.name == "__init__.py")
        parts = self.name.split(".")
        parts = parts[: len(parts) - up]
        return ".".join([*parts, *([node.module] if node.module else [])])

    @cached_property
    def defined(self) -> dict[str, list[ast.stmt]]:
        found: dict[str, list[ast.stmt]] = {}
        for statement in self.tree.body:
            for name in _names(statement):
                found.setdefault(name, []).append(statement)
        return found

    def reached(self, name: str) -> Iterator[tuple[str, str]]:
        """Yield module and name of all that the statements of a name mention."""
        for statement in self.defined.get(name, ()):
            for node in _walk(statement):
                if isinstance(node, ast.Name | ast.Attribute):
                    full = self.full_name(node)
                    if full in self.defined:
                        yield self.name, full
                    elif "." in full:
                        module, _, attribute = full.rpartition(".")
                        yield module, attribute

    def full_name(self, node: ast.AST) -> str:
        """Return a dotted name with its imports resolved; "" for other expressions."""
        if isinstance(node, ast.Name):
            return self.imported.get(node.id, node.id)
        if isinstance(node, ast.Attribute) and (of := self.full_name(node.value)):
            return f"{of}.{node.attr}"
        return ""


def _names(statement: ast.stmt) -> set[str]:
    """Return the names that a top-level statement defines or changes."""
    if isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        return {statement.name}
    targets: Sequence[ast.expr] = ()
    if isinstance(statement, ast.Assign):
        targets = statement.targets
    elif isinstance(statement, ast.AnnAssign | ast.AugAssign):
        targets = [statement.target]
    found = {
        node.id
        for target in targets
        for node in ast.walk(target)
        if isinstance(node, ast.Name)
    }
    for inner in ast.iter_child_nodes(statement):
        if isinstance(inner, ast.stmt):  # of an if, for or try
            found |= _names(inner)
    return found


def _walk(node: ast.AST) -> Iterator[ast.AST]:
    """Yield a node and those in it, but nothing of a method ``frame``."""
    yield node
    for inner in ast.iter_child_nodes(node):
        if not (isinstance(inner, ast.FunctionDef) and inner.name == "frame"):
            yield from _walk(inner)


class _Reader:
    """Read one statement of a module."""

    def __init__(self, source: _Source, statement: ast.stmt) -> None:
        self._source, self._nodes = source, list(_walk(statement))
        self._counts, self._arguments = set[ast.AST](), dict[ast.AST, ast.AST | None]()
        for node in self._nodes:
            if isinstance(node, ast.Call):
                self._arguments[node.func] = node.args[0] if node.args else None
                if isinstance(node.func, ast.Name) and node.func.id in {"int", "bool"}:
                    inside = [each for each in node.args if isinstance(each, ast.Call)]
                    self._counts.update(each.func for each in inside)

    def findings(self) -> Iterator[UnportableLine]:
        """Yield what is wrong in the statement."""
        for node in self._nodes:
            text = self._wrong(node)
            line = getattr(node, "lineno", 0)
            if text and REASON not in self._source.lines[line - 1]:
                yield UnportableLine(self._source.file, line, text)

    def _wrong(self, node: ast.AST) -> str:
        match node:
            case ast.BinOp(op=ast.MatMult()) | ast.AugAssign(op=ast.MatMult()):
                return f"@ {PRODUCT}"
            case ast.BinOp(op=ast.Pow(), right=ast.Constant(float(power))):
                return f"** {power} {POWER}"
            case ast.Name() | ast.Attribute() if not self._is_count(node):
                return self._wrong_name(node)
        return ""

    def _wrong_name(self, node: ast.Name | ast.Attribute) -> str:
        full = self._source.full_name(node)
        library, _, name = full.partition(".")
        if full == "sum" and "sum" not in self._source.defined:
            return f"sum {BUILTIN_SUM}"
        if library in {"numpy", "math", "cmath"} and name:
            return _of_library(full.replace("numpy.", "np."), name)
        if library == "random" and name and name not in HARMLESS:
            return f"{full} {_of_generator(name)}"
        if isinstance(node, ast.Name) or node not in self._arguments:
            return ""
        modules = {each.partition(".")[0] for each in self._source.imported.values()}
        if node.attr in METHODS and library not in modules:
            return f".{node.attr}() {PRODUCT if node.attr == 'dot' else SUM}"
        return ""

    def _is_count(self, node: ast.Name | ast.Attribute) -> bool:
        """Return whether a function counts: its result becomes an integer, or it adds booleans."""
        if node in self._counts:
            return True
        of = node.value if isinstance(node, ast.Attribute) else None
        return any(map(_is_condition, (of, self._arguments.get(node))))


def _of_generator(name: str) -> str:
    """Return what is wrong with a function that draws, or makes a generator that does."""
    return DRAW if name.partition(".")[0] in SEEDED else GLOBAL_DRAW


def _of_library(shown: str, name: str) -> str:
    """Return what is wrong with a function of numpy or math; "" if nothing is."""
    if name.startswith("random.") and name.partition(".")[2] not in HARMLESS:
        return f"{shown} {_of_generator(name.partition('.')[2])}"
    if name.startswith(("linalg.", "fft.")):
        return f"{shown} {NORM if name == 'linalg.norm' else LINALG}"
    if name in TRANSCENDENTAL:
        use = (
            f"use {OWN[name]} {PORTABLE}" if name in OWN else f"use functions {PORTABLE}"
        )
        return f"{shown} has other last bits on other machines; {use}"
    if shown.startswith("np.") and name in SUMS | {"add.reduce"}:
        return f"{shown} {SUM}"
    return f"{shown} {PRODUCT}" if shown.startswith("np.") and name in PRODUCTS else ""


def _is_condition(node: ast.AST | None) -> bool:
    """Return whether an expression is an array of booleans by its form."""
    match node:
        case ast.Compare():
            return True
        case ast.UnaryOp(op=ast.Invert() | ast.Not(), operand=inner):
            return _is_condition(inner)
        case ast.BinOp(left=left, op=ast.BitAnd() | ast.BitOr(), right=right):
            return _is_condition(left) or _is_condition(right)
        case ast.GeneratorExp(elt=element):
            return _is_condition(element) or isinstance(element, ast.Constant)
    return False
