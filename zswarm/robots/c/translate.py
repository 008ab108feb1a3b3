"""Functions of kernels as C99, translated from their Python source: robots run what evolved.

A function is translated for the types of the arguments that it is called with, and for the
constants among them that its branches test; so are the functions that it calls. Constants are
inserted, and branches that they rule out are left out. The subset of Python is what numba compiles
alike: numbers, flat arrays, ``if``, ``for`` over ``range``, ``while``, calls of such functions, and
the functions of ``lanes.py`` that work in each lane separately.
"""

import ast
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from zswarm.robots.c.c_file import CFile, CSource
from zswarm.robots.c.c_types import NOTHING, Array, Type, identifier, spelled
from zswarm.robots.c.kernel_function import KernelFunction, names_in, parse, plain
from zswarm.robots.c.operations import Operations
from zswarm.robots.c.quoting import c_comment
from zswarm.robots.c.scopes import assigned, scope
from zswarm.robots.c.statements import Statements
from zswarm.robots.c.tree import INDENT, Callee, Local, Value, drop_unused, render


def functions(
    wanted: Sequence[tuple[Callable[..., Any], Mapping[str, Type]]], prefix: str
) -> CSource:
    """Translate kernels, and all functions that they call.

    Each becomes ``<prefix>_<its name>``, with all its arguments in their order.

    Args:
        wanted: functions, each with the types of its arguments by name, such as ``FLOAT64`` or
            ``Array(FLOAT32, 180)``.
        prefix: of all names, an identifier of C.

    Raises:
        ConfigError: something cannot be translated; the text names it and its line.
    """
    unit = Translation(prefix)
    names = [unit.name(spelled(plain(function).__name__)) for function, _ in wanted]
    for name, (function, types) in zip(names, wanted, strict=True):
        source = parse(plain(function))
        given = [Value(types[each], identifier(each)) for each in source.arguments]
        unit.add_function(source, given, name, public=True)
    return unit.source()


class Translation(CFile):
    """A C file to which functions are added with all that they call."""

    def __init__(self, prefix: str) -> None:
        super().__init__(prefix)
        self._done: dict[Any, Callee | None] = {}  # None: under way

    def add_function(
        self,
        source: KernelFunction,
        given: Sequence[Value],
        name: str = "",
        *,
        public: bool = False,
    ) -> Callee:
        """Translate a function for such arguments; a public one takes all of them."""
        names = source.arguments
        body = self._body(source, dict(zip(names, given, strict=True)))
        text = "\n".join(render(drop_unused(body.lines)))
        words = set(re.findall(r"\w+", text))
        unread = [at for at, each in enumerate(names) if identifier(each) not in words]
        variable = [at for at, value in enumerate(given) if value.constant is None]
        takes = tuple(at for at in variable if public or at not in unread)
        writes = tuple(at for at in takes if names[at] in body.written)
        if public:  # compilers warn of unused arguments
            void = [f"{INDENT}(void){identifier(names[at])};\n" for at in unread]
            text = "".join(void) + text
        callee = Callee(
            name or self.name(spelled(source.name)), takes, writes, body.result
        )
        parameters = [_parameter(names[at], given[at], at in writes) for at in takes]
        head = f"{body.result.c} {callee.name}({', '.join(parameters) or 'void'})"
        self.add(head, _remark(source), text, public=public)
        return callee

    def _callee(
        self, caller: Operations, function: Any, given: Sequence[Value]
    ) -> Callee:
        """Return a function for the arguments of a call; translate it if that was not done."""
        source = parse(function)
        names = source.arguments
        if len(names) != len(given):
            count = f"{len(given)} arguments; expected {len(names)}"
            raise caller.error(f"`{source.name}` with {count}")
        tested, measured = source.tested() - set(assigned(source.tree)), source.measured()
        bound = []
        for name, value in zip(names, given, strict=True):
            of = value.type
            if isinstance(of, Array) and name not in measured:
                of = Array(of.element)
            is_inserted = name in tested and not isinstance(of, Array)
            bound.append(
                value._replace(type=of, constant=value.constant if is_inserted else None)
            )
        # By their text: 0.0 equals -0.0, and NaN differs from itself.
        key = (source.plain, *((value.type, repr(value.constant)) for value in bound))
        if key not in self._done:
            self._done[key] = None
            self._done[key] = self.add_function(source, bound)
        callee = self._done[key]
        if callee is None:
            raise caller.error(f"`{source.name}` calls itself")
        return callee

    def _body(self, source: KernelFunction, arguments: Mapping[str, Value]) -> Statements:
        """Translate the statements of a function until the types of its variables are settled."""
        source.check()
        body = Statements(
            self,
            source,
            self._callee,
            names_in(source.tree) | arguments.keys(),
            source.tree,
            scope=scope(source.tree, arguments),
            arguments=set(arguments),
        )
        while body.lane in body.names:
            body.lane += "8"
        constants = {
            name: each for name, each in arguments.items() if each.constant is not None
        }
        for name in arguments.keys() - constants:
            body.locals[name] = Local(arguments[name].type, identifier(name))
        settled, types = False, ""
        while not settled:
            body.constants = constants.copy()
            body.lines = []
            body.made = 0
            body.declared = set(arguments)
            body.written = set()
            ends = body.block(source.tree.body)
            before, types = types, repr((body.locals, body.result))
            settled = types == before
        if body.result != NOTHING and not ends:
            raise source.error(
                source.tree, f"`{source.name}`: some path ends without a value"
            )
        return body


def _remark(source: KernelFunction) -> str:
    """Return the first line of a docstring as a comment."""
    about = (ast.get_docstring(source.tree) or "").split("\n")[0]
    return f"/* {c_comment(about)} */\n" if about else ""


def _parameter(name: str, given: Value, is_written: bool) -> str:
    if isinstance(given.type, Array):
        return (
            f"{'' if is_written else 'const '}{given.type.element.c} *{identifier(name)}"
        )
    return f"{given.element.c} {identifier(name)}"
