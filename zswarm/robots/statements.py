"""Statements of kernels as C99: variables are declared where all that use them see them, lanes are loops over eight numbers."""

import ast
from collections.abc import Sequence
from dataclasses import dataclass, field

from zswarm import lanes
from zswarm.lanes import LANES
from zswarm.robots.c_types import BOOL, INT64, WHOLE, Array, Lanes, Scalar, Together, Type, convert, identifier, joined, literal
from zswarm.robots.expressions import Expressions
from zswarm.robots.operations import SIGNS
from zswarm.robots.pieces import Local, Piece, Value, taken_back
from zswarm.robots.scopes import Scope, assigned


@dataclass
class Statements(Expressions):
    """The body of one function."""

    scope: Scope = field(default_factory=Scope)
    declared: set[str] = field(default_factory=set)
    counters: set[str] = field(default_factory=set)  # of loops that are open
    arguments: frozenset[str] = frozenset()
    result: Scalar | Together | None = None

    def block(self, body: Sequence[ast.stmt]) -> bool:
        """Statements; returns whether the last one ends the function."""
        for statement in body:
            for name in self.scope.before.get(id(statement), ()):
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
                raise self.refusal(node, f"`{ast.unparse(node).splitlines()[0]:.60}`")
        return False

    # ---- assignments --------------------------------------------------------------------------------------------

    def _assign(self, node: ast.stmt, name: str, expression: ast.expr) -> None:
        with self.captured() as made:
            value = self._right(expression)
        if isinstance(value.type, Together):
            raise self.refusal(node, "a tuple as a variable; give each of its parts a name")
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
        if known and self.scope.is_set_once(name):
            self.constants[name] = value
            return
        if isinstance(value.type, Array):
            raise self.refusal(node, f"`{name}`: an array as a variable")
        if name in self.counters:
            raise self.refusal(node, f"`{name}`, which counts a loop, is assigned to")
        local = self._local(node, name, value.type)
        declares = name in self.scope.here and name not in self.declared
        if isinstance(local.type, Lanes):
            if declares:
                self._declare(name)
            text = taken_back(value, made)
            self.pieces.append(self._lane_loop([*made, Piece(f"{local.name}[{self.lane}] = {text};")], local.name))
            return
        self.pieces += made
        assert isinstance(local.type, Scalar)  # noqa: S101  numbers are left
        text = taken_back(self.cast(node, value, local.type), self.pieces)
        self.declared.add(name)
        type_ = "" if not declares else f"const {local.type.c} " if self.scope.is_set_once(name) else f"{local.type.c} "
        self.pieces.append(Piece(f"{type_}{local.name} = {text};", sets=local.name))

    def _lane_loop(self, body: list[Piece], sets: str = "") -> Piece:
        return Piece(f"for (int {self.lane} = 0; {self.lane} < {LANES}; {self.lane}++)", body, sets)

    def _local(self, node: ast.stmt, name: str, kind: Type) -> Local:
        if name not in self.locals:
            self.locals[name] = Local(kind, self._free(identifier(name)))
        local = self.locals[name]
        if local.type != kind:
            both = joined(local.type, kind) if isinstance(local.type, Scalar) and isinstance(kind, Scalar) else None
            if both is None or (name in self.arguments and both != local.type):
                raise self.refusal(node, f"`{name}` changes its type")
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
        zero = literal(convert(0, of))
        text = (
            f"{local.name}[{LANES}] = {{{', '.join([zero] * LANES)}}}"
            if isinstance(local.type, Lanes)
            else f"{local.name} = {zero}"
        )
        self.pieces.append(Piece(f"{of.c} {text};", sets=local.name))  # a value, or compilers fear that it has none

    def _assign_together(self, node: ast.Assign, targets: list[ast.expr], expression: ast.expr) -> None:
        names = [target.id for target in targets if isinstance(target, ast.Name)]
        if len(names) != len(targets):
            raise self.refusal(node, f"`{ast.unparse(node):.60}`: several at once are variables")
        if isinstance(expression, ast.Tuple) and len(expression.elts) == len(names):
            values = [self.value(each) for each in expression.elts]
            if any(isinstance(value.type, Lanes) for value in values):
                raise self.refusal(node, f"`{ast.unparse(node):.60}`: lanes need a line each")
            for index, each in enumerate(expression.elts):  # what is overwritten before it is read
                if {other.id for other in ast.walk(each) if isinstance(other, ast.Name)} & set(names[:index]):
                    values[index] = self._copied(values[index])
        elif isinstance(expression, ast.Call) and self._is_own(expression):
            value = self._right(expression)
            if not isinstance(value.type, Together) or len(value.type.of) != len(names):
                raise self.refusal(node, f"`{ast.unparse(node):.60}`: a call that gives so many values")
            whole = self.new("t")
            self.pieces.append(Piece(f"const {value.type.c} {whole} = {value.text};"))
            values = [Value(of, f"{whole}.{part}") for of, part in zip(value.type.of, value.type.names, strict=True)]
        else:
            raise self.refusal(node, f"`{ast.unparse(node):.60}`")
        for name, value in zip(names, values, strict=True):
            self._set(node, name, value, [])

    def _copied(self, value: Value) -> Value:
        """A number as it is now, for when it may be another one."""
        return value if value.constant is not None or not isinstance(value.type, Scalar) else self.kept(value)

    def _put(self, target: ast.Subscript, value: Value) -> None:
        """Set a number of an array."""
        owner, place = self.value(target.value), self.place(target.slice)
        if not isinstance(owner.type, Array):
            raise self.refusal(target, f"`{ast.unparse(target):.60}` is assigned to")
        self.change(target.value, owner)
        if not isinstance(value.type, Scalar):
            raise self.refusal(target, "lanes in one place of an array; use `store`")
        text = taken_back(self.cast(target, value, owner.type.element), self.pieces)
        self.pieces.append(Piece(f"{owner.text}[{place.text}] = {text};"))

    def _do(self, call: ast.Call) -> None:
        """A call for what it does."""
        function = self.known(call.func)
        if function is lanes.store:
            self._store(call)
            return
        if not self._is_own(call):
            raise self.refusal(call, f"`{ast.unparse(call):.60}`")
        value, changes = self.call_own(call, function)
        if changes:
            self.pieces.append(Piece(f"{'' if value.type is None else '(void)'}{value.text};"))

    def _store(self, call: ast.Call) -> None:
        """Write eight numbers; what is written may lie among what is read, so that all is read first."""
        array, at = self.value(call.args[0]), self.place(call.args[1])
        if not isinstance(array.type, Array):
            raise self.refusal(call, f"`{ast.unparse(call):.60}`")
        self.change(call.args[0], array)
        with self.captured() as made:
            value = self.value(call.args[2])
        if value.type != Lanes(array.type.element):
            raise self.refusal(call, f"`{ast.unparse(call):.60}`: numbers of another type")
        with self.captured() as first:
            place = self.load(call, [array, at]).text
            if value.loads:
                text = self.new("eight")
                self.pieces.append(Piece(f"{array.type.element.c} {text}[{LANES}];"))
                text = f"{text}[{self.lane}]"
                self.pieces.append(self._lane_loop([*made, Piece(f"{text} = {taken_back(value, made)};")]))
                made = []
            else:
                text = taken_back(value, made)
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
            raise self.refusal(node, f"a loop over `{ast.unparse(node.iter):.60}`; use range")
        bounds = [self.cast(each, self._whole(each), INT64) for each in call.args]
        begin, end = bounds[:2] if len(bounds) > 1 else [self.constant(node, 0), bounds[0]]
        step = bounds[2].constant if len(bounds) > 2 else 1
        if not step:
            raise self.refusal(node, f"the step of `{ast.unparse(call):.60}`, which is not known or 0")
        if end.constant is None:
            end = self._copied(end) if end.loose or "(" in end.text or self._changes(node, call.args) else end
        if name in self.counters or name in set(assigned(ast.Module(node.body, []))):
            raise self.refusal(node, f"`{name}`, which counts a loop, is assigned to")
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
            raise self.refusal(node, f"`{ast.unparse(node):.60}` as a bound of a loop")
        return value

    def _changes(self, loop: ast.For, bounds: list[ast.expr]) -> bool:
        """Whether the loop assigns to what its bounds are made of."""
        names = {each.id for bound in bounds for each in ast.walk(bound) if isinstance(each, ast.Name)}
        return bool(names & set(assigned(loop)))

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
            raise self.refusal(node, "a function that returns an array or lanes")
        of = value.type if self.result is None else joined(self.result, value.type) if isinstance(self.result, Scalar) else None
        if of is None:
            raise self.refusal(node, "a function that returns now this, now that type")
        self.result = of
        self.pieces.append(Piece(f"return {taken_back(self.cast(node, value, of), self.pieces)};"))

    def _return_together(self, node: ast.Return, parts: ast.Tuple) -> None:
        values = [self.value(each) for each in parts.elts]
        names = [each.id if isinstance(each, ast.Name) else "" for each in parts.elts]
        of = [value.type for value in values if isinstance(value.type, Scalar)]
        if len(of) != len(values):
            raise self.refusal(node, "a function that returns arrays or lanes")
        if self.result is None:
            members = [identifier(name) if name and names.count(name) == 1 else f"n{at}" for at, name in enumerate(names)]
            self.result = self.unit.together(self.function, tuple(of), tuple(members))
        if not isinstance(self.result, Together) or self.result.of != tuple(of):
            raise self.refusal(node, "a function that returns now this, now that type")
        name = self.new("t")
        self.pieces.append(Piece(f"{self.result.c} {name};"))
        self.pieces += [
            Piece(f"{name}.{member} = {value.text};") for member, value in zip(self.result.names, values, strict=True)
        ]
        self.pieces.append(Piece(f"return {name};"))
