"""When a simulation steps that waits for its robots: as soon as each of them told how it drives, at the present stamp.

Pure: messages and the time in, what is to be done out; ``node`` is the shell around it.
"""

from collections.abc import Iterable, Mapping
from typing import NamedTuple

from zswarm.ros.messages import Velocity


class Step(NamedTuple):
    """All have told: let a step pass."""

    velocities: Mapping[int, Velocity]


class Overdue(NamedTuple):
    """These have not told in time: nothing is waited for any more."""

    robots: tuple[int, ...]
    stamp_ns: int


class LockStep:
    """Waits for one velocity of each robot that acts."""

    def __init__(self, deadline_s: float) -> None:
        self._deadline_s = deadline_s
        self._told: dict[int, Velocity] = {}
        self.stop()

    def ask(self, robots: Iterable[int], stamp_ns: int, now: float) -> None:
        """Their scans of this stamp are out; of nobody: nothing is waited for.

        Args:
            now: s, by any clock that does not go back.
        """
        self._told.clear()
        self._awaited = frozenset(robots)
        self._stamp_ns, self._due = stamp_ns, now + self._deadline_s

    def stop(self) -> None:
        """Wait for nobody."""
        self.ask((), 0, 0.0)

    def left_s(self, now: float, otherwise: float) -> float:
        """How long to wait for the next message."""
        return max(0.0, self._due - now) if self._awaited else otherwise

    def handle(self, velocity: Velocity | None, now: float) -> Step | Overdue | None:
        """What to do now that a velocity came, or none.

        One that is not waited for is not heard: of a robot that is out, or stamped with another time. One without a stamp is for
        the present one. Of two of the same robot the later one counts.
        """
        if velocity is not None and velocity.robot in self._awaited and velocity.stamp_ns in (0, self._stamp_ns):
            self._told[velocity.robot] = velocity
        if not self._awaited:
            return None
        if len(self._told) == len(self._awaited):
            told = dict(self._told)
            self.stop()
            return Step(told)
        if now < self._due:
            return None
        silent = Overdue(tuple(sorted(self._awaited - self._told.keys())), self._stamp_ns)
        self.stop()
        return silent
