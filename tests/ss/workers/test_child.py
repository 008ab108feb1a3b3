"""A slot's process: what its forked copies cannot do."""

import subprocess
import sys

FORKS = """
import mmap, os, socket
import numpy as np
from zswarm.ss.workers import child
from zswarm.ss.workers.frames import ProcessEnd

here, there = socket.socketpair()
pipe = ProcessEnd(there, b"12345678")
progress = np.frombuffer(mmap.mmap(-1, mmap.PAGESIZE), np.int64)[1:3]
child._cut_off_copies(pipe, progress)
progress[0] = 5
if os.fork() == 0:
    told, progress[0] = progress[1], 7
    os._exit(told + 2 * (pipe.fileno() == -1) + 4 * pipe.connected())
print(os.waitstatus_to_exitcode(os.wait()[1]), *progress, pipe.connected())
"""


def test_a_forked_copy_has_no_pipe_and_its_own_progress() -> None:
    """It is told to stop, and neither answers nor overwrites what the server reads."""
    forked = subprocess.run(
        [sys.executable, "-c", FORKS], capture_output=True, text=True, check=True
    )
    assert forked.stdout.split() == ["3", "5", "0", "True"]
