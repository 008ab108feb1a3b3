"""Bind the fork server to the server that started it. The fork server alone imports this, first.

Then the kernel kills it together with the server, also while it is stopped or loads numba, and so
the slots' processes, which are bound to it in the same way.
"""

import ctypes
import gc
import os
import signal
import sys

PR_SET_PDEATHSIG = 1
PID = os.getpid()


def end_with_parent(parent: int) -> None:
    """Have the kernel kill this process when its parent ends, even inside a simulator."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:  # it ended before the call above
            os._exit(1)


end_with_parent(os.getppid())
# All that it loads stays, and garbage is a tenth of the time. A slot enables it again.
gc.disable()
