"""A clock for tests of state machines."""


class FakeClock:
    """A clock that stands still until it is moved. Call it for the time in seconds."""

    def __init__(self, start: float = 1000.0) -> None:
        self.now = start

    def __call__(self) -> float:
        """Return the time in seconds."""
        return self.now

    def advance(self, seconds: float) -> float:
        """Move the clock forward and return the new time."""
        if not seconds >= 0:
            raise ValueError(f"seconds must be at least 0, not {seconds}")
        self.now += seconds
        return self.now
