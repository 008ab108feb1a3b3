"""The functions of portable.py are right, and have the same bits in Python and compiled."""

import hashlib
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from zswarm.draws import Stream
from zswarm.portable import INT_MAX, INT_MIN, exp, log, sigmoid, tanh, to_int

PLAIN = {function.__name__: getattr(function, "py_func", function) for function in (exp, sigmoid, tanh, to_int)}
MANY = np.concatenate(
    [Stream(1).uniform(-746.0, 709.7, 20_000), Stream(2).uniform(-2.0, 2.0, 20_000), np.arange(-745.0, 709.5, 0.25)]
)


def ulps(value: float, reference: float) -> float:
    return abs(value - reference) / math.ulp(reference)


def test_exp_is_within_one_unit_in_the_last_place() -> None:
    assert max(ulps(exp(x), math.exp(x)) for x in MANY.tolist()) <= 1.0


def test_exp_of_a_float32_rounds_to_the_right_float32_nearly_always() -> None:
    """What the sigmoid of a network relies on: the double's last bit rarely matters to the float32."""
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


@pytest.mark.parametrize(("x", "value"), [(0.0, 0.5), (1000.0, 1.0), (-1000.0, 0.0), (math.inf, 1.0), (-math.inf, 0.0)])
def test_sigmoid_has_the_right_limits(x: float, value: float) -> None:
    assert sigmoid(x) == value


def test_sigmoid_is_within_two_units_in_the_last_place() -> None:
    for x in Stream(4).uniform(-40.0, 40.0, 5000).tolist():
        assert ulps(sigmoid(x), 1.0 / (1.0 + math.exp(-x))) <= 2.0


POSITIVE = np.concatenate([Stream(6).uniform(0.5, 2.0, 20_000), 2.0 ** Stream(7).uniform(-1022.0, 1023.9, 20_000)])


def test_log_is_within_one_unit_in_the_last_place() -> None:
    ends = np.array([5e-324, 2.0**-1022, 1.0 - 2.0**-53, 1.0 + 2.0**-52, 2.0, 1.7976931348623157e308])
    numbers = np.concatenate([POSITIVE, ends])
    assert max(map(ulps, log(numbers).tolist(), map(math.log, numbers.tolist()))) <= 1.0
    assert log(np.ones(1)).tolist() == [0.0]


# From 0 over the smallest and the largest to infinity: 100 numbers of each power of two.
FLOAT32S = np.append(np.arange(0, 0x7F800000, 0x800000 // 100, np.uint32).view(np.float32), np.float32(np.inf))


def test_tanh_is_near_its_value_odd_and_never_falls() -> None:
    values = np.array([tanh(x) for x in FLOAT32S], np.float32)
    assert np.abs(values - np.tanh(FLOAT32S.astype(np.float64))).max() < 3.7e-5
    assert (np.diff(values) >= 0).all()
    assert values[0] == 0.0
    assert values[-1] == 1.0
    assert [tanh(-x) for x in FLOAT32S[::50]] == (-values[::50]).tolist()
    assert math.isnan(tanh(np.float32(math.nan)))
    assert hashlib.blake2b(values.astype("<f4").tobytes(), digest_size=8).hexdigest() == "52b8656b87634a99"


def test_tanh_in_python_gives_the_same_bits_as_the_compiled_form() -> None:
    for x in np.append(FLOAT32S[::7], Stream(5).uniform(-6.0, 6.0, 2000).astype(np.float32)):
        plain = PLAIN["tanh"](x)
        assert plain.dtype == np.float32
        assert plain == tanh(x)


def test_the_bits_are_those_of_every_other_machine() -> None:
    """A digest of many values, made once: whoever changes the arithmetic changes what evolved controllers do."""
    values = np.array([[exp(x), sigmoid(x)] for x in MANY.tolist()], "<f8")
    assert hashlib.blake2b(MANY.astype("<f8").tobytes(), digest_size=8).hexdigest() == "e999c357037467e4"
    assert hashlib.blake2b(values.tobytes(), digest_size=8).hexdigest() == "896396ac685c3fc4"


def test_the_logarithm_has_the_bits_of_every_other_machine() -> None:
    numbers = np.arange(1, 5000) / 1000.0
    assert hashlib.blake2b(log(numbers).astype("<f8").tobytes(), digest_size=8).hexdigest() == "37d0b0346cc444eb"


@given(st.floats())
def test_python_gives_the_same_bits_as_the_compiled_form(x: float) -> None:
    for function in (exp, sigmoid):
        compiled, plain = np.array([function(x), PLAIN[function.__name__](x)])
        assert compiled.tobytes() == plain.tobytes() or (math.isnan(compiled) and math.isnan(plain))
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
