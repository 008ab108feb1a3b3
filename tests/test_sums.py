"""Check that no outcome depends on the order or the version of a sum of floats.

Python 3.12 adds floats by ``sum`` otherwise than 3.11, ``statistics`` and ``fsum`` round otherwise
than a loop, and numpy promises no order. Where outcomes are made, ``zswarm.kernels.sums`` adds
floats; integers are counted by ``np.count_nonzero`` or by a sum that ``int(...)`` encloses.
"""

import ast
import operator
from functools import reduce
from pathlib import Path

import numpy as np
import pytest

from tests.repository import REPOSITORY
from zswarm.kernels.sums import mean, total

PACKAGE = REPOSITORY / "zswarm"
# Where genomes, actions, outcomes, scores and statistics are computed.
ROOMS = (
    "kernels nets sims ot/assessment ot/optimizers ot/rankings ros/simulation ros/launch testing"
).split()
FILES = [
    *(PACKAGE / name for name in ("evaluate.py", "ot/generation.py", "ot/workload.py")),
    *(file for room in ROOMS for file in sorted((PACKAGE / room).rglob("*.py"))),
]
ADDING = set(
    "sum nansum fsum sumprod mean nanmean fmean average median std nanstd var nanvar dot vdot "
    "inner matmul tensordot einsum convolve correlate trace".split()
)


def sums(source: str) -> list[str]:
    """Return each sum in a module whose result is not made an integer at once."""
    tree = ast.parse(source)
    counted = {
        call.args[0]
        for call in ast.walk(tree)
        if isinstance(call, ast.Call)
        and isinstance(call.func, ast.Name)
        and call.func.id == "int"
        and call.args
    }
    found = []
    for node in ast.walk(tree):
        match node:
            case ast.Import(names=names):
                imported = {name.name.partition(".")[0] for name in names}
                found += [f"import {name}" for name in imported & {"statistics"}]
            case ast.ImportFrom(module="statistics" | "math" as module, names=names):
                found += [
                    f"{module}.{name.name}"
                    for name in names
                    if module == "statistics" or name.name in ADDING
                ]
            case ast.Call(func=ast.Name("sum")) if node not in counted:
                found.append(f"sum in line {node.lineno}")
            case ast.Call(func=ast.Attribute(attr=name)) if (
                name in ADDING and node not in counted
            ):
                found.append(f".{name} in line {node.lineno}")
            case ast.Name("sum") | ast.Attribute(ast.Name("np"), "sum"):
                found += _passed_on(node, tree)
    return found


def _passed_on(name: ast.expr, tree: ast.AST) -> list[str]:
    """Return a sum that is not called but given to another function, as in ``map(sum, rows)``."""
    called = {call.func for call in ast.walk(tree) if isinstance(call, ast.Call)}
    return [] if name in called else [f"sum in line {name.lineno}"]


@pytest.mark.parametrize(
    "file", FILES, ids=[str(file.relative_to(PACKAGE)) for file in FILES]
)
def test_floats_are_added_in_one_order_where_outcomes_are_made(file: Path) -> None:
    assert sums(file.read_text()) == []


@pytest.mark.parametrize(
    ("planted", "found"),
    [
        ("way = sum(shares) / 6", True),
        ("way = sum(share for share in shares)", True),
        ("way = list(map(sum, rows))", True),
        ("way = functools.reduce(np.sum, rows)", True),
        ("way = np.sum(shares)", True),
        ("way = shares.mean()", True),
        ("way = shares.std(axis=0)", True),
        ("way = math.fsum(shares)", True),
        ("from math import fsum", True),
        ("import statistics", True),
        ("from statistics import fmean", True),
        ("size = float(sum(sizes))", True),
        ("size = int(sum(sizes))", False),
        ("size = int(made.sum())", False),
        ("size = int(made.sum() / 2)", True),
        ("size = np.count_nonzero(made, axis=1)", False),
        ("way = total(shares)", False),
    ],
)
def test_the_check_finds_a_planted_sum(planted: str, found: bool) -> None:
    assert bool(sums(planted)) == found


def test_a_total_is_what_a_loop_adds() -> None:
    """Of many sizes: numpy adds eight and more numbers in pairs, Python 3.12 compensates."""
    for size in (1, 2, 7, 8, 9, 128, 129, 1000):
        numbers = np.sin(np.arange(1.0, size + 1)) * 1e3
        looped = reduce(operator.add, numbers.tolist())
        assert float(total(numbers)) == looped
        assert mean(np.append(numbers, np.nan)) == looped / size
    assert np.isnan(mean(np.array([np.nan])))
