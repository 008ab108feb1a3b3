"""One profile for the tests that draw their own examples: no deadline, and on CI the same examples every time."""

import os
import signal
from collections.abc import Iterator

import pytest
from hypothesis import settings

settings.register_profile("local", deadline=None, print_blob=True)
settings.register_profile("ci", deadline=None, derandomize=True)
settings.load_profile("ci" if os.environ.get("CI") else "local")

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # begun in the background of a shell: programs that tests start hear Ctrl-C
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(autouse=True)
def compiled() -> Iterator[None]:
    """Commands that evaluate nothing say so to what they import; programs that later tests start are to compile."""
    before = os.environ.get("ZSWARM_PLAIN")
    yield
    os.environ.pop("ZSWARM_PLAIN", None)
    if before is not None:
        os.environ["ZSWARM_PLAIN"] = before
