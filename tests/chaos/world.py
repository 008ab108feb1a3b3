"""Simulated time, what happens when, and the rules that must hold. A seed decides everything."""

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
    """The time, what happens when, and what happened last."""

    def __init__(self, seed: int) -> None:
        self.seed, self.random, self.now = seed, random.Random(seed), 0.0
        # Share of messages that get no answer, and of trials that die.
        self.failing = self.random.choice([0.0, 0.002, 0.02])
        self.faults = 0  # that happened
        self.trace: deque[tuple[object, ...]] = deque(maxlen=60)
        self._queue: list[tuple[float, int, Callable[[], None]]] = []
        self._order = itertools.count()

    def at(self, delay: float, call: Callable[[], None]) -> None:
        """Have something happen after a time."""
        heapq.heappush(self._queue, (self.now + delay, next(self._order), call))

    def soon(self, call: Callable[[], None]) -> None:
        """After the way through the network; a later message may overtake."""
        self.at(0.0001 + 0.02 * self.random.random(), call)

    def chance(self, share: float) -> bool:
        """Whether something of that probability goes wrong now."""
        return self.now < CHAOS_S and self.random.random() < share

    def tell(self, *words: object) -> None:
        """Remember what happened."""
        self.trace.append((self.now, *words))

    def fail(self, text: str) -> NoReturn:
        """A rule was broken: the seed, the line that replays it, and what happened last."""
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
    """A program with its own clock, which may jump; it may be stopped for a while (SIGSTOP)."""

    def __init__(self, world: World) -> None:
        self.world = world
        self.ended = False
        self.frozen = False
        self.offset = world.random.uniform(0.0, 1e6)  # of its monotonic clock
        self._held: list[Callable[[], None]] = []

    def clock(self) -> float:
        """The time that it reads."""
        return self.world.now + self.offset

    def handle(self, event: E) -> None:
        """Have it react to an event, now or when it goes on; one that ended does not."""
        if self.frozen:
            self.when_awake(lambda: self.handle(event))
        elif not self.ended:
            self.react(event)

    def react(self, event: E) -> None:
        """Give the state machine an event, and carry out what it says."""
        raise NotImplementedError

    def when_awake(self, call: Callable[[], None]) -> None:
        """Call it now, or when the program goes on."""
        if self.frozen:
            self._held.append(call)
        else:
            call()

    def wake(self) -> None:
        """Go on, with everything that came meanwhile."""
        self.frozen, held, self._held = False, self._held, []
        for call in held:
            call()
