"""The four steps of docs/from-numpy.md run, keep the contract, and have the promised bits."""

import re
import sys

import pytest

from tests.repository import REPOSITORY

CHECK = """
import warnings, gather
from zswarm.testing import check_simulator, PortabilityWarning
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    check_simulator(gather.Gather, {"robots": 9, "steps": 4})
found = [each for each in caught if each.category is PortabilityWarning]
print(*(f"gather.py:{each.lineno}: {each.message}" for each in found), sep="\\n")
"""
OUTCOMES = """
import numpy as np, gather
from zswarm.evaluate import evaluate
from zswarm.kernels.random import Stream
from zswarm.testing.rules import fully_meshed
simulator = gather.Gather(gather.Settings())
network = fully_meshed(simulator.inputs, simulator.outputs)
rows, seeds = np.arange(4)[:, None], np.arange(4, dtype=np.uint64)
found = evaluate(simulator, network, network.random(4, Stream(1)), rows, seeds)
print(found.error or found.fitness.tobytes().hex())
"""


@pytest.mark.docs
def test_each_step_keeps_the_contract_and_the_last_three_have_equal_bits(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.syspath_prepend(REPOSITORY / "benchmarks")
    monkeypatch.setitem(sys.modules, "from_numpy", None)
    del sys.modules["from_numpy"]
    import from_numpy

    text = from_numpy.PAGE.read_text()
    steps = list(from_numpy.modules().values())
    # In one process, which compiles once.
    said = [from_numpy.run(module, CHECK + OUTCOMES).split("\n") for module in steps]
    *warned, first, _ = said[0]
    same = [outcomes for warning, outcomes, _ in said[1:] if warning == ""]
    assert len(same) == 3
    count = re.search(r"warns of (\d+) lines", text)
    assert count is not None
    assert len(warned) == int(count[1])
    shown = re.search(r"```text\n(.*?)```", text, re.S)
    assert shown is not None
    assert set(shown[1].splitlines()) < set(warned)
    assert len(set(same)) == 1
    assert first != same[0]
    assert len(first) == len(same[0]) == 4 * 8 * 2


def test_the_table_names_the_steps_that_are_measured(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.syspath_prepend(REPOSITORY / "benchmarks")
    import from_numpy

    rows = re.findall(r"^\| (\d\. [^|]+) \|", from_numpy.PAGE.read_text(), re.M)
    assert rows == list(from_numpy.STEPS)
