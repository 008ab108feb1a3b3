"""Functions of kernels as C99, from their own Python source: what evolved is what robots run.

A function is translated for the types of the arguments that it is called with, and for the numbers among them that its branches
ask for; so are those that it calls. Numbers that are known (settings, sizes, what stands in a controller's parameters) are put
in, and branches that they rule out are left out. The subset of Python is what numba compiles alike: numbers, flat arrays,
``if``, ``for`` over ``range``, ``while``, calls of such functions, and of ``lanes.py`` what works in each lane for itself.
"""

import ast
import functools
import inspect
import re
import textwrap
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from zswarm import lanes
from zswarm.errors import ConfigError
from zswarm.robots.c_types import SCALARS, Array, Scalar, Together, Type, comment, identifier, literal, spelled
from zswarm.robots.expressions import SPECIAL, Expressions, key
from zswarm.robots.pieces import INDENT, LIBRARY, Local, Value, rendered, without_idle
from zswarm.robots.scopes import assigned, scope
from zswarm.robots.statements import Statements

PER_LINE = 6  # numbers of a table
PASSES = 8  # until the types of a function's variables are settled


class Callee(NamedTuple):
    """A function in C.

    Attributes:
        takes: which of its arguments it takes, the others are known or never read.
        writes: which of these are arrays that it changes.
    """

    name: str
    takes: tuple[int, ...]
    writes: tuple[int, ...]
    result: Type | None


class Source(NamedTuple):
    """C of some functions: headers that they include, what other files need to know of them, and all the rest."""

    includes: str
    declarations: str
    definitions: str


def functions(wanted: Sequence[tuple[Callable[..., Any], Mapping[str, Type]]], prefix: str) -> Source:
    """Functions of kernels, and all that they call.

    Each becomes ``<prefix>_<its name>``, with all its arguments in their order.

    Args:
        wanted: functions, each with the types of its arguments by their names, such as ``FLOAT64`` or ``Array(FLOAT32, 180)``.
        prefix: of all names, an identifier of C.

    Returns:
        includes: lines that both others need.
        declarations: prototypes, and structs of tuples that are returned.
        definitions: without those declarations.

    Raises:
        ConfigError: something cannot be said in C; the text says what and where.
    """
    unit = Translation(prefix)
    names = [unit.name(spelled(_plain(function).__name__)) for function, _ in wanted]
    for name, (function, types) in zip(names, wanted, strict=True):
        unit.public(name, function, types)
    return Source(unit.includes(), unit.declarations(), unit.definitions())


class Translation:
    """Functions that are translated together, in the order in which C must know them."""

    def __init__(self, prefix: str) -> None:
        self.prefix = prefix
        self.uses_math = False
        self._prototypes: list[str] = []
        self._structs: dict[str, str] = {}
        self._of_interface: set[str] = set()  # structs that public functions return
        self._library: dict[str, str] = {}
        self._tables: dict[tuple[str, bytes, str], str] = {}
        self._table_texts: list[str] = []
        self._bodies: list[str] = []
        self._done: dict[Any, Callee] = {}
        self._under_way: list[Any] = []
        self._names: set[str] = set()

    def public(self, name: str, function: Callable[..., Any], types: Mapping[str, Type]) -> None:
        """A function that other files call, by a name of this file."""
        tree = _parsed(_plain(function))
        given = [Value(types[each.arg], identifier(each.arg)) for each in tree.args.args]
        self._translated(_plain(function), tree, given, name, public=True)

    def entry(self, name: str, function: Any, given: Sequence[Value]) -> Callee:
        """A function where all begins, for such arguments; tables among them are known number by number."""
        plain = _plain(function)
        return self._translated(plain, _parsed(plain), given, self.name(name))

    def function(self, caller: Expressions, node: ast.AST, function: Any, given: Sequence[Value]) -> Callee:
        """A function that one of these calls, for such arguments."""
        plain = _plain(function)
        tree = _parsed(plain)
        names = [each.arg for each in tree.args.args]
        if len(names) != len(given):
            raise caller.refusal(node, f"`{plain.__name__}` with {len(given)} arguments of {len(names)}")
        asked, measured = _asked(tree) - set(assigned(tree)), _measured(tree)
        bound = []
        for name, value in zip(names, given, strict=True):
            if isinstance(value.type, Array):
                length = value.type.length if name in measured else None
                bound.append(value._replace(type=Array(value.type.element, length), constant=None))
            else:
                bound.append(value._replace(constant=value.constant if name in asked else None))
        wanted = (plain, tuple((value.type, None if value.constant is None else repr(value.constant)) for value in bound))
        if wanted in self._under_way:
            raise caller.refusal(node, f"`{plain.__name__}` calls itself")
        if wanted not in self._done:
            self._under_way.append(wanted)
            self._done[wanted] = self._translated(plain, tree, bound)
            self._under_way.pop()
        return self._done[wanted]

    def _translated(
        self, plain: Any, tree: ast.FunctionDef, given: Sequence[Value], name: str = "", *, public: bool = False
    ) -> Callee:
        """Translate a function until the types of its variables are settled, and keep its text."""
        arguments = {each.arg: value for each, value in zip(tree.args.args, given, strict=True)}
        body = self._body(plain, tree, arguments)
        text = "\n".join(rendered(without_idle(body.pieces), 1))
        read = [bool(re.search(rf"\b{identifier(each)}\b", text)) for each in arguments]
        takes = [at for at, value in enumerate(given) if value.constant is None and (public or read[at])]
        if public:
            text = (
                "".join(
                    f"{INDENT}(void){identifier(each)};\n" for each, is_read in zip(arguments, read, strict=True) if not is_read
                )
                + text
            )
        names = list(arguments)
        callee = Callee(
            name or self.name(spelled(plain.__name__)),
            tuple(takes),
            tuple(at for at in takes if names[at] in body.written),
            body.result,
        )
        self._keep(callee, tree, [(names[at], given[at].type) for at in takes], body.written, text, public=public)
        return callee

    def _body(self, plain: Any, tree: ast.FunctionDef, arguments: Mapping[str, Value]) -> Statements:
        """The statements of a function, in C."""
        file, first_line = _where(plain)
        known = {**plain.__globals__, **inspect.getclosurevars(plain).nonlocals}
        body = Statements(self, plain.__name__, file, first_line, known)
        body.scope, body.arguments = scope(tree), frozenset(arguments)
        body.names = {each.id for each in ast.walk(tree) if isinstance(each, ast.Name)} | set(arguments)
        body.lane = next(f"lane{'8' * times}" for times in range(len(body.names) + 1) if f"lane{'8' * times}" not in body.names)
        for name in arguments:
            body.scope.give(name)
        ends = False
        for _ in range(PASSES):
            before = repr((body.locals, body.result))
            body.constants = {name: value for name, value in arguments.items() if value.constant is not None}
            body.pieces, body.made, body.declared, body.written = [], 0, set(arguments), set()
            for name, value in arguments.items():
                if value.constant is None:
                    body.locals[name] = Local(value.type, identifier(name))
            ends = body.block(tree.body)
            if repr((body.locals, body.result)) == before:
                break
        if body.result is not None and not ends:
            raise body.refusal(tree, f"`{plain.__name__}` ends without a value on some way")
        return body

    def _keep(
        self, callee: Callee, tree: ast.FunctionDef, taken: list[tuple[str, Type]], written: set[str], text: str, *, public: bool
    ) -> None:
        arguments = [_argument(name, type_, changes=name in written) for name, type_ in taken]
        result = callee.result
        c = result.c if isinstance(result, Scalar | Together) else "void"
        head = f"{c} {callee.name}({', '.join(arguments) or 'void'})"
        about = (ast.get_docstring(tree) or "").split("\n")[0]
        remark = f"/* {comment(about)} */\n" if about else ""
        if public:
            self._prototypes.append(f"{remark}{head};\n")
            if isinstance(result, Together):
                self._of_interface.add(result.c)
        self._bodies.append(f"{remark}{'' if public else 'static '}{head}\n{{\n{text}\n}}\n")

    def is_own(self, function: Any) -> bool:
        """Whether it is a function of kernels, which is translated as it stands, and not one that has a form in C of its own."""
        plain = _plain(function)
        return inspect.isfunction(plain) and key(plain) not in SPECIAL and plain.__module__ != lanes.__name__

    # ---- what functions share -----------------------------------------------------------------------------------

    def name(self, wanted: str) -> str:
        """A name of this file that is not taken."""
        name, number = f"{self.prefix}_{wanted}", 2
        while name in self._names:
            name, number = f"{self.prefix}_{wanted}_{number}", number + 1
        self._names.add(name)
        return name

    def library(self, which: str) -> str:
        """The name of a function of ``LIBRARY``, which is used."""
        if which not in self._library:
            self._library[which] = self.name(which)
        return self._library[which]

    def table(self, hint: str, numbers: Any) -> str:
        """The name of a table of constants."""
        key = (numbers.dtype.name, numbers.tobytes(), hint)
        if key not in self._tables:
            self._tables[key] = self.name(spelled(hint))
            texts = [literal(number) for number in numbers]
            lines = [", ".join(texts[begin : begin + PER_LINE]) for begin in range(0, len(texts), PER_LINE)]
            of = SCALARS[numbers.dtype.name].c
            body = f",\n{INDENT}".join(lines)
            text = f"static const {of} {self._tables[key]}[{len(numbers)}] = {{\n{INDENT}{body}\n}};\n"
            self._table_texts.append(text)
        return self._tables[key]

    def together(self, function: str, types: tuple[Scalar, ...], names: tuple[str, ...]) -> Together:
        """A struct for what a function returns."""
        name = self.name(f"{spelled(function)}_result")
        self._structs[name] = "".join(f"{INDENT}{each.c} {member};\n" for each, member in zip(types, names, strict=True))
        return Together(name, types, names)

    def declarations(self) -> str:
        """What other files need to know."""
        return "\n".join([*self._struct_texts(of_interface=True), *self._prototypes])

    def _struct_texts(self, *, of_interface: bool) -> list[str]:
        return [
            f"typedef struct {{\n{members}}} {name};\n"
            for name, members in self._structs.items()
            if (name in self._of_interface) == of_interface
        ]

    def includes(self) -> str:
        """The headers of C's library that are needed."""
        headers = ("float", "math", "stdbool", "stdint") if self.uses_math else ("float", "stdbool", "stdint")
        return "".join(f"#include <{header}.h>\n" for header in headers)

    def definitions(self) -> str:
        """All the rest; tables that no function names are left out."""
        bodies = [*(LIBRARY[which].format(name=name) for which, name in self._library.items()), *self._bodies]
        text = "\n".join(bodies)
        tables = [
            table for table, name in zip(self._table_texts, self._tables.values(), strict=True) if re.search(rf"\b{name}\b", text)
        ]
        return "\n".join([*self._struct_texts(of_interface=False), *tables, *bodies])


def _plain(function: Any) -> Any:
    """What was compiled, as it was written."""
    return getattr(function, "py_func", function)


def _argument(name: str, type_: Type, *, changes: bool) -> str:
    if isinstance(type_, Array):
        return f"{'' if changes else 'const '}{type_.element.c} *{identifier(name)}"
    assert isinstance(type_, Scalar)  # noqa: S101  functions are given numbers and arrays
    return f"{type_.c} {identifier(name)}"


@functools.cache
def _parsed(plain: Any) -> ast.FunctionDef:
    """A function's tree.

    Raises:
        ConfigError: its source is not there, or it is no plain function.
    """
    try:
        source = textwrap.dedent(inspect.getsource(plain))
    except (OSError, TypeError):
        raise ConfigError(f"{getattr(plain, '__name__', plain)}: cannot be said in C: its source cannot be read") from None
    (tree,) = ast.parse(source).body
    arguments = tree.args if isinstance(tree, ast.FunctionDef) else None
    if not isinstance(tree, ast.FunctionDef) or arguments is None or _is_special(arguments):
        file, line = _where(plain)
        raise ConfigError(f"{file}, line {line}: cannot be said in C: `{plain.__name__}`; plain functions of plain arguments can")
    return tree


def _is_special(arguments: ast.arguments) -> bool:
    return bool(arguments.posonlyargs or arguments.kwonlyargs or arguments.vararg or arguments.kwarg or arguments.defaults)


def _where(plain: Any) -> tuple[str, int]:
    return Path(inspect.getsourcefile(plain) or "?").name, inspect.getsourcelines(plain)[1]


def _asked(tree: ast.FunctionDef) -> set[str]:
    """Names in conditions: a number that is known there decides which branch is left."""
    tests = [each.test for each in ast.walk(tree) if isinstance(each, ast.If | ast.IfExp)]
    return {name.id for test in tests for name in ast.walk(test) if isinstance(name, ast.Name)}


def _measured(tree: ast.FunctionDef) -> set[str]:
    """Arrays whose length counts: here, or in what they are given to."""
    found = set()
    for each in ast.walk(tree):
        match each:
            case ast.Attribute(value=ast.Name(id=name), attr="shape"):
                found.add(name)
            case ast.Call(func=function, args=arguments) if not (
                isinstance(function, ast.Name) and function.id in ("load", "store")
            ):
                found |= {argument.id for argument in arguments if isinstance(argument, ast.Name)}
    return found
