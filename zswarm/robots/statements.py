"""Statements of kernels as C99: variables are declared where all that use them see them, lanes are loops over eight numbers."""

import ast
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from zswarm import lanes
from zswarm.lanes import LANES
from zswarm.robots.c_types import BOOL, INT64, WHOLE, Array, Lanes, Scalar, Together, Type, identifier, joined
from zswarm.robots.expressions import SIGNS, Expressions, Local, Piece, Value

LOOPS = (ast.For, ast.While)
Path = tuple[tuple[int, int], ...]  # of a statement: from outside in, which list of statements, and which of them


@dataclass
class Statements(Expressions):
    """The body of one function."""

    assigned: Counter[str] = field(default_factory=Counter)
    here: set[str] = field(default_factory=set)  # variables that are declared by their first assignment
    before: dict[int, list[str]] = field(default_factory=dict)  # by a statement's id: those declared in front of it
    declared: set[str] = field(default_factory=set)
    result: Type | None = None
    loops: Counter[str] = field(default_factory=Counter)  # that a name counts
    counters: set[str] = field(default_factory=set)  # of loops that are open

    def prepare(self, function: ast.FunctionDef, arguments: Sequence[str]) -> None:
        """Look at where variables are assigned and used."""
        self.assigned.update(_assigned(function))
        for name in arguments:
            if self.assigned[name]:
                self.refuse(function, f"the argument `{name}` is assigned to")
        for each in ast.walk(function):
            if isinstance(each, ast.For) and isinstance(each.target, ast.Name):
                self.loops[each.target.id] += 1
        self.names = {each.id for each in ast.walk(function) if isinstance(each, ast.Name)} | set(arguments)
        self.lane = "lane"
        while self.lane in self.names:
            self.lane += "8"
        for name, paths in _occurrences(function.body).items():
            if self.assigned[name] > self.loops[name]:
                self._declare_for(function.body, name, paths)

    def _declare_for(self, body: list[ast.stmt], name: str, paths: list[Path]) -> None:
        """Choose where a variable is declared."""
        depth = 0
        while all(len(path) > depth + 1 for path in paths) and len({(path[depth], path[depth + 1][0]) for path in paths}) == 1:
            depth += 1
        first = _statement(body, min(paths)[: depth + 1])
        if len(min(paths)) == depth + 1 and isinstance(first, ast.Assign | ast.AnnAssign):
            self.here.add(name)
            return
        for outer in range(depth):
            if isinstance(_statement(body, min(paths)[: outer + 1]), LOOPS):
                depth = outer  # it may keep its value from turn to turn
                break
        first = _statement(body, min(paths)[: depth + 1])
        self.before.setdefault(id(first), []).append(name)

    def block(self, body: Sequence[ast.stmt]) -> bool:
        """Statements; returns whether the last one ends the function."""
        for statement in body:
            for name in self.before.get(id(statement), ()):
                if name in self.locals:
                    self._declare(name)
            if self.statement(statement):
                return True
        return False

    def statement(self, node: ast.stmt) -> bool:
        """One statement; returns whether it ends the function."""
        match node:
            case ast.Expr(value=ast.Constant()) | ast.Pass():
                return False
            case ast.Assign(targets=[ast.Name(id=name)], value=value):
                self._assign(node, name, value)
            case ast.AnnAssign(target=ast.Name(id=name), value=ast.expr() as value):
                self._assign(node, name, value)
            case ast.Assign(targets=[ast.Subscript() as target], value=value):
                self._put(target, self.value(value))
            case ast.Assign(targets=[ast.Tuple(elts=targets)], value=value):
                self._assign_together(node, targets, value)
            case ast.AugAssign(target=ast.Name(id=name), op=op, value=value) if type(op) in SIGNS:
                self._assign(node, name, ast.copy_location(ast.BinOp(ast.Name(name), op, value), node))
            case ast.AugAssign(target=ast.Subscript() as target, op=op, value=value) if type(op) in SIGNS:
                self._put(target, self.operation(node, SIGNS[type(op)], self.value(target), self.value(value)))
            case ast.Expr(value=ast.Call() as call):
                self._do(call)
            case ast.If():
                return self._if(node)
            case ast.For(target=ast.Name(id=name), orelse=[]):
                self._for(node, name)
            case ast.While(orelse=[]):
                return self._while(node)
            case ast.Return():
                self._return(node)
                return True
            case ast.Break():
                self.pieces.append(Piece("break;"))
            case ast.Continue():
                self.pieces.append(Piece("continue;"))
            case _:
                self.refuse(node, f"`{ast.unparse(node).splitlines()[0]:.60}`")
        return False

    # ---- assignments --------------------------------------------------------------------------------------------

    def _assign(self, node: ast.stmt, name: str, expression: ast.expr) -> None:
        with self.captured() as made:
            value = self._right(expression)
        if isinstance(value.type, Together):
            self.refuse(node, "a tuple as a variable; give each of its parts a name")
        self._set(node, name, value, made)

    def _right(self, expression: ast.expr) -> Value:
        """What is assigned or returned: here a call may change arrays, too."""
        if isinstance(expression, ast.Call) and self._is_own(expression):
            return self.call_own(expression, self.known(expression.func))[0]
        return self.value(expression)

    def _is_own(self, call: ast.Call) -> bool:
        """Whether a function of kernels is called."""
        return (
            isinstance(call.func, ast.Name)
            and not call.keywords
            and self.unit.is_own(self.known(call.func))
            and not any(isinstance(each, ast.Starred) for each in call.args)
        )

    def _set(self, node: ast.stmt, name: str, value: Value, made: list[Piece]) -> None:
        """Give a variable its value, after what was made for it."""
        known = value.constant is not None and not isinstance(value.type, Lanes)
        if known and self._is_set_once(name):
            self.constants[name] = value
            return
        if isinstance(value.type, Array):
            self.refuse(node, f"`{name}`: an array as a variable")
        if name in self.counters:
            self.refuse(node, f"`{name}`, which counts a loop, is assigned to")
        local = self._local(node, name, value.type)
        declares = name in self.here and name not in self.declared
        if isinstance(local.type, Lanes):
            if declares:
                self._declare(name)
            text = _taken_back(value, made)
            self.pieces.append(self._lane_loop([*made, Piece(f"{local.name}[{self.lane}] = {text};")], local.name))
            return
        self.pieces += made
        assert isinstance(local.type, Scalar)  # noqa: S101  numbers are left
        text = _taken_back(self.cast(node, value, local.type), self.pieces)
        self.declared.add(name)
        type_ = "" if not declares else f"const {local.type.c} " if self._is_set_once(name) else f"{local.type.c} "
        self.pieces.append(Piece(f"{type_}{local.name} = {text};", sets=local.name))

    def _lane_loop(self, body: list[Piece], sets: str = "") -> Piece:
        return Piece(f"for (int {self.lane} = 0; {self.lane} < {LANES}; {self.lane}++)", body, sets)

    def _is_set_once(self, name: str) -> bool:
        return self.assigned[name] - self.loops[name] == 1

    def _local(self, node: ast.stmt, name: str, kind: Type) -> Local:
        if name not in self.locals:
            self.locals[name] = Local(kind, self._free(identifier(name)))
        local = self.locals[name]
        if local.type != kind:
            both = joined(local.type, kind) if isinstance(local.type, Scalar) and isinstance(kind, Scalar) else None
            if both is None:
                self.refuse(node, f"`{name}` changes its type")
            local.type = both
        return local

    def _free(self, wanted: str) -> str:
        taken = {local.name for local in self.locals.values()} | {self.lane}
        name, number = wanted, 2
        while name in taken:
            name, number = f"{wanted}_{number}", number + 1
        return name

    def _declare(self, name: str) -> None:
        local = self.locals[name]
        self.declared.add(name)
        of = local.type.element if isinstance(local.type, Lanes) else local.type
        assert isinstance(of, Scalar)  # noqa: S101  what a variable can be
        size = f"[{LANES}]" if isinstance(local.type, Lanes) else ""
        self.pieces.append(Piece(f"{of.c} {local.name}{size};", sets=local.name))

    def _assign_together(self, node: ast.Assign, targets: list[ast.expr], expression: ast.expr) -> None:
        names = [target.id for target in targets if isinstance(target, ast.Name)]
        if len(names) != len(targets):
            self.refuse(node, f"`{ast.unparse(node):.60}`: several at once are variables")
        if isinstance(expression, ast.Tuple) and len(expression.elts) == len(names):
            values = [self.value(each) for each in expression.elts]
            if any(isinstance(value.type, Lanes) for value in values):
                self.refuse(node, f"`{ast.unparse(node):.60}`: lanes need a line each")
            for index, each in enumerate(expression.elts):  # what is overwritten before it is read
                if {other.id for other in ast.walk(each) if isinstance(other, ast.Name)} & set(names[:index]):
                    values[index] = self._kept(values[index])
        elif isinstance(expression, ast.Call) and self._is_own(expression):
            value = self._right(expression)
            if not isinstance(value.type, Together) or len(value.type.of) != len(names):
                self.refuse(node, f"`{ast.unparse(node):.60}`: a call that gives so many values")
            whole = self.new("t")
            self.pieces.append(Piece(f"const {value.type.c} {whole} = {value.text};"))
            values = [Value(of, f"{whole}.{part}") for of, part in zip(value.type.of, value.type.names, strict=True)]
        else:
            self.refuse(node, f"`{ast.unparse(node):.60}`")
        for name, value in zip(names, values, strict=True):
            self._set(node, name, value, [])

    def _kept(self, value: Value) -> Value:
        if value.constant is not None or not isinstance(value.type, Scalar):
            return value
        name = self.new("t")
        self.pieces.append(Piece(f"const {value.type.c} {name} = {value.text};", sets=name))
        return value._replace(text=name, loose=False)

    def _put(self, target: ast.Subscript, value: Value) -> None:
        """Set a number of an array."""
        owner, place = self.value(target.value), self.place(target.slice)
        if not isinstance(owner.type, Array) or not isinstance(target.value, ast.Name) or owner.constant is not None:
            self.refuse(target, f"`{ast.unparse(target):.60}` is assigned to")
        if not isinstance(value.type, Scalar):
            self.refuse(target, "lanes in one place of an array; use `store`")
        self.written.add(target.value.id)
        self.pure = False
        text = _taken_back(self.cast(target, value, owner.type.element), self.pieces)
        self.pieces.append(Piece(f"{owner.text}[{place.text}] = {text};"))

    def _do(self, call: ast.Call) -> None:
        """A call for what it does."""
        function = self.known(call.func)
        if function is lanes.store:
            self._store(call)
            return
        if not self._is_own(call):
            self.refuse(call, f"`{ast.unparse(call):.60}`")
        value, pure = self.call_own(call, function)
        if not pure:
            self.pieces.append(Piece(f"{'' if value.type is None else '(void)'}{value.text};"))

    def _store(self, call: ast.Call) -> None:
        """Write eight numbers; what is written may lie among what is read, so that all is read first."""
        array, at = self.value(call.args[0]), self.place(call.args[1])
        if not isinstance(array.type, Array) or not isinstance(call.args[0], ast.Name) or array.constant is not None:
            self.refuse(call, f"`{ast.unparse(call):.60}`")
        with self.captured() as made:
            value = self.value(call.args[2])
        if value.type != Lanes(array.type.element):
            self.refuse(call, f"`{ast.unparse(call):.60}`: numbers of another type")
        self.written.add(call.args[0].id)
        self.pure = False
        with self.captured() as first:
            place = self.load(call, [array, at]).text
            if value.loads:
                text = self.new("eight")
                self.pieces.append(Piece(f"{array.type.element.c} {text}[{LANES}];"))
                text = f"{text}[{self.lane}]"
                self.pieces.append(self._lane_loop([*made, Piece(f"{text} = {_taken_back(value, made)};")]))
                made = []
            else:
                text = _taken_back(value, made)
        self.pieces += [*first, self._lane_loop([*made, Piece(f"{place} = {text};")])]

    # ---- branches and loops -------------------------------------------------------------------------------------

    def _if(self, node: ast.If) -> bool:
        test = self.truth(node.test, self.value(node.test))
        if test.constant is not None:
            return self.block(node.body if test.constant else node.orelse)
        with self.captured() as first:
            ends = self.block(node.body)
        with self.captured() as second:
            ends_otherwise = self.block(node.orelse)
        if first or second:
            self.pieces.append(Piece(f"if ({test.text})", first))
        if second:
            self.pieces.append(Piece("else", second))
        return ends and ends_otherwise

    def _for(self, node: ast.For, name: str) -> None:
        call = node.iter
        if not isinstance(call, ast.Call) or self.known(call.func) is not range or call.keywords or not 1 <= len(call.args) <= 3:
            self.refuse(node, f"a loop over `{ast.unparse(node.iter):.60}`; use range")
        bounds = [self.cast(each, self._whole(each), INT64) for each in call.args]
        begin, end = bounds[:2] if len(bounds) > 1 else [self.constant(node, 0), bounds[0]]
        step = bounds[2].constant if len(bounds) > 2 else 1
        if not step:
            self.refuse(node, f"the step of `{ast.unparse(call):.60}`, which is not known or 0")
        if end.constant is None:
            end = self._kept(end) if end.loose or "(" in end.text or self._changes(node, call.args) else end
        if name in self.counters or name in set(_assigned(ast.Module(node.body, []))):
            self.refuse(node, f"`{name}`, which counts a loop, is assigned to")
        self.counters.add(name)
        counter = self._free(identifier(name))
        outer = self.locals.pop(name, None)
        self.locals[name] = Local(INT64, counter)
        with self.captured() as made:
            self.block(node.body)
        self.counters.remove(name)
        del self.locals[name]  # behind the loop it would be another number in C
        if outer is not None:
            self.locals[name] = outer
        change = f"{counter}++" if step == 1 else f"{counter} += {step}" if step > 0 else f"{counter} -= {-step}"
        sign = "<" if step > 0 else ">"
        self.pieces.append(Piece(f"for (int64_t {counter} = {begin.text}; {counter} {sign} {end.text}; {change})", made))

    def _whole(self, node: ast.expr) -> Value:
        value = self.value(node)
        if value.type not in WHOLE or value.type == BOOL:
            self.refuse(node, f"`{ast.unparse(node):.60}` as a bound of a loop")
        return value

    def _changes(self, loop: ast.For, bounds: list[ast.expr]) -> bool:
        """Whether the loop assigns to what its bounds are made of."""
        names = {each.id for bound in bounds for each in ast.walk(bound) if isinstance(each, ast.Name)}
        return bool(names & set(_assigned(loop)))

    def _while(self, node: ast.While) -> bool:
        with self.captured() as made:
            test = self.truth(node.test, self.value(node.test))
        if test.constant is False:
            return False
        with self.captured() as body:
            self.block(node.body)
        if test.constant is True:
            self.pieces.append(Piece("for (;;)", body))
            return not any(isinstance(each, ast.Break) for each in ast.walk(node))
        if made:
            leave = Piece(f"if (!({test.text}))", [Piece("break;")])
            self.pieces.append(Piece("for (;;)", [*made, leave, *body]))
        else:
            self.pieces.append(Piece(f"while ({test.text})", body))
        return False

    # ---- results ------------------------------------------------------------------------------------------------

    def _return(self, node: ast.Return) -> None:
        if node.value is None or (isinstance(node.value, ast.Constant) and node.value.value is None):
            self.pieces.append(Piece("return;"))
            return
        if isinstance(node.value, ast.Tuple):
            self._return_together(node, node.value)
            return
        value = self._right(node.value)
        if not isinstance(value.type, Scalar):
            self.refuse(node, "a function that returns an array or lanes")
        of = value.type if self.result is None else joined(self.result, value.type) if isinstance(self.result, Scalar) else None
        if of is None:
            self.refuse(node, "a function that returns now this, now that type")
        self.result = of
        self.pieces.append(Piece(f"return {_taken_back(self.cast(node, value, of), self.pieces)};"))

    def _return_together(self, node: ast.Return, parts: ast.Tuple) -> None:
        values = [self.value(each) for each in parts.elts]
        names = [each.id if isinstance(each, ast.Name) else "" for each in parts.elts]
        of = [value.type for value in values if isinstance(value.type, Scalar)]
        if len(of) != len(values):
            self.refuse(node, "a function that returns arrays or lanes")
        if self.result is None:
            distinct = all(names) and len(set(names)) == len(names)
            members = [identifier(name) if distinct else f"n{index}" for index, name in enumerate(names)]
            self.result = self.unit.together(self, tuple(of), tuple(members))
        if not isinstance(self.result, Together) or self.result.of != tuple(of):
            self.refuse(node, "a function that returns now this, now that type")
        name = self.new("t")
        self.pieces.append(Piece(f"{self.result.c} {name};"))
        self.pieces += [
            Piece(f"{name}.{member} = {value.text};") for member, value in zip(self.result.names, values, strict=True)
        ]
        self.pieces.append(Piece(f"return {name};"))


def _taken_back(value: Value, pieces: list[Piece]) -> str:
    """A value's text; of an operation that has just become a statement, what stands there, which is then left out."""
    start = f" {value.text} = "
    if pieces and pieces[-1].once and pieces[-1].sets == value.text:
        return pieces.pop().text.split(start, 1)[1].removesuffix(";")
    return value.text


def _assigned(tree: ast.AST) -> Iterator[str]:
    """Names that are assigned to, as often as they are."""
    for each in ast.walk(tree):
        if isinstance(each, ast.Name) and isinstance(each.ctx, ast.Store):
            yield each.id


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
