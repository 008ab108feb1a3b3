"""Use one profile for generated examples: no deadline, and fixed examples on CI."""

import contextlib
import gc
import itertools
import os
import re
import signal
import subprocess
import sys
import tempfile
import time

import pytest
from hypothesis import settings

from zswarm.system.start import ONE_THREAD

settings.register_profile("local", deadline=None, print_blob=True)
settings.register_profile("ci", deadline=None, derandomize=True)
settings.load_profile("ci" if os.environ.get("CI") else "local")

# Hundreds of programs are started: each would compile the Python that it imports.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False
# Scripts of tests, too: zswarm's programs do so themselves.
os.environ.update(ONE_THREAD)

# Where servers have their sockets: tests that run at the same time see none of each other's.
SOCKETS = tempfile.TemporaryDirectory(prefix="zswarm-")
os.environ["RUNTIME_DIRECTORY"] = SOCKETS.name

# When checks no longer begin a test (.ci/run), in seconds since 1970.
CHECKS_END = float(os.environ.get("CHECKS_END", "inf"))

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # Even if a shell started pytest in the background, programs of tests must receive Ctrl-C.
    signal.signal(signal.SIGINT, signal.default_int_handler)

EVERY_KERNEL = """
import contextlib, multiprocessing
import zswarm.kernels.compiler
from zswarm.kernels.jit import compile_all
from zswarm.plugins import registry as plugins

def load(part):
    with contextlib.suppress(Exception):
        plugins.load(*part)
        compile_all()

parts = [(kind, name) for kind in ("simulator", "representation") for name in plugins.BUNDLED[kind]]
with multiprocessing.get_context("fork").Pool() as pool:
    pool.map(load, parts, chunksize=1)
"""


# The longest tests start first, so that none of them runs alone at the end.
LONGEST = [
    "tests/benchmarks/test_quick_forms.py::test_the_quick_form_of_a_target_runs_to_its_end[bench]",
    "tests/benchmarks/test_paper.py::test_everything_is_measured",
    "tests/integration/test_kills.py",
    "tests/bits/test_bits.py::test_the_oldest_processor",
    "tests/bits/test_bits.py::test_plain_python",
    "tests/bits/test_bits.py::test_each_way",
    "tests/sims/test_robot_tasks.py::test_the_example_evolves",
    "tests/sims/test_champions.py",
    "tests/docs/test_notebook.py",
    "tests/docs/test_docs_commands.py",
    "tests/integration/test_long_faults.py",
    "tests/integration/test_foreign_programs.py::test_whole_runs",
    "tests/integration/test_turns.py::test_lost_answers_are_requested_again",
    "tests/benchmarks/test_quick_forms.py",
    "tests/ot/optimizers/test_examples.py::test_novelty_finds",
    "tests/ot/optimizers/test_neat.py::test_xor_takes",
    "tests/sims/adapters/test_pettingzoo.py::test_evolution",
    "tests/integration/test_wrong_servers.py",
    "tests/integration/test_every_part.py::test_every_part_survives",
    "tests/integration/test_mixed.py",
]
# Tests that import pyribs, and with it pandas and scikit-learn: several seconds of a worker.
ARCHIVES = re.compile(r"cma-me|map-elites|elites\.py")


@pytest.hookimpl(trylast=True)  # of the tests that marks have left
def pytest_collection_modifyitems(
    config: pytest.Config, items: list[pytest.Item]
) -> None:
    """Give each worker its part of the longest tests first, and then neighbours.

    xdist gives each worker an equal share of the list, and one that has nothing left to do takes
    what is at the end of another's. Tests that import the same large package are neighbours.
    """
    workers = getattr(config, "workerinput", {}).get("workercount", 1)
    named = (item for part in LONGEST for item in items if item.nodeid.startswith(part))
    longest = list(dict.fromkeys(named))  # a name may begin with another
    chosen = set(longest)
    others = iter(
        sorted(
            (item for item in items if item not in chosen),
            key=lambda item: not ARCHIVES.search(item.nodeid),
        )
    )
    left, shares = len(items), list[pytest.Item]()
    for worker in range(workers):
        size = left // (workers - worker)
        first = longest[worker::workers]
        shares += [*first, *itertools.islice(others, max(0, size - len(first)))]
        left -= size
    items[:] = [*shares, *others]


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup() -> None:
    """Skip what would begin too late, so that checks on a very slow machine end with a result."""
    if time.time() > CHECKS_END:
        pytest.skip("out of time")


def pytest_configure(config: pytest.Config) -> None:
    """Compile kernels once on all cores, before several workers each compile all of them."""
    # Only if all tests run.
    whole = config.args_source is pytest.Config.ArgsSource.TESTPATHS
    if (
        whole
        and not hasattr(config, "workerinput")
        and config.getoption("numprocesses", None)
    ):
        with contextlib.suppress(subprocess.TimeoutExpired):
            # A failure shows up in its test.
            subprocess.run(
                [sys.executable, "-c", EVERY_KERNEL],
                capture_output=True,
                check=False,
                timeout=min(900, max(0, CHECKS_END - time.time())),
            )


@pytest.fixture(scope="module", autouse=True)
def _young_heap() -> None:
    """Exempt what is loaded from garbage collection: it would be traversed in every test."""
    gc.collect()
    gc.freeze()
