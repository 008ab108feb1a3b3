"""The functions of portable.py are right, and have the same bits in Python and compiled."""

import hashlib
import math
from collections.abc import Callable
from decimal import Decimal, localcontext

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from zswarm.kernels.portable import (
    FAR,
    INT_MAX,
    INT_MIN,
    atan2,
    cos,
    distances,
    exp,
    log,
    mean,
    norm,
    ordered_sum,
    remainder,
    sigmoid,
    sin,
    tanh,
    to_int,
)
from zswarm.kernels.random import Stream

FUNCTIONS = (exp, sigmoid, tanh, to_int, sin, cos, atan2, remainder)
PLAIN = {
    function.__name__: getattr(function, "py_func", function) for function in FUNCTIONS
}
MANY = np.concatenate(
    [
        Stream(1).uniform(-746.0, 709.7, 20_000),
        Stream(2).uniform(-2.0, 2.0, 20_000),
        np.arange(-745.0, 709.5, 0.25),
    ]
)


def ulps(value: float, reference: float) -> float:
    return abs(value - reference) / math.ulp(reference)


def test_exp_is_within_one_unit_in_the_last_place() -> None:
    assert max(ulps(exp(x), math.exp(x)) for x in MANY.tolist()) <= 1.0


def test_exp_of_a_float32_rounds_to_the_right_float32_nearly_always() -> None:
    """Sigmoid networks rely on this: the last bit of the double rarely changes the float32."""
    numbers = Stream(3).uniform(-20.0, 20.0, 20_000).astype(np.float32)
    ours = np.array([exp(float(x)) for x in numbers]).astype(np.float32)
    assert (ours == np.exp(numbers.astype(np.float64)).astype(np.float32)).mean() > 0.9999


@pytest.mark.parametrize(
    ("x", "value"),
    [
        (0.0, 1.0),
        (-0.0, 1.0),
        (math.inf, math.inf),
        (-math.inf, 0.0),
        (709.782712893384, math.exp(709.782712893384)),
        (709.7827128933841, math.inf),
        (1e308, math.inf),
        (-745.1332191019412, 0.0),
        (-1e308, 0.0),
        (-708.0, math.exp(-708.0)),
        (5e-324, 1.0),
    ],
)
def test_exp_has_the_right_limits(x: float, value: float) -> None:
    assert exp(x) == pytest.approx(value, rel=2.3e-16, abs=0)


def test_exp_and_sigmoid_pass_nan_on() -> None:
    assert math.isnan(exp(math.nan))
    assert math.isnan(sigmoid(math.nan))


def test_exp_below_the_smallest_normal_number_loses_one_unit_at_most() -> None:
    for x in np.arange(-745.13, -708.0, 0.01).tolist():
        assert abs(exp(x) - math.exp(x)) <= 5e-324


def test_exp_does_not_fall_as_x_grows() -> None:
    values = np.array([exp(x) for x in np.sort(MANY).tolist()])
    assert (np.diff(values) >= 0).all()


@pytest.mark.parametrize(
    ("x", "value"),
    [(0.0, 0.5), (1000.0, 1.0), (-1000.0, 0.0), (math.inf, 1.0), (-math.inf, 0.0)],
)
def test_sigmoid_has_the_right_limits(x: float, value: float) -> None:
    assert sigmoid(x) == value


def test_sigmoid_is_within_two_units_in_the_last_place() -> None:
    for x in Stream(4).uniform(-40.0, 40.0, 5000).tolist():
        assert ulps(sigmoid(x), 1.0 / (1.0 + math.exp(-x))) <= 2.0


POSITIVE = np.concatenate(
    [
        Stream(6).uniform(0.5, 2.0, 20_000),
        2.0 ** Stream(7).uniform(-1022.0, 1023.9, 20_000),
    ]
)


def test_log_is_within_one_unit_in_the_last_place() -> None:
    ends = np.array(
        [5e-324, 2.0**-1022, 1.0 - 2.0**-53, 1.0 + 2.0**-52, 2.0, 1.7976931348623157e308]
    )
    numbers = np.concatenate([POSITIVE, ends])
    assert max(map(ulps, log(numbers).tolist(), map(math.log, numbers.tolist()))) <= 1.0
    assert log(np.ones(1)).tolist() == [0.0]


# From 0 over the smallest and the largest to infinity: 100 numbers of each power of two.
FLOAT32S = np.append(
    np.arange(0, 0x7F800000, 0x800000 // 100, np.uint32).view(np.float32),
    np.float32(np.inf),
)


def test_tanh_is_near_its_value_odd_and_never_falls() -> None:
    values = np.array([tanh(x) for x in FLOAT32S], np.float32)
    assert np.abs(values - np.tanh(FLOAT32S.astype(np.float64))).max() < 3.7e-5
    assert (np.diff(values) >= 0).all()
    assert values[0] == 0.0
    assert values[-1] == 1.0
    assert [tanh(-x) for x in FLOAT32S[::50]] == (-values[::50]).tolist()
    assert math.isnan(tanh(np.float32(math.nan)))
    assert (
        hashlib.blake2b(values.astype("<f4").tobytes(), digest_size=8).hexdigest()
        == "52b8656b87634a99"
    )


def test_tanh_in_python_gives_the_same_bits_as_the_compiled_form() -> None:
    for x in np.append(
        FLOAT32S[::7], Stream(5).uniform(-6.0, 6.0, 2000).astype(np.float32)
    ):
        plain = PLAIN["tanh"](x)
        assert plain.dtype == np.float32
        assert plain == tanh(x)


# Angles near 0, over the whole range for which the error is bounded, and near multiples of a
# quarter turn, where cancellation is worst.
ANGLES = np.concatenate(
    [
        Stream(6).uniform(-7.0, 7.0, 500),
        Stream(7).uniform(-FAR, FAR, 500),
        Stream(8).integers(636_000, 300) * (math.pi / 2),
    ]
)
PI = Decimal("3.14159265358979323846264338327950288419716939937510582097494459")


def sine(angle: Decimal) -> Decimal:
    """Return the sine with 40 digits, by Taylor's series after removing full turns."""
    x = angle - (angle / (2 * PI)).to_integral_value() * 2 * PI
    total = term = x
    for n in range(1, 45, 2):
        term = -term * x * x / ((n + 1) * (n + 2))
        total += term
    return total


def test_sin_and_cos_are_within_a_unit_in_the_last_place() -> None:
    """Which is the .8 that the docstring states."""
    with localcontext(prec=60):
        for angle in ANGLES.tolist():
            exact = Decimal(angle)
            assert abs(Decimal(sin(angle)) - sine(exact)) <= Decimal(
                0.8 * math.ulp(sin(angle))
            )
            assert abs(Decimal(cos(angle)) - sine(exact + PI / 2)) <= Decimal(
                0.8 * math.ulp(cos(angle))
            )


def test_atan2_is_within_one_and_a_third_units_in_the_last_place() -> None:
    """The test covers all directions, lengths and ratios; 1.3 is the bound of the docstring."""
    directions, sizes = (
        Stream(9).uniform(-math.pi, math.pi, 600),
        10.0 ** Stream(10).uniform(-4.0, 4.0, 600),
    )
    with localcontext(prec=60):
        for y, x in zip(
            (np.sin(directions) * sizes).tolist(),
            np.cos(directions).tolist(),
            strict=True,
        ):
            angle = atan2(y, x)
            s, c = sine(Decimal(angle)), sine(Decimal(angle) + PI / 2)
            # The tangent of the error.
            off = (Decimal(y) * c - Decimal(x) * s) / (Decimal(x) * c + Decimal(y) * s)
            assert abs(off) <= Decimal(1.3 * math.ulp(angle))


@pytest.mark.parametrize(
    ("y", "x", "angle"),
    [
        (0.0, 1.0, 0.0),
        (1.0, 0.0, math.pi / 2),
        (0.0, -1.0, math.pi),
        (-0.0, -1.0, math.pi),
        (-5e-324, -1.0, -math.pi),
        (-1.0, 0.0, -math.pi / 2),
        (1.0, 1.0, math.pi / 4),
        (-1.0, -1.0, -3 * math.pi / 4),
        (0.0, 0.0, 0.0),
        (1e308, -1e-308, math.pi / 2),
        (1e-308, 1e308, 0.0),
        (math.inf, -1e308, math.pi / 2),
        (1e308, -math.inf, math.pi),
        (-1.0, math.inf, 0.0),
        (math.inf, -math.inf, math.nan),
        (math.nan, 1.0, math.nan),
        (1.0, math.nan, math.nan),
    ],
)
def test_atan2_has_the_right_quadrants_and_limits(
    y: float, x: float, angle: float
) -> None:
    assert atan2(y, x) == pytest.approx(angle, rel=2.3e-16, abs=0, nan_ok=True)


@pytest.mark.parametrize("function", [sin, cos])
def test_sin_and_cos_of_nonfinite_numbers_are_nan(
    function: Callable[[float], float],
) -> None:
    assert all(math.isnan(function(x)) for x in (math.nan, math.inf, -math.inf))


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_sin_is_odd_and_cos_is_even_and_both_stay_within_one(x: float) -> None:
    """This also holds for large angles, whose reduction is inaccurate."""
    assert sin(-x) == -sin(x)
    assert cos(-x) == cos(x)
    assert sin(x) ** 2 + cos(x) ** 2 == pytest.approx(1.0, abs=1e-15)


def test_sin_of_a_large_angle_has_the_error_of_float64_pi() -> None:
    """It is 4e-17 of the angle: the error of float64's pi times how often pi is in the angle."""
    with localcontext(prec=60):
        for angle in Stream(11).uniform(FAR, 1e12, 200).tolist():
            assert abs(Decimal(sin(angle)) - sine(Decimal(angle))) <= Decimal(
                4e-17 * angle
            )


@given(st.floats(allow_nan=False, allow_infinity=False), st.floats(1e-300, 1e300))
def test_remainder_is_exact_and_has_the_sign_of_the_dividend(
    x: float, divisor: float
) -> None:
    assert remainder(x, divisor) == math.fmod(x, divisor)


def test_remainder_of_nonfinite_numbers_is_nan() -> None:
    assert all(math.isnan(remainder(x, 360.0)) for x in (math.nan, math.inf, -math.inf))


@given(st.floats(), st.floats())
def test_functions_of_angles_have_the_same_bits_in_python_and_compiled(
    x: float, y: float
) -> None:
    """The arguments are Python's floats and numpy's scalars."""
    for compiled, plain, single in (
        (sin(x), PLAIN["sin"](x), PLAIN["sin"](np.float64(x))),
        (cos(x), PLAIN["cos"](x), PLAIN["cos"](np.float64(x))),
        (atan2(y, x), PLAIN["atan2"](y, x), PLAIN["atan2"](np.float64(y), np.float64(x))),
        (
            remainder(x, 360.0),
            PLAIN["remainder"](x, 360.0),
            PLAIN["remainder"](np.float64(x), 360.0),
        ),
    ):
        assert str(compiled) == str(plain) == str(float(single))


def test_angles_have_the_same_bits_on_every_machine() -> None:
    """A digest of many values, made once, as below."""
    values = [
        [sin(x), cos(x), atan2(x, 3.0), atan2(2.0, x), remainder(x, 360.0)]
        for x in (ANGLES * 1.25).tolist()
    ]
    assert (
        hashlib.blake2b(np.array(values, "<f8").tobytes(), digest_size=8).hexdigest()
        == "d4261e2be6473637"
    )


def test_the_bits_are_the_same_on_every_machine() -> None:
    """Compare a digest of many values with a recorded one.

    Changing the arithmetic changes the behaviour of evolved controllers.
    """
    values = np.array([[exp(x), sigmoid(x)] for x in MANY.tolist()], "<f8")
    assert (
        hashlib.blake2b(MANY.astype("<f8").tobytes(), digest_size=8).hexdigest()
        == "e999c357037467e4"
    )
    assert (
        hashlib.blake2b(values.tobytes(), digest_size=8).hexdigest() == "896396ac685c3fc4"
    )


def test_the_logarithm_has_the_same_bits_on_every_machine() -> None:
    numbers = np.arange(1, 5000) / 1000.0
    assert (
        hashlib.blake2b(log(numbers).astype("<f8").tobytes(), digest_size=8).hexdigest()
        == "37d0b0346cc444eb"
    )


@given(st.floats())
def test_python_gives_the_same_bits_as_the_compiled_form(x: float) -> None:
    for function in (exp, sigmoid):
        compiled, plain = np.array([function(x), PLAIN[function.__name__](x)])
        assert compiled.tobytes() == plain.tobytes() or (
            math.isnan(compiled) and math.isnan(plain)
        )
    assert to_int(x) == PLAIN["to_int"](x)


@pytest.mark.parametrize(
    ("number", "whole"),
    [
        (0.0, 0),
        (2.9999, 2),
        (-2.9999, -2),
        (-0.5, 0),
        (math.nan, 0),
        (math.inf, INT_MAX),
        (-math.inf, INT_MIN),
        (2147483646.9, 2147483646),
        (2147483647.0, INT_MAX),
        (1e300, INT_MAX),
        (-2147483647.9, -2147483647),
        (-2147483648.5, INT_MIN),
        (-1e300, INT_MIN),
        (5e-324, 0),
    ],
)
def test_to_int_cuts_and_saturates_as_java_does(number: float, whole: int) -> None:
    assert to_int(number) == whole
    with np.errstate(over="ignore"):
        single = np.float32(number)
    assert to_int(single) == PLAIN["to_int"](single)


@given(st.floats(allow_nan=False))
def test_to_int_is_the_nearest_whole_number_towards_zero_in_range(number: float) -> None:
    assert to_int(number) == int(max(INT_MIN, min(INT_MAX, number)))


@pytest.mark.parametrize("dtype", [np.float64, np.float32, np.int64])
@pytest.mark.parametrize("size", [1, 2, 7, 8, 9, 128, 1000])
def test_reductions_have_the_bits_of_a_loop(size: int, dtype: type) -> None:
    """Compiled and in Python; numpy adds eight and more numbers in another order."""
    numbers = (Stream(size).uniform(-1e3, 1e3, size)).astype(dtype)
    listed = [float(number) for number in numbers]
    added = squares = 0.0
    for number in listed:
        added += number
        squares += number * number
    for function, expected in (
        (ordered_sum, added),
        (mean, added / size),
        (norm, math.sqrt(squares)),
    ):
        assert function(numbers) == expected
        assert function.py_func(numbers) == expected


def test_reductions_of_nothing() -> None:
    empty = np.empty(0)
    for function in (ordered_sum, ordered_sum.py_func, norm, norm.py_func):
        assert function(empty) == 0.0
    assert math.isnan(mean(empty))
    assert math.isnan(mean.py_func(empty))


def test_distances_of_all_pairs_are_rounded_once_per_operation() -> None:
    points, others = (
        Stream(seed).uniform(-5.0, 5.0, 14).reshape(7, 2) for seed in (1, 2)
    )
    expected = [
        [math.sqrt((a - x) * (a - x) + (b - y) * (b - y)) for a, b in others.tolist()]
        for x, y in points.tolist()
    ]
    for found in (distances(points, others[:5]), distances.py_func(points, others[:5])):
        assert found.tolist() == [row[:5] for row in expected]
