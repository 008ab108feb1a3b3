"""What a simulator raised: whether it decides a trial, and the words for it."""

import signal

from zswarm.errors import EvaluationError
from zswarm.sims.simulator import Simulator
from zswarm.sims.turns import BrokenContractError

MAX_ERROR_TEXT = 300


def is_outcome(raised: BaseException) -> bool:
    """Return whether an exception is the simulator's decision, and so the trial's outcome.

    It is, unless it is a fault or limit of the machine, or Ctrl-C, which slots ignore.
    """
    if isinstance(raised, KeyboardInterrupt):
        return signal.getsignal(signal.SIGINT) is not signal.default_int_handler
    return not isinstance(raised, (EvaluationError, MemoryError))


def error_text(simulator: Simulator, seed: int, raised: BaseException) -> str:
    """Return the error of a trial, which names its seed."""
    broken = isinstance(raised, BrokenContractError)
    what = str(raised) if broken else f"{type(raised).__name__}: {raised}"
    if not isinstance(raised, Exception):
        what += " (a simulator ends a trial by returning None, and never its process)"
    return f"{type(simulator).__name__}, trial seed {seed}: {what}"[:MAX_ERROR_TEXT]
