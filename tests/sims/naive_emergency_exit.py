"""Emergency exit implemented a second time, naively, from its reference alone.

Positions are pairs, and occupied cells form a set.
"""

from collections.abc import Callable, Iterator
from math import dist

Place = tuple[int, int]

AROUND = [(0, -1), (1, -1), (1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1)]


def java_random(seed: int) -> Iterator[int]:
    """Yield the upper 31 bits of Java's standard generator."""
    state = seed % 2**48 ^ 0x5DEECE66D
    while True:
        state = (state * 0x5DEECE66D + 11) % 2**48
        yield state // 2**17


def java_below(bound: int, bits: Iterator[int]) -> int:
    """Draw uniformly below a bound, as ``java.util.Random.nextInt`` is documented."""
    if bound.bit_count() == 1:
        return bound * next(bits) // 2**31
    while True:
        drawn = next(bits)
        if drawn - drawn % bound + bound <= 2**31:
            return drawn % bound


class NaiveEmergencyExit:
    """One trial in a room; ``play`` returns fitness, escaped agents and rounds."""

    def __init__(
        self, size: Place, agents: list[Place], exits: list[Place], blockades: list[Place]
    ) -> None:
        self.floor = {(x, y) for x in range(size[0]) for y in range(size[1])} - set(
            blockades
        )
        self.agents = dict(enumerate(agents))
        self.exits = exits

    @classmethod
    def random(
        cls, size: Place, agents: int, exits: int, blockades: int, seed: int
    ) -> "NaiveEmergencyExit":
        """Place everything on free cells drawn by Java's generator.

        As in FREVO, y is drawn from the width, too.
        """
        bits = java_random(seed)
        things: list[Place] = []
        while len(things) < agents + exits + blockades:
            place = java_below(size[0], bits), java_below(size[0], bits)
            if place not in things:
                things.append(place)
        return cls(
            size,
            things[:agents],
            things[agents : agents + exits],
            things[agents + exits :],
        )

    def play(
        self, steps: int, decide: Callable[[int, list[float]], list[float]]
    ) -> tuple[float, float, float]:
        everybody_out = [round_ for round_ in range(steps) if self.play_round(decide)]
        first = min(everybody_out, default=steps)
        distances = 0.0
        for agent in sorted(self.agents):
            distances += dist(self.agents[agent], self.nearest_exit(agent))
        escaped = sum(map(self.is_out, self.agents))
        return (steps - first) / steps - distances, escaped, min(first + 1, steps)

    def play_round(self, decide: Callable[[int, list[float]], list[float]]) -> bool:
        """Let the agents act one after another; return whether all are out."""
        for agent in sorted(self.agents):
            if not self.is_out(agent):
                vx, vy = map(velocity, decide(agent, self.observe(agent)))
                x, y = self.agents[agent]
                if (x + vx, y + vy) in self.free():
                    self.agents[agent] = x + vx, y + vy
        return all(map(self.is_out, self.agents))

    def observe(self, agent: int) -> list[float]:
        x, y = self.agents[agent]
        to_x, to_y = self.nearest_exit(agent)
        free = self.free()
        return [
            to_x - x,
            to_y - y,
            *(float((x + dx, y + dy) in free) for dx, dy in AROUND),
        ]

    def nearest_exit(self, agent: int) -> Place:
        x, y = self.agents[agent]
        return min(
            self.exits, key=lambda there: (there[0] - x) ** 2 + (there[1] - y) ** 2
        )

    def is_out(self, agent: int) -> bool:
        return self.agents[agent] in self.exits

    def free(self) -> set[Place]:
        return self.floor - {
            self.agents[agent] for agent in self.agents if not self.is_out(agent)
        }


def velocity(output: float) -> int:
    for limit, cells in ((-0.25, 0), (0.25, -1), (0.75, 0), (1.25, 1)):
        if output < limit:
            return cells
    return 0
