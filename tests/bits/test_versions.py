"""Check that results have the same bits on every supported Python, numpy and numba.

Environments are made in ``build/bits`` with what ``pyproject.toml`` asks for, once: with the newest
packages for the newest Python, and with the oldest numpy and numba for the oldest Python, on the
oldest processor. Later Pythons have no builds of these. The newest packages are those that compile
here, so the newest Python compiles nothing; with ``make thorough`` all do, in another way: a few
steps show how a kernel was compiled. There the oldest compile the largest simulator, too.
"""

import functools
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.bits.test_bits import ALL_VECTORS, bits, oldest_processor
from tests.repository import REPOSITORY

pytestmark = pytest.mark.versions
PROJECT = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]
SUPPORTED = ("3.11", "3.12", "3.13")
HERE = "{}.{}".format(*sys.version_info)
OLDEST = ("numba", "numpy")
# Ways to compile.
USUAL: dict[str, str] = {}
PLAIN = {"ZSWARM_PLAIN": "1"}
VERSION = "import sys; print('{}.{}'.format(*sys.version_info))"
UV = shutil.which("uv")


def said(*command: str | Path) -> str:
    """Return what a program prints; "" if it fails."""
    if shutil.which(command[0]) is None:
        return ""
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return done.stdout.strip() if done.returncode == 0 else ""


def candidates(python: str) -> Iterator[str]:
    """Yield where an interpreter may be: this one, the system's, uv's, pyenv's."""
    if python == HERE:
        yield sys.executable
    yield f"python{python}"
    yield said("uv", "python", "find", python)
    if latest := said("pyenv", "latest", python):
        yield f"{said('pyenv', 'prefix', latest)}/bin/python"


def interpreter(python: str) -> str:
    """Return an interpreter of a version that can make environments, or skip the test."""
    for found in filter(None, candidates(python)):
        # uv makes environments without the help of the interpreter.
        if said(found, "-c", VERSION) == python and (
            UV or said(found, "-c", "import ensurepip, venv; print(True)")
        ):
            return found
    pytest.skip(f"no Python {python}: install it, or uv or pyenv with it")


def requirements(*, oldest: bool) -> list[str]:
    """Return what zswarm needs, with the lower bounds of what decides bits if asked for."""
    found: list[str] = PROJECT["dependencies"]
    if not oldest:
        return found
    return [
        name.replace(">=", "==") if name.split(">=")[0] in OLDEST else name
        for name in found
    ]


def environment(python: str, *, oldest: bool) -> Path:
    """Return the interpreter of an environment, which is made if it is missing or outdated."""
    folder = (
        REPOSITORY / "build" / "bits" / f"{python}-{'oldest' if oldest else 'newest'}"
    )
    needed, ready = requirements(oldest=oldest), folder / "ready"
    made = folder / "bin" / "python"
    if ready.exists() and ready.read_text() == "\n".join(needed):
        return made
    base = interpreter(python)
    shutil.rmtree(folder, ignore_errors=True)
    make = [UV, "venv", "--python", base] if UV else [base, "-m", "venv"]
    install = [made, "-m", "pip", "install", "--disable-pip-version-check"]
    if UV:
        install = [UV, "pip", "install", "--python", made]
    subprocess.run([*make, folder], check=True, capture_output=True)
    subprocess.run([*install, "--quiet", *needed], check=True)
    ready.write_text("\n".join(needed))
    return made


@functools.cache
def here(compared: str) -> dict[str, str | int]:
    """Return the digests as the Python that runs the tests computes them."""
    return bits(compared)


@pytest.mark.parametrize(
    ("python", "oldest", "way", "compared"),
    [
        (SUPPORTED[0], True, USUAL, "brief"),
        (SUPPORTED[-1], False, PLAIN, "brief"),
        *(
            pytest.param(*how, "versions", marks=pytest.mark.thorough)
            for how in (
                (SUPPORTED[0], True, USUAL),
                (SUPPORTED[0], True, {"NUMBA_OPT": "0"}),
                *((python, False, ALL_VECTORS) for python in SUPPORTED),
            )
        ),
    ],
)
def test_the_bits_are_the_same_with_other_versions(
    python: str, oldest: bool, way: dict[str, str], compared: str, tmp_path: Path
) -> None:
    made = environment(python, oldest=oldest)
    found = bits(
        compared,
        python=made,
        PYTHONPATH=str(REPOSITORY),
        ZSWARM_CACHE=str(tmp_path),
        **way,
        **(oldest_processor(made) if oldest else {}),
    )
    differing = [
        name for name, digest in here(compared).items() if found.get(name) != digest
    ]
    assert differing == []
    assert len(found) == len(here(compared)) > 100


def test_the_supported_versions_begin_where_the_project_says() -> None:
    assert PROJECT["requires-python"] == f">={SUPPORTED[0]}"
    assert {"numba==0.61", "numpy==2.0"} <= set(requirements(oldest=True))
