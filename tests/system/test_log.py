"""Test the log of the daemons."""

import json
import subprocess
import sys

LOGS = """
import sys
from zswarm.system import log
log.info("begun", slots=2)
assert "rich" not in sys.modules
import rich.console
"""


def test_a_line_is_one_json_object_and_does_not_load_rich() -> None:
    """Other modules find rich as before."""
    done = subprocess.run(
        [sys.executable, "-c", LOGS], check=True, capture_output=True, text=True
    )
    line = json.loads(done.stderr)
    assert (line["event"], line["slots"], line["level"]) == ("begun", 2, "info")
