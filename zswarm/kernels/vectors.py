"""Lower the functions of ``lanes.py`` to LLVM: in a kernel, eight numbers are one vector."""

# mypy: disable-error-code=no-untyped-def
# because numba infers the types of kernels.

# ruff: noqa: ARG001, ARG005  numba decides what typing and lowering functions are given

import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.core.cgutils import get_or_insert_function, global_constant
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, overload, register_model

from zswarm.kernels.lanes import (
    LANES,
    any_of,
    fill,
    floor,
    list_true,
    load,
    scatter,
    select,
    sqrt,
    store,
    window,
)

WORDS = {
    types.float32: ir.FloatType(),
    types.float64: ir.DoubleType(),
    types.int32: ir.IntType(32),
    types.boolean: ir.IntType(1),
}


class Lanes(types.Type):
    """Eight numbers of one type."""

    def __init__(self, element: Any) -> None:
        self.element = element
        super().__init__(name=f"lanes({element})")


@register_model(Lanes)
class _Register(models.PrimitiveModel):
    def __init__(self, manager: Any, lanes: Lanes) -> None:
        super().__init__(manager, lanes, ir.VectorType(WORDS[lanes.element], LANES))  # type: ignore[no-untyped-call]  # numba has no types there


def _operation(
    function: Any, typed: Callable[..., Any], *arguments: Any
) -> Callable[[Any], Any]:
    """Register a function with numba; ``typed`` maps argument types to a signature or None."""

    class Template(AbstractTemplate):
        def generic(self, args: Any, kws: Any) -> Any:
            return None if kws else typed(*args)

    infer_global(function)(Template)
    return lower_builtin(function, *arguments)  # type: ignore[no-any-return]  # numba has no types


def _elements(of: Any, *others: Any) -> bool:
    return all(
        other in (of, Lanes(of))
        or (of == types.int32 and isinstance(other, types.Integer))
        for other in others
    )


def _as_lanes(builder: Any, type_: Any, value: Any) -> Any:
    """One number becomes eight of it."""
    if isinstance(type_, Lanes):
        return value
    one = ir.VectorType(value.type, LANES)
    first = builder.insert_element(
        ir.Constant(one, ir.Undefined), value, ir.Constant(ir.IntType(32), 0)
    )
    return builder.shuffle_vector(
        first, ir.Constant(one, ir.Undefined), _places([0] * LANES)
    )


def _places(numbers: list[int]) -> Any:
    return ir.Constant(ir.VectorType(ir.IntType(32), len(numbers)), numbers)


def _binary(
    function: Any, emit: Callable[..., Any], elements: Any, result: Any = None
) -> None:
    def typed(left: Any, right: Any) -> Any:
        element = getattr(left, "element", None) or getattr(right, "element", None)
        if (
            not (isinstance(left, Lanes) or isinstance(right, Lanes))
            or element not in elements
        ):
            return None
        if not _elements(element, left, right):
            return None
        both = (side if isinstance(side, Lanes) else element for side in (left, right))
        return signature(Lanes(result or element), *both)

    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        element = next(side.element for side in sig.args if isinstance(side, Lanes))
        sides = (
            _as_lanes(builder, type_, value)
            for type_, value in zip(sig.args, args, strict=True)
        )
        return emit(builder, isinstance(element, types.Float), *sides)

    for arguments in ((Lanes, Lanes), (Lanes, types.Number), (types.Number, Lanes)):
        _operation(function, typed, *arguments)(lowered)


def _arithmetic(of_floats: str, of_integers: str) -> Callable[..., Any]:
    return lambda builder, floats, left, right: getattr(
        builder, of_floats if floats else of_integers
    )(left, right)


def _comparison(sign: str) -> Callable[..., Any]:
    return lambda builder, floats, left, right: (
        builder.fcmp_ordered if floats else builder.icmp_signed
    )(sign, left, right)


FLOATS = (types.float32, types.float64)
NUMBERS = (*FLOATS, types.int32)
_binary(operator.add, _arithmetic("fadd", "add"), NUMBERS)
_binary(operator.sub, _arithmetic("fsub", "sub"), NUMBERS)
_binary(operator.mul, _arithmetic("fmul", "mul"), NUMBERS)
_binary(operator.truediv, _arithmetic("fdiv", "fdiv"), FLOATS)
_binary(operator.and_, _arithmetic("and_", "and_"), (types.boolean,))
_binary(operator.or_, _arithmetic("or_", "or_"), (types.boolean,))
for compare, sign in (
    (operator.lt, "<"),
    (operator.le, "<="),
    (operator.gt, ">"),
    (operator.ge, ">="),
    (operator.eq, "=="),
):
    _binary(compare, _comparison(sign), NUMBERS, types.boolean)
_binary(
    operator.ne,
    lambda builder, floats, left, right: (
        builder.fcmp_unordered if floats else builder.icmp_signed
    )("!=", left, right),
    *(NUMBERS, types.boolean),
)


def _is_flat(array: Any) -> bool:
    return (
        isinstance(array, types.Array)
        and array.ndim == 1
        and array.layout == "C"
        and array.dtype in NUMBERS
    )


def _address(
    context: Any, builder: Any, type_: Any, array: Any, at: Any, vector: Any
) -> Any:
    """Return the address of numbers in an array as a pointer to a vector."""
    whole = context.make_array(type_)(context, builder, array)
    return builder.bitcast(builder.gep(whole.data, [at]), vector.as_pointer())


def _lane(builder: Any, vector: Any, lane: int) -> Any:
    return builder.extract_element(vector, ir.Constant(ir.IntType(32), lane))


@_operation(
    load,
    lambda array, at: (
        signature(Lanes(array.dtype), array, types.intp) if _is_flat(array) else None
    ),
    *(types.Any, types.Any),
)
def _load(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    vector = context.get_value_type(sig.return_type)
    return builder.load(
        _address(context, builder, sig.args[0], args[0], args[1], vector), align=4
    )


@_operation(
    store,
    lambda array, at, numbers: (
        signature(types.none, array, types.intp, numbers)
        if _is_flat(array) and numbers == Lanes(array.dtype)
        else None
    ),
    *(types.Any, types.Any, types.Any),
)
def _store(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    builder.store(
        args[2],
        _address(context, builder, sig.args[0], args[0], args[1], args[2].type),
        align=4,
    )
    return context.get_dummy_value()


@_operation(
    fill,
    lambda number: signature(Lanes(number), number) if number in NUMBERS else None,
    types.Any,
)
def _fill(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    return _as_lanes(builder, sig.args[0], args[0])


def _typed_select(which: Any, yes: Any, no: Any) -> Any:
    element = getattr(yes, "element", yes)
    if which == types.boolean:
        return signature(yes, which, yes, yes) if yes == no else None
    if (
        which != Lanes(types.boolean)
        or element not in WORDS
        or not _elements(element, yes, no)
    ):
        return None
    return signature(
        Lanes(element),
        which,
        *(side if isinstance(side, Lanes) else element for side in (yes, no)),
    )


@_operation(select, _typed_select, types.Any, types.Any, types.Any)
def _select(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    if not isinstance(sig.return_type, Lanes):
        return builder.select(*args)
    yes, no = (
        _as_lanes(builder, type_, value)
        for type_, value in zip(sig.args[1:], args[1:], strict=True)
    )
    return builder.select(args[0], yes, no)


@_operation(
    any_of,
    lambda which: (
        signature(types.boolean, which) if which == Lanes(types.boolean) else None
    ),
    types.Any,
)
def _any_of(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    bits = ir.IntType(LANES)
    return builder.icmp_unsigned(
        "!=", builder.bitcast(args[0], bits), ir.Constant(bits, 0)
    )


# Per bits of true lanes all lanes, true ones first.
ORDERS = [
    sorted(range(LANES), key=lambda lane: not bits >> lane & 1)
    for bits in range(1 << LANES)
]


@_operation(
    list_true,
    lambda which, first, array, at: (
        signature(types.intp, which, types.intp, array, types.intp)
        if which == Lanes(types.boolean)
        and _is_flat(array)
        and array.dtype == types.int32
        else None
    ),
    *(types.Any, types.Any, types.Any, types.Any),
)
def _list_true(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    """Look the true lanes up in a table of the 256 masks, which needs no unpredictable branch."""
    byte, word, size = ir.IntType(8), ir.IntType(32), ir.IntType(64)
    rows = [ir.Constant(ir.ArrayType(byte, LANES), row) for row in ORDERS]
    table = global_constant(
        builder, "orders", ir.Constant(ir.ArrayType(rows[0].type, len(rows)), rows)
    )
    bits = builder.bitcast(args[0], byte)
    row = builder.gep(table, [ir.Constant(size, 0), builder.zext(bits, size)])
    lanes = builder.load(
        builder.bitcast(row, ir.VectorType(byte, LANES).as_pointer()), align=1
    )
    vector = ir.VectorType(word, LANES)
    numbers = builder.add(
        builder.zext(lanes, vector),
        _as_lanes(builder, types.int32, builder.trunc(args[1], word)),
    )
    builder.store(
        numbers,
        _address(context, builder, sig.args[2], args[2], args[3], vector),
        align=4,
    )
    return builder.zext(builder.ctpop(bits), size)


@_operation(
    window,
    lambda array, places, offset: (
        signature(types.UniTuple(Lanes(types.float32), 4), array, places, types.intp)
        if _is_flat(array)
        and array.dtype == types.float32
        and places == Lanes(types.int32)
        else None
    ),
    *(types.Any, types.Any, types.Any),
)
def _window(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    """Load four numbers per lane at once, then transpose in the three shuffles of processors."""
    four = ir.VectorType(ir.FloatType(), 4)
    rows = []
    for lane in range(LANES):
        at = builder.add(
            args[2], builder.sext(_lane(builder, args[1], lane), ir.IntType(64))
        )
        rows.append(
            builder.load(
                _address(context, builder, sig.args[0], args[0], at, four), align=4
            )
        )

    def mix(left: Any, right: Any, order: list[int]) -> Any:
        return builder.shuffle_vector(left, right, _places(order))

    pairs = [mix(rows[lane], rows[lane + 4], list(range(LANES))) for lane in range(4)]
    low, high = [0, 8, 1, 9, 4, 12, 5, 13], [2, 10, 3, 11, 6, 14, 7, 15]
    first, second = [0, 1, 8, 9, 4, 5, 12, 13], [2, 3, 10, 11, 6, 7, 14, 15]
    halves = [
        (mix(pairs[0], pairs[1], order), mix(pairs[2], pairs[3], order))
        for order in (low, high)
    ]
    columns = [
        mix(left, right, order) for left, right in halves for order in (first, second)
    ]
    return context.make_tuple(builder, sig.return_type, columns)


@_operation(
    scatter,
    lambda array, places, numbers: (
        signature(types.none, array, places, numbers)
        if _is_flat(array)
        and places == Lanes(types.int32)
        and numbers == Lanes(array.dtype)
        else None
    ),
    *(types.Any, types.Any, types.Any),
)
def _scatter(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    whole = context.make_array(sig.args[0])(context, builder, args[0])
    for lane in range(LANES):
        at = builder.sext(_lane(builder, args[1], lane), ir.IntType(64))
        builder.store(_lane(builder, args[2], lane), builder.gep(whole.data, [at]))
    return context.get_dummy_value()


def _rounded(name: str) -> Any:
    """Return the processor's instruction for a float or for lanes, as an intrinsic."""

    @intrinsic
    def instruction(_, x):  # numba looks at its arguments
        def generate(context, builder, signature, arguments):
            kind = context.get_value_type(signature.return_type)
            if hasattr(kind, "count"):
                of = f"v{kind.count}{kind.element.intrinsic_name}"
            else:
                of = kind.intrinsic_name
            function = ir.FunctionType(kind, [kind])
            called = get_or_insert_function(builder.module, function, f"llvm.{name}.{of}")
            return builder.call(called, arguments)

        if isinstance(getattr(x, "element", x), types.Float):
            return x(x), generate
        return None

    return instruction


_root, _down = _rounded("sqrt"), _rounded("floor")


@overload(sqrt)
def _sqrt(x):
    return lambda x: _root(x)


@overload(floor)
def _floor(x):
    return lambda x: _down(x)
