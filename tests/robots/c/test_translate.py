"""Functions of kernels in C compute the same bits; what C cannot say is refused by name."""

import ctypes
import itertools
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.robots.c.compiled import floats, library
from zswarm.errors import ConfigError
from zswarm.kernels import portable
from zswarm.kernels import random as draws
from zswarm.kernels.jit import inline, sqrt
from zswarm.kernels.lanes import any_of, fill, load, select, store
from zswarm.kernels.random import Stream
from zswarm.robots.c.c99 import GUARDS
from zswarm.robots.c.c_types import BOOL, FLOAT32, FLOAT64, INT64, UINT64, Array, Type
from zswarm.robots.c.translate import functions

C = {
    FLOAT32: ctypes.c_float,
    FLOAT64: ctypes.c_double,
    INT64: ctypes.c_int64,
    UINT64: ctypes.c_uint64,
    BOOL: ctypes.c_bool,
}
ONE, TWO, HALF = np.float32(1), np.float32(2), np.float32(0.5)
TABLE = np.array([0.25, -3.0, 1e300, 7.0])
STEPS = (4, -2, 9)


def compiled(
    wanted: list[tuple[Callable[..., Any], dict[str, Type]]], folder: Path, *flags: str
) -> ctypes.CDLL:
    source = functions(wanted, "zs")
    text = "\n".join([source.includes, GUARDS, source.declarations])
    return library({"some.c": f"{text}\n{source.definitions}"}, folder, *flags)


# ---- the functions of portable.py ------------------------------------------------------

X, Y = {"x": FLOAT64}, {"y": FLOAT64}
PORTABLE: list[tuple[Callable[..., Any], dict[str, Type], Type]] = [
    (portable.exp, X, FLOAT64),
    (portable.power_of_two, {"k": INT64}, FLOAT64),
    (portable.sigmoid, X, FLOAT64),
    (portable.tanh, {"x": FLOAT32}, FLOAT32),
    (portable.sin, X, FLOAT64),
    (portable.cos, X, FLOAT64),
    (portable.atan2, Y | X, FLOAT64),
    (portable.remainder, X | {"divisor": FLOAT64}, FLOAT64),
    (portable.to_int, X, INT64),
]
ODD = [
    *(
        0.0,
        -0.0,
        5e-324,
        -5e-324,
        2.2e-308,
        1e-310,
        math.inf,
        -math.inf,
        math.nan,
        1.7976931348623157e308,
        -1e308,
    ),
    *(
        0.5,
        -0.5,
        1.5,
        2.5,
        709.782712893384,
        709.7827128933841,
        -745.1332191019412,
        -745.14,
        2147483647.0,
        -2147483648.5,
    ),
    *(
        1e6,
        -1e6,
        1e6 + 1,
        math.pi,
        math.pi / 2,
        math.pi / 4,
        3e22,
        19.999,
        20.0,
        20.001,
        1e-45,
        3.4e38,
    ),
]
MANY = np.concatenate(
    [
        ODD,
        Stream(1).uniform(-750.0, 720.0, 1500),
        Stream(2).uniform(-4.0, 4.0, 1500),
        10.0 ** Stream(3).uniform(-320.0, 308.0, 1000),
        -(10.0 ** Stream(4).uniform(-50.0, 38.0, 500)),
    ]
)


@pytest.fixture(scope="module")
def portable_in_c(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    made = compiled(
        [(function, types) for function, types, _ in PORTABLE],
        tmp_path_factory.mktemp("portable"),
        "-O2",
    )
    for function, types, result in PORTABLE:
        in_c = getattr(made, f"zs_{function.__name__}")
        in_c.argtypes, in_c.restype = [C[each] for each in types.values()], C[result]
    return made


def bits(number: float) -> bytes:
    """Return the bits of a number, the same for every NaN."""
    return np.float64(math.nan if number != number else number).tobytes()


@pytest.mark.parametrize("case", PORTABLE, ids=lambda case: case[0].__name__)
def test_a_portable_function_has_the_same_bits_in_c(
    case: Any, portable_in_c: ctypes.CDLL
) -> None:
    function, types, _ = case
    if types == {"k": INT64}:
        numbers: list[tuple[Any, ...]] = [(k,) for k in range(-1075, 1024)]
    elif list(types.values()) == [FLOAT32]:
        with np.errstate(over="ignore"):
            numbers = [(number,) for number in MANY.astype(np.float32)]
    elif len(types) == 1:
        numbers = [(number,) for number in MANY.tolist()]
    elif "divisor" in types:
        numbers = [
            (number, divisor)
            for number in MANY.tolist()
            for divisor in (360.0, 1e-300, 0.1)
        ]
    else:
        numbers = [
            *itertools.product(ODD, ODD),
            *zip(MANY.tolist(), reversed(MANY.tolist()), strict=True),
        ]
    in_c = getattr(portable_in_c, f"zs_{function.__name__}")
    for given_ in numbers:
        assert bits(in_c(*given_)) == bits(function(*given_)), given_


@given(st.floats(), st.floats())
def test_portable_functions_have_the_same_bits_in_c_of_any_numbers(
    portable_in_c: ctypes.CDLL, x: float, y: float
) -> None:
    for function, types, _ in PORTABLE:
        if set(types.values()) == {FLOAT64} and "divisor" not in types:
            some = (y, x)[2 - len(types) :]
            assert bits(getattr(portable_in_c, f"zs_{function.__name__}")(*some)) == bits(
                function(*some)
            )


# ---- constructs ------------------------------------------------------------------------


def branches(x, n):
    """Variables first set in a branch, choices with statements, chains of conditions."""
    if x < -1.0:
        y = x * 2.0
        which = 1
    elif -1.0 <= x < n * 0.5 and not (n == 3 or n == 4):
        y = x - 1.0 if n & 1 else x * x + 1.0
        which = 2
    else:
        y = abs(x)
        which = 3
        if y > 100.0 or x * x - y < 0.25:
            y = y / 3.0
    return y + which


def loops(n, x):
    """Loops up, down and in steps; variables that live on, counters that are set elsewhere."""
    total = 0.0
    kept = 7
    for step in range(n):
        if step == 1:
            last = 5
        if step > 1:
            total += last
            last = last + step
    for i in range(10, n, -3):
        if i == 4:
            continue
        if total > 40.0:
            break
        total = total + i * x
    for step in range(2, n + kept, 2):
        kept = kept - 1
        total += step
    step = 3
    while step < n and total * 0.5 < x + 20.0:
        step += 1
        total *= 1.25
    return total + step + kept


def whole(a, b):
    """Python's quotients and rests, bits, bounds."""
    q, r = a // 7, a % 7
    s, t = (a - 3) // (b + 1), (a + 3) % (b + 1)
    small = min(a, b, 4)
    large = max(a + 1, b, -2)
    return (
        q * 1000003
        + r * 10007
        + s * 101
        + t
        + (abs(a) ^ (b & 255))
        + ((b & 63) << 3)
        + small * large
    )


def together(a, b):
    """Several results, and variables that change places."""
    for _ in range(3):
        a, b = b, a + b
    first, second = pair_of(a, b)
    return first, second, first * second - a


def pair_of(a, b):
    big = a > b
    return (a if big else b), a * 0.5 - b


def waits(a, n):
    """Read the table only where ``and`` permits it: it has four numbers."""
    found = 0
    while n < 4 and TABLE[n] * 2.0 < a:
        n_plus = n + 1
        if n_plus == 4 or TABLE[n_plus] + 1.0 > 0.0 or a < 0.0:
            found = found + STEPS[n - n // 3]
        break
    return found


def singles(x):
    """Compute in float32; the square root is rounded once."""
    y = x * HALF + ONE
    return sqrt(abs(y)) / TWO - y


def mixed(x, n):
    """Mix float32 with an integer and a float literal, which gives float64."""
    return (x * n + 0.1) * x + np.float32(n) / TWO


def numbers_of(word):
    """Return a number in [0, 1) made of the bits of a word."""
    bits_of = np.uint64(word) >> np.uint64(12)
    return (np.uint64(bits_of | np.uint64(1023 << 52))).view(np.float64) - 1.0


XS = (-7.5, -1.0, -0.3, 0.0, 0.4, 1.1, 3.0, 99.0, 101.5, math.nan, math.inf)
WORDS = (0, 1, 1 << 63, (1 << 64) - 1, 0x123456789ABCDEF0)
SINGLES = tuple(map(np.float32, (-9.3, 0.1, 1e-40)))
CONSTRUCTS: list[tuple[Callable[..., Any], dict[str, Type], list[tuple[Any, ...]]]] = [
    (branches, X | {"n": INT64}, [*itertools.product(XS, range(6))]),
    (loops, {"n": INT64} | X, [*itertools.product(range(12), (-3.3, 0.1, 2.0, 50.0))]),
    (
        whole,
        {"a": INT64, "b": INT64},
        [*itertools.product(range(-20, 21), (-9, -4, 0, 1, 5, 300))],
    ),
    (
        waits,
        {"a": FLOAT64, "n": INT64},
        [*itertools.product((-10.0, 0.0, 0.6, 2e300, math.inf), range(6))],
    ),
    (
        singles,
        {"x": FLOAT32},
        [(np.float32(x),) for x in (-9.3, -0.0, 0.1, 1e-40, 3e38, 17.0)],
    ),
    (mixed, {"x": FLOAT32, "n": INT64}, [*itertools.product(SINGLES, (0, 3, 1 << 30))]),
    (numbers_of, {"word": UINT64}, [(word,) for word in WORDS]),
]


@pytest.fixture(scope="module")
def constructs_in_c(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    made = compiled(
        [(function, types) for function, types, _ in CONSTRUCTS],
        tmp_path_factory.mktemp("constructs"),
        "-O2",
    )
    for function, types, _ in CONSTRUCTS:
        in_c = getattr(made, f"zs_{function.__name__}")
        in_c.argtypes = [C[each] for each in types.values()]
        in_c.restype = (
            ctypes.c_int64
            if function in (whole, waits)
            else ctypes.c_float
            if function is singles
            else ctypes.c_double
        )
    return made


@pytest.mark.parametrize("case", CONSTRUCTS, ids=lambda case: case[0].__name__)
def test_a_construct_means_the_same_in_c(case: Any, constructs_in_c: ctypes.CDLL) -> None:
    function, _, numbers = case
    in_c = getattr(constructs_in_c, f"zs_{function.__name__}")
    for given_ in numbers:
        if function is mixed:  # which numpy computes otherwise than numba
            x, n = float(given_[0]), given_[1]
            expected = (x * n + 0.1) * x + float(np.float32(n) / TWO)
        else:
            with np.errstate(all="ignore"):
                expected = function(*given_)
        assert bits(in_c(*given_)) == bits(expected), given_


def test_several_results_are_a_struct_with_their_names(tmp_path: Path) -> None:
    source = functions(
        [
            (together, {"a": FLOAT64, "b": FLOAT64}),
            (pair_of, {"a": FLOAT64, "b": FLOAT64}),
        ],
        "zs",
    )
    assert (
        "double first;\n    double second;\n    double n2;\n} zs_together_result;"
        in source.declarations
    )
    made = compiled([(together, {"a": FLOAT64, "b": FLOAT64})], tmp_path)

    class Result(ctypes.Structure):
        _fields_ = [(name, ctypes.c_double) for name in ("first", "second", "n2")]

    made.zs_together.argtypes, made.zs_together.restype = [ctypes.c_double] * 2, Result
    for a, b in ((1.5, -2.25), (-0.1, 0.7), (1e200, 3.0)):
        found = made.zs_together(a, b)
        assert (found.first, found.second, found.n2) == together(a, b)


# ---- arrays and lanes ------------------------------------------------------------------


def soften(numbers, at):
    """A part of an array, and a function that changes it."""
    numbers[at] += HALF
    for place in range(numbers.shape[0]):
        numbers[place] = numbers[place] * HALF


def halves(numbers, found):
    soften(numbers[2 : 2 + 4], 1)
    soften(numbers[0:2], 0)
    best = 0
    for place in range(numbers.shape[0]):
        if numbers[place] > numbers[best]:
            best = place
    found[0] = float(numbers[best])
    found[1] = len(numbers)


def drawn(state, bound):
    """Draw numbers that are not used; they advance the stream all the same."""
    first = draws.draw_integer(state, bound)
    for _ in range(2):
        second = draws.draw_integer(state, bound)  # noqa: F841
        first, third = both(state, bound)  # noqa: RUF059
    return draws.draw_integer(state, bound)


def both(state, bound):
    first = draws.draw_integer(state, bound)
    return first, draws_left(bound)


def draws_left(bound):
    return bound * 0.5


@inline
def eights(numbers, at):
    """Numbers that are written where others are still to be read."""
    here = load(numbers, at)
    there = load(numbers, at + 4)
    low = select((here < there) & (there > ONE), here, there)
    store(
        numbers, at + 2, portable.tanh(load(numbers, at)) * numbers[0] + low - fill(HALF)
    )
    rest = low
    for _ in range(2):
        rest = rest / TWO + here
    store(numbers, at + 8, rest)


@pytest.mark.parametrize("flags", ["-O0", "-O3"])
def test_arrays_are_read_and_written_as_in_python(tmp_path: Path, flags: str) -> None:
    wanted = [
        (halves, {"numbers": Array(FLOAT32, 9), "found": Array(FLOAT64)}),
        (eights, {"numbers": Array(FLOAT32), "at": INT64}),
        (draws.draw_integer, {"state": Array(UINT64), "bound": INT64}),
        (drawn, {"state": Array(UINT64), "bound": INT64}),
    ]
    made = compiled(wanted, tmp_path, flags)
    made.zs_eights.argtypes = [ctypes.c_void_p, ctypes.c_int64]
    made.zs_draw_integer.argtypes, made.zs_draw_integer.restype = (
        [ctypes.c_void_p, ctypes.c_int64],
        ctypes.c_int64,
    )
    for seed in range(20):
        ours = Stream(seed).uniform(-3.0, 3.0, 32).astype(np.float32)
        theirs, found, expected = ours.copy(), np.zeros(2), np.zeros(2)
        halves(ours[:9], expected)
        made.zs_halves(floats(theirs), floats(found))
        eights(ours, seed % 9)
        made.zs_eights(floats(theirs), seed % 9)
        assert found.tolist() == expected.tolist()
        assert theirs.tobytes() == ours.tobytes()
    made.zs_drawn.argtypes, made.zs_drawn.restype = (
        [ctypes.c_void_p, ctypes.c_int64],
        ctypes.c_int64,
    )
    assert (
        made.zs_drawn(floats(np.array([7], np.uint64)), 1000)
        == Stream(7).integers(1000, 6)[-1]
    )
    state, stream = np.array([7], np.uint64), Stream(7)
    assert [made.zs_draw_integer(floats(state), 1000) for _ in range(50)] == [
        stream.integer(1000) for _ in range(50)
    ]


def test_a_constant_condition_keeps_only_its_branch() -> None:
    def chosen(x):
        return doubled(x, 2) + doubled(x, 3)

    def doubled(x, which):
        return x * 2.0 if which == 2 else portable.exp(x) if which == 4 else x - 1.0

    text = functions([(chosen, {"x": FLOAT64})], "zs").definitions
    assert "exp" not in text
    assert text.count("static double zs_doubled") == 2


# ---- what is refused -------------------------------------------------------------------


def with_a_list(x):
    return [x, x][0]


def with_a_power(x):
    return x**2


def with_text(x):
    return len("x") + x


def with_numpy(x):
    return np.sin(x)


def with_a_keyword(x):
    return max(x, key=None)


def with_try(x):
    try:
        return x
    except ValueError:
        return 0.0


def with_a_default(x, y=1.0):
    return x + y


def without_end(x):
    return without_end(x - 1.0)


def over_a_list(x):
    for each in (1, 2):
        x2 = each
    return x + x2


def with_two_types(x):
    if x > 1.0:
        return x
    return x, x


def with_nothing_sometimes(x):  # noqa: RET503  that is the point
    if x > 1.0:
        return x


def with_its_argument_changed(x):
    x = x > 1.0
    return not x


def with_a_counter_changed(x):
    for i in range(3):
        i = i + 1
    return x


def with_a_counter_behind(x):
    for i in range(3):
        x2 = x + i
    return x2 + i


def with_unsigned_and_signed(x):
    return np.uint64(3) + int(x)


def with_a_condition_added(x):
    return (x > 1.0) + 1


def with_lanes_asked(x):
    return 1.0 if any_of(fill(ONE) > ONE) else x


def with_what_is_not_there(x):
    return x + nowhere  # noqa: F821


def with_a_table_changed(x):
    TABLE[0] = x
    return x


def with_a_far_place(x):
    return TABLE[4] + x


def nothing(x):
    return


def with_nothing(x):
    x2 = nothing(x)
    return x + x2


def with_a_class(x):
    return Stream(int(x)).integer(3)


REFUSED = [
    (with_a_list, "`[x, x]`"),
    (with_a_power, "`x ** 2`"),
    (with_text, "`'x'`"),
    (with_numpy, "`np.sin`"),
    (with_a_keyword, "`max(x, key=None)`: arguments are given by position"),
    (with_try, "`try:`"),
    (with_a_default, "`with_a_default`; expected a function whose arguments"),
    (without_end, "`without_end` calls itself"),
    (over_a_list, "a loop over `(1, 2)`; use range"),
    (with_two_types, "a function that returns values of different types"),
    (with_nothing_sometimes, "`with_nothing_sometimes`: some path ends without a value"),
    (with_its_argument_changed, "`x` changes its type"),
    (with_a_counter_changed, "`i`, which counts a loop, is assigned to"),
    (with_a_counter_behind, "`i` is not known"),
    (with_unsigned_and_signed, "uint64 + int64"),
    (with_a_condition_added, "bool + int64"),
    (with_lanes_asked, "`any_of`"),
    (with_what_is_not_there, "`nowhere` is not known"),
    (with_a_table_changed, "`TABLE`, a constant, is changed"),
    (with_a_far_place, "index 4 of 4"),
    (with_nothing, "`nothing(x)`, which returns nothing"),
    (with_a_class, "`Stream(int(x))` is not known"),
]


@pytest.mark.parametrize(
    ("function", "construct"), REFUSED, ids=lambda each: getattr(each, "__name__", "")
)
def test_constructs_that_c_lacks_are_refused_by_name(
    function: Callable[..., Any], construct: str
) -> None:
    """The message names the file, the line and the construct."""
    arguments = dict.fromkeys(("x", "y")[: function.__code__.co_argcount], FLOAT64)
    with pytest.raises(ConfigError) as caught:
        functions([(function, arguments)], "zs")
    text = str(caught.value)
    assert construct in text
    assert "\n" not in text
    first = function.__code__.co_firstlineno
    assert any(
        text.startswith(f"test_translate.py, line {line}: cannot be translated to C: ")
        for line in range(first, first + 6)
    )


def test_names_that_are_taken_in_c_are_changed() -> None:
    """Names of Python that are words of C, or that another function has."""

    def double(int_, long):  # a word of C, twice
        auto = int_ + long
        return auto * 2.0

    text = functions([(double, {"int_": FLOAT64, "long": FLOAT64})], "zs").definitions
    assert "double zs_double_(double int, double long_)" not in text
    assert "auto_" in text
