"""One profile for the tests that draw their own examples: no deadline, and on CI the same examples every time."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator

import pytest
from hypothesis import settings

settings.register_profile("local", deadline=None, print_blob=True)
settings.register_profile("ci", deadline=None, derandomize=True)
settings.load_profile("ci" if os.environ.get("CI") else "local")

# Hundreds of programs are started: each would compile the Python that it imports.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # begun in the background of a shell: programs that tests start hear Ctrl-C
    signal.signal(signal.SIGINT, signal.default_int_handler)

EVERY_KERNEL = """
import contextlib, multiprocessing
import zswarm.jit
from zswarm import plugins

def load(part):
    with contextlib.suppress(Exception):
        plugins.load(*part)

parts = [(kind, name) for kind in ("simulator", "representation") for name in plugins.BUNDLED[kind]]
with multiprocessing.get_context("fork").Pool() as pool:
    pool.map(load, parts, chunksize=1)
"""


def pytest_configure(config: pytest.Config) -> None:
    """Compile what is not in the cache, on all cores, before there are several workers: each would compile all of it."""
    if not hasattr(config, "workerinput") and config.getoption("numprocesses", None):
        subprocess.run([sys.executable, "-c", EVERY_KERNEL], capture_output=True, check=False)  # what fails fails in its test


@pytest.fixture(autouse=True)
def compiled() -> Iterator[None]:
    """Commands that evaluate nothing say so to what they import; programs that later tests start are to compile."""
    before = os.environ.get("ZSWARM_PLAIN")
    yield
    os.environ.pop("ZSWARM_PLAIN", None)
    if before is not None:
        os.environ["ZSWARM_PLAIN"] = before
