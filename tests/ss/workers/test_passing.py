"""Which failures of a preparation are worth another attempt later."""

import errno

import pytest

from tests.ss.slots.table_server import reserve
from zswarm.errors import ConfigError, EvaluationError
from zswarm.ss.slots.events import PrepareSlot, RunChunk, Unprepared
from zswarm.ss.workers import child
from zswarm.ss.workers.passing import may_pass

FULL = OSError(errno.ENOSPC, "No space left on device")
MISSING = FileNotFoundError(errno.ENOENT, "No such file or directory")


def wrapped(cause: Exception, *, shown: bool = True) -> ConfigError:
    """Return the error of a part that could not be set up because of another one."""
    try:
        try:
            raise cause
        except Exception as error:
            text = f"simulator 'x' cannot be set up: {error}"
            raise ConfigError(text) from (error if shown else None)
    except ConfigError as error:
        return error


@pytest.mark.parametrize(
    ("error", "passes"),
    [
        (FULL, True),
        (wrapped(FULL), True),
        (wrapped(FULL, shown=False), True),
        (wrapped(wrapped(ConnectionRefusedError(errno.ECONNREFUSED, "refused"))), True),
        (wrapped(TimeoutError("no ROS master answers")), True),
        (EvaluationError("its program ended"), True),
        (MISSING, False),
        (wrapped(MISSING), False),
        (ConfigError("problem.settings: unknown key 'x'"), False),
        (wrapped(ValueError("robots must be positive")), False),
    ],
)
def test_what_a_machine_lacks_may_be_there_later(error: Exception, passes: bool) -> None:
    assert may_pass(error) == passes


@pytest.mark.parametrize(("error", "passes"), [(FULL, True), (MISSING, False)])
def test_a_slot_reports_why_it_could_not_be_prepared(
    error: Exception, passes: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    slot = object.__new__(child.SlotProcess)
    slot._slot = 3

    def fails(*_: object) -> None:
        raise error

    monkeypatch.setattr(child.SlotProcess, "_prepare", fails)
    monkeypatch.setattr(child.SlotProcess, "_run", fails)
    command = PrepareSlot(3, reserve())
    assert slot.handle(command) == Unprepared(3, str(error), passes)
    with pytest.raises(OSError, match=r"device|file"):
        slot.handle(RunChunk(3, None))  # type: ignore[arg-type]
