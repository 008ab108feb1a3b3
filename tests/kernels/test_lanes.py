"""Eight numbers side by side do in kernels what they do in Python, bit for bit."""

from typing import Any

import numpy as np
import pytest

from zswarm.kernels.jit import array, float32, float64, int32, kernel, sqrt, void
from zswarm.kernels.lanes import (
    LANES,
    any_of,
    fill,
    floor,
    list_true,
    load,
    scatter,
    select,
    store,
    window,
)
from zswarm.kernels.random import Stream

HALF, THREE, ONE_CELL = np.float32(0.5), np.float32(3), np.int32(1)
FLOATS, CELLS = array(float32), array(int32)


@kernel(void(FLOATS, FLOATS, CELLS, CELLS, FLOATS))
def work(numbers, out, places, found, table):  # type: ignore[no-untyped-def]  # compiled
    left, right = load(numbers, 0), load(numbers, LANES)
    store(out, 0, left + right)
    store(out, LANES, left - right * HALF)
    store(out, 2 * LANES, THREE / left)
    store(out, 3 * LANES, select(left < right, left, HALF))
    store(
        out,
        4 * LANES,
        select((left <= right) & (left != THREE) | (right >= THREE), right, left),
    )
    store(
        out, 5 * LANES, select((left > right) | (left == right), fill(THREE), fill(HALF))
    )
    out[6 * LANES] = select(any_of(left > THREE), HALF, THREE)
    here = load(places, 0)
    store(found, 0, select(here == ONE_CELL, here * here + 2, here - ONE_CELL))
    found[LANES + 1] = list_true(left < right, 100, found, LANES + 2)
    for column, cells in enumerate(window(table, here, 2)):
        store(out, (7 + column) * LANES, cells)
    scatter(table, here, left)


@pytest.mark.parametrize(
    "awkward", [(), (0.0, -0.0, np.inf, -np.inf, np.nan, 1e38, -1e-45)]
)
def test_the_compiled_form_gives_the_bits_of_the_plain_one(
    awkward: tuple[float, ...],
) -> None:
    results = []
    for form in (work, getattr(work, "py_func", work)):
        numbers = Stream(1).uniform(-5.0, 5.0, 2 * LANES).astype(np.float32)
        numbers[: len(awkward)] = awkward
        out, found = np.zeros(11 * LANES, np.float32), np.zeros(3 * LANES, np.int32)
        table = np.arange(40, dtype=np.float32)
        with np.errstate(all="ignore"):
            form(
                numbers, out, np.array([0, 33, 7, 1, 1, 20, 0, 5], np.int32), found, table
            )
        found[LANES + 2 + found[LANES + 1] :] = 0  # what came behind the list
        results.append((out, found, table))
    for compiled, plain in zip(*results, strict=True):
        assert np.array_equal(compiled, plain, equal_nan=True)
        assert (np.signbit(compiled) == np.signbit(plain))[~np.isnan(plain)].all()
    out, found, table = results[0]
    assert found[:LANES].tolist() == [-1, 32, 6, 3, 3, 19, -1, 4]
    less = [100 + lane for lane in range(LANES) if numbers[lane] < numbers[LANES + lane]]
    assert found[LANES + 1 : LANES + 2 + len(less)].tolist() == [len(less), *less]
    assert out[7 * LANES :].reshape(4, LANES)[:, 2].tolist() == [9.0, 10.0, 11.0, 12.0]
    assert np.array_equal(table[[0, 1]], numbers[[6, 4]], equal_nan=True), (
        "the last lane is written last"
    )


DOUBLES = array(float64)


@kernel(void(DOUBLES, DOUBLES))
def work_in_double(numbers, out):  # type: ignore[no-untyped-def]  # compiled
    left, right = load(numbers, 0), load(numbers, LANES)
    store(out, 0, left + right * 0.5)
    store(out, LANES, 3.0 / left - right)
    store(out, 2 * LANES, floor(left) + sqrt(select(right > 0.0, right, fill(2.0))))
    out[3 * LANES] = floor(numbers[1]) if any_of(left < right) else sqrt(numbers[0])


@pytest.mark.parametrize("awkward", [(), (0.0, -0.0, np.inf, -np.inf, np.nan, 1e300)])
def test_float64_has_the_bits_of_the_plain_form(awkward: tuple[float, ...]) -> None:
    numbers = Stream(2).uniform(-5.0, 5.0, 2 * LANES)
    numbers[: len(awkward)] = awkward
    results = []
    for form in (work_in_double, getattr(work_in_double, "py_func", work_in_double)):
        out = np.zeros(3 * LANES + 1)
        with np.errstate(all="ignore"):
            form(numbers, out)
        results.append(out)
    assert np.array_equal(*results, equal_nan=True)
    plain = results[1][~np.isnan(results[1])]
    assert (np.signbit(results[0][~np.isnan(results[1])]) == np.signbit(plain)).all()
    assert results[1][2 * LANES + 7] == np.floor(numbers[7]) + np.sqrt(
        numbers[15] if numbers[15] > 0.0 else 2.0
    )


@pytest.mark.parametrize("number", [1.5, np.float64(2), 3])
def test_numbers_of_another_type_are_refused(number: Any) -> None:
    """They would be rounded otherwise in Python than in a kernel."""
    numba = pytest.importorskip("numba")

    def mixed(numbers, out):  # type: ignore[no-untyped-def]  # compiled
        store(out, 0, load(numbers, 0) + number)

    from zswarm.kernels.compiler import compiled

    with pytest.raises(
        numba.TypingError
    ):  # not declared, or it would be compiled with all
        compiled(mixed, void(FLOATS, FLOATS), {})
