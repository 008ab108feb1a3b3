"""Check that results have the same bits compiled, in plain Python and on any emulated processor.

``bits.py`` defines what is compared, for all installed simulators, representations and optimizers.
"""

import functools
import json
import os
import platform
import subprocess
import sys
from pathlib import Path

import pytest

from tests.installed_parts import playable
from tests.kernels.warming import warmed_up
from tests.repository import REPOSITORY
from zswarm.plugins import registry as plugins

# The C library is asked by pymunk for sines and powers.
OLDEST_C_LIBRARY = {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-AVX512F,-FMA,-FMA4"}
ALL_VECTORS = {
    "NUMBA_OPT": "max",
    "NUMBA_LOOP_VECTORIZE": "1",
    "NUMBA_SLP_VECTORIZE": "1",
}
# The only place where numpy says what it chooses from.
NUMPY_FEATURES = """
from numpy._core import _multiarray_umath as compiled_numpy
features = compiled_numpy.__cpu_features__
print(*[name for name in compiled_numpy.__cpu_dispatch__ if features[name]])
"""
# the pendulums of two genomes may fall in the same step
FALL_ALIKE = "inverted-pendulum fully-meshed input_model="


def oldest_processor(python: Path | str = sys.executable) -> dict[str, str]:
    """Return an environment with the oldest processor of its architecture: no AVX, no FMA."""
    done = subprocess.run(
        [python, "-c", NUMPY_FEATURES], check=True, capture_output=True, text=True
    )
    return OLDEST_C_LIBRARY | {
        "NUMBA_CPU_NAME": "generic",
        "NUMBA_CPU_FEATURES": "",
        "NPY_DISABLE_CPU_FEATURES": done.stdout.strip(),
    }


def bits(
    *arguments: str, python: Path | str = sys.executable, **environment: str
) -> dict[str, str | int]:
    """Return a digest per compared item, and per problem the number of distinct outcomes."""
    cleared = {"ZSWARM_PLAIN": "", "NUMBA_DISABLE_JIT": "0"}
    done = subprocess.run(
        [python, "-W", "ignore", Path(__file__).with_name("bits.py"), *arguments],
        env=os.environ | cleared | environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    found: dict[str, str | int] = json.loads(done.stdout)
    later = [name for name, count in found.items() if "compiled" in name and count]
    assert later == [], "a batch compiles what warming up did not"
    return found


def alike(found: dict[str, str | int]) -> list[str]:
    """Return the simulator variants in which all genomes get the same outcome.

    Comparing these variants proves little.
    """
    return [
        name
        for name, different in found.items()
        if name.endswith(" fully-meshed: different") and different == 1
    ]


@functools.cache
def here(*trials: str) -> dict[str, str | int]:
    """Return the digests as this machine computes them."""
    return bits(*trials)


@pytest.mark.long
def test_plain_python_gives_the_same_bits_as_the_kernels() -> None:
    """Compare a few trials of all pairs of parts, with an older C library.

    Only pendulums may all have equal outcomes here.
    """
    compiled = here("few")
    plain = {"ZSWARM_PLAIN": "1"}
    assert bits("few", **plain, **OLDEST_C_LIBRARY) == compiled
    assert all(name.startswith(FALL_ALIKE) for name in alike(compiled))
    outcomes = [digest for name, digest in compiled.items() if name.endswith("outcomes")]
    assert len(set(outcomes)) > 0.9 * len(outcomes) > 5, (
        "the problems differ from one another"
    )


@pytest.mark.long
@pytest.mark.parametrize(
    "way",
    [
        pytest.param({"NUMBA_OPT": "0"}, id="without-optimization"),
        pytest.param(ALL_VECTORS, id="all-vectors"),
        pytest.param({"NUMBA_DISABLE_JIT": "1"}, id="not-compiled"),
    ],
)
def test_each_way_to_compile_gives_the_same_bits(
    way: dict[str, str], tmp_path: Path
) -> None:
    """Compare some networks in one simulator."""
    found = bits("sample", ZSWARM_CACHE=str(tmp_path), **way)
    assert len(found) > 30
    assert found == here("sample")


@pytest.mark.thorough
def test_the_oldest_processor_gives_the_same_bits_by_kernels_that_were_warmed_up(
    tmp_path: Path,
) -> None:
    """Whole trials reach what only happens late, and warming up compiles all that they need.

    The cache is empty at the start. It is a separate one: numba distinguishes processors in it, but
    not optimization levels.
    """
    oldest, cache = oldest_processor(), tmp_path / "cache"
    # Its 18 inputs are too many for mealy.
    names = playable([*(plugins.BUNDLED["simulator"].keys() - {"pettingzoo"}), "lazy"])
    found = warmed_up(names, tmp_path, cache, **oldest)
    assert {each.simulator for each in found} == set(names)
    assert any(each.compiled for each in found), "there was something to compile"
    assert {each.later for each in found} == {0}
    expected = here()
    assert not alike(expected)
    assert bits(ZSWARM_CACHE=str(cache), **oldest) == expected


WITH_WHAT = """
import json, sys
from tests.bits.bits import problems
from numpy._core import _multiarray_umath as compiled_numpy
assembly = "".join(next(problems())[2].step.dispatcher.inspect_asm().values())
features = [name for name, used in compiled_numpy.__cpu_features__.items() if used]
registers = [register for register in ("xmm", "ymm", "zmm") if register in assembly]
json.dump([features, registers], sys.stdout)
"""


@pytest.mark.long
@pytest.mark.skipif(
    platform.machine() != "x86_64",
    reason="the registers of other processors have other names",
)
def test_on_the_oldest_processor_nothing_newer_is_used(tmp_path: Path) -> None:
    oldest = oldest_processor()
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", WITH_WHAT],
        cwd=REPOSITORY,
        env=os.environ | {"ZSWARM_PLAIN": "", "ZSWARM_CACHE": str(tmp_path)} | oldest,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    features, registers = json.loads(done.stdout)
    assert not set(features) & set(oldest["NPY_DISABLE_CPU_FEATURES"].split())
    assert registers == ["xmm"]
