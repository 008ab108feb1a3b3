"""Simulate time and events, and check rules. A seed decides everything."""

import heapq
import itertools
import random
from collections import deque
from collections.abc import Callable
from typing import Generic, NoReturn, TypeVar

E = TypeVar("E")  # what may happen to a program

CHAOS_S = 60.0  # faults begin before
CALM_S = 160.0  # by then the last fault has ended
BOUND_S = 200.0  # after that, a run that is not done has progressed
END_S = 10_000.0  # by then all runs are done
EVENTS = 3000  # in a second; more is a loop without delay


class World:
    """Simulated time, scheduled events, and a log of recent ones."""

    def __init__(self, seed: int) -> None:
        self.seed, self.random, self.now = seed, random.Random(seed), 0.0
        # Share of messages that get no answer, and of trials that die.
        self.failing = self.random.choice([0.0, 0.002, 0.02])
        self.faults = 0  # that happened
        self.trace: deque[tuple[object, ...]] = deque(maxlen=60)
        self._queue: list[tuple[float, int, Callable[[], None]]] = []
        self._order = itertools.count()

    def at(self, delay: float, call: Callable[[], None]) -> None:
        """Schedule a call after a time."""
        heapq.heappush(self._queue, (self.now + delay, next(self._order), call))

    def soon(self, call: Callable[[], None]) -> None:
        """Schedule a call after the network's delay; a later message may overtake."""
        self.at(0.0001 + 0.02 * self.random.random(), call)

    def chance(self, share: float) -> bool:
        """Return whether something of that probability goes wrong now."""
        return self.now < CHAOS_S and self.random.random() < share

    def tell(self, *words: object) -> None:
        """Add a line to the log."""
        self.trace.append((self.now, *words))

    def fail(self, text: str) -> NoReturn:
        """Raise for a broken rule, with the seed, the line that replays it, and recent events."""
        lines = (
            f"{time:9.4f} " + " ".join(str(word)[:150] for word in words)
            for time, *words in self.trace
        )
        raise AssertionError(
            f"make chaos SEED={self.seed}    # {self.now:.3f} s: {text}; what happened last:\n"
            + "\n".join(lines)
        )

    def run(self, until: float, done: Callable[[], bool] = lambda: False) -> None:
        """Let time pass, at most until a time."""
        second, events = 0, 0
        while self._queue and self._queue[0][0] <= until and not done():
            self.now, _, call = heapq.heappop(self._queue)
            call()
            events = events + 1 if second == int(self.now) else 0
            second = int(self.now)
            if events > EVENTS:
                self.fail("a loop without delay")
        if not done():
            self.now = until


class Node(Generic[E]):
    """Simulate a program whose own clock may jump and that may be stopped (SIGSTOP)."""

    def __init__(self, world: World) -> None:
        self.world = world
        self.ended = False
        self.frozen = False
        self.offset = world.random.uniform(0.0, 1e6)  # of its monotonic clock
        self._held: list[Callable[[], None]] = []

    def clock(self) -> float:
        """Return the time on its own clock."""
        return self.world.now + self.offset

    def handle(self, event: E) -> None:
        """Handle an event now or when the program resumes; drop it if the program ended."""
        if self.frozen:
            self.when_awake(lambda: self.handle(event))
        elif not self.ended:
            self.react(event)

    def react(self, event: E) -> None:
        """Give the state machine an event and execute its commands."""
        raise NotImplementedError

    def when_awake(self, call: Callable[[], None]) -> None:
        """Call now, or when the program resumes."""
        if self.frozen:
            self._held.append(call)
        else:
            call()

    def wake(self) -> None:
        """Resume, with everything that came meanwhile."""
        self.frozen, held, self._held = False, self._held, []
        for call in held:
            call()
