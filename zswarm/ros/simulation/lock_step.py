"""When a simulation in lock-step steps: once each robot has sent a velocity for the present stamp.

Pure: messages and the time in, decisions out; ``node`` is the shell around it.
"""

from collections.abc import Iterable, Mapping
from typing import NamedTuple

from zswarm.ros.link.messages import Velocity


class Step(NamedTuple):
    """All have sent a velocity: let a step pass."""

    velocities: Mapping[int, Velocity]


class Overdue(NamedTuple):
    """These sent none in time; the simulation waits no longer."""

    robots: tuple[int, ...]
    stamp_ns: int


class LockStep:
    """Waits for one velocity of each robot that acts."""

    def __init__(self, deadline_s: float) -> None:
        self._deadline_s = deadline_s
        self._velocities: dict[int, Velocity] = {}
        self.stop()

    def ask(self, robots: Iterable[int], stamp_ns: int, now: float) -> None:
        """Wait for robots whose scans of this stamp were published; now is in s, monotonic."""
        self._velocities.clear()
        self._awaited = frozenset(robots)
        self._stamp_ns, self._due = stamp_ns, now + self._deadline_s

    def stop(self) -> None:
        """Wait for no robot."""
        self.ask((), 0, 0.0)

    def left_s(self, now: float, otherwise: float) -> float:
        """Return how long to wait for the next message."""
        return max(0.0, self._due - now) if self._awaited else otherwise

    def handle(self, velocity: Velocity | None, now: float) -> Step | Overdue | None:
        """Return what to do after a velocity, or none, came.

        A velocity that is not awaited is ignored: of a robot that is out, or with another stamp.
        One without a stamp is for the present. Of two of the same robot the later one counts.
        """
        if not self._awaited:
            return None
        is_awaited = velocity is not None and velocity.robot in self._awaited
        if (
            velocity is not None
            and is_awaited
            and velocity.stamp_ns in (0, self._stamp_ns)
        ):
            self._velocities[velocity.robot] = velocity
        if len(self._velocities) == len(self._awaited):
            velocities = dict(self._velocities)
            self.stop()
            return Step(velocities)
        if now < self._due:
            return None
        silent = Overdue(
            tuple(sorted(self._awaited - self._velocities.keys())), self._stamp_ns
        )
        self.stop()
        return silent
