"""What decides a result has the same bits compiled and in plain Python, and on any processor, as far as one can be played here.

What is compared is said by ``bits.py``, for all simulators, representations and optimizers that there are.
"""

import json
import os
import platform
import subprocess
import sys
from pathlib import Path

import pytest
from numpy._core import _multiarray_umath as compiled_numpy  # the only place where numpy says what it chooses from

OLDEST = {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""}  # of its architecture: no AVX, no FMA
NUMPY_FEATURES = [name for name in compiled_numpy.__cpu_dispatch__ if compiled_numpy.__cpu_features__[name]]
OLDEST_NUMPY = {"NPY_DISABLE_CPU_FEATURES": " ".join(NUMPY_FEATURES)}
OLDEST_C_LIBRARY = {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-AVX512F,-FMA,-FMA4"}  # pymunk asks it for sines and powers
SETTINGS: dict[str, dict[str, str]] = {
    "plain": {"ZSWARM_PLAIN": "1"},
    "plain, numba there": {"NUMBA_DISABLE_JIT": "1"},
    "oldest processor": OLDEST | OLDEST_NUMPY | OLDEST_C_LIBRARY,
    "compiled without optimization": {"NUMBA_OPT": "0"},
    "compiled with all vectors": {"NUMBA_OPT": "max", "NUMBA_LOOP_VECTORIZE": "1", "NUMBA_SLP_VECTORIZE": "1"},
}
FALL_ALIKE = "inverted-pendulum fully-meshed input_model="  # two genomes' pendulums may fall in the same step
SAID = {"whole": [], "short": ["short"]}  # to bits.py, of the trials


def bits(*arguments: str, **environment: str) -> dict[str, str | int]:
    """A digest for each thing that is compared; and how many outcomes differ between genomes, in each problem."""
    cleared = {"ZSWARM_PLAIN": "", "NUMBA_DISABLE_JIT": "0"}
    done = subprocess.run(
        [sys.executable, "-W", "ignore", Path(__file__).with_name("bits.py"), *arguments],
        env=os.environ | cleared | environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    found: dict[str, str | int] = json.loads(done.stdout)
    return found


def alike(found: dict[str, str | int]) -> list[str]:
    """Simulators, in all ways, that no genome makes a difference to: a comparison says little about them."""
    return [name for name, different in found.items() if name.endswith(" fully-meshed: different") and different == 1]


@pytest.fixture(scope="module")
def here() -> dict[str, dict[str, str | int]]:
    """As this machine computes."""
    return {trials: bits(*said) for trials, said in SAID.items()}


def test_plain_python_gives_the_same_bits_as_the_kernels() -> None:
    """Of all simulators and representations, few trials each; the rest is in the test below. Few play alike in these.

    Plain Python has an older C library, too.
    """
    compiled = bits("few")
    assert bits("few", **SETTINGS["plain"], **OLDEST_C_LIBRARY) == compiled
    assert all(name.startswith(FALL_ALIKE) for name in alike(compiled))
    outcomes = [digest for name, digest in compiled.items() if name.endswith("outcomes")]
    assert len(set(outcomes)) > 0.9 * len(outcomes) > 5, "the problems differ from one another"


@pytest.mark.long
@pytest.mark.parametrize("setting", SETTINGS)
def test_the_bits_are_the_same_on_another_processor(setting: str, here: dict[str, dict[str, str | int]], tmp_path: Path) -> None:
    """A cache of its own: numba tells processors apart in it, but not how much it optimizes."""
    trials = "short" if setting.startswith("plain") else "whole"
    assert not alike(here[trials])
    assert bits(*SAID[trials], ZSWARM_CACHE=str(tmp_path), **SETTINGS[setting]) == here[trials]


WITH_WHAT = """
import json, sys
from bits import problems
from numpy._core import _multiarray_umath as compiled_numpy
assembly = "".join(next(problems())[2].step.inspect_asm().values())
features = [name for name, used in compiled_numpy.__cpu_features__.items() if used]
json.dump([features, [register for register in ("xmm", "ymm", "zmm") if register in assembly]], sys.stdout)
"""


@pytest.mark.long
@pytest.mark.skipif(platform.machine() != "x86_64", reason="the registers of other processors have other names")
def test_on_the_oldest_processor_nothing_newer_is_used(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", WITH_WHAT], cwd=Path(__file__).parent,
        env=os.environ | {"ZSWARM_PLAIN": "", "ZSWARM_CACHE": str(tmp_path)} | OLDEST | OLDEST_NUMPY,
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    features, registers = json.loads(done.stdout)
    assert not set(features) & set(NUMPY_FEATURES)
    assert registers == ["xmm"]
