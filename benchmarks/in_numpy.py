"""Play arena aggregation in numpy float32: a batch of candidates at once.

Every number of a robot is a row of an array, with a column for each robot of each candidate. Pairs
of neighbours are listed in each step, and rays computed for these alone. Sums run in other orders
than zswarm's, so the last bits differ.
"""

from typing import Any

import numpy as np

from zswarm.kernels.portable import T1, T2, T3, T4
from zswarm.kernels.random import Stream
from zswarm.sims.arena_world import LANES, RAYS, TINY, ArenaWorld

INPUTS, NEURONS, HEADER = 10, 8, 4
# The first four rays, x and then y in a robot's frame; the others look the opposite way.
RAY_X, RAY_Y = RAYS[: LANES // 2, None], RAYS[LANES : LANES + LANES // 2, None]
FAR = np.float32(np.inf)
BLOCK = 1 << 17  # pairs that are measured at once: they stay in the processor's cache


class Arena:
    """Play trials of one simulator together, each with its own candidate."""

    def __init__(
        self,
        simulator: Any,
        network: Any,
        genomes: list[bytes],
        participants: np.ndarray,
        seeds: np.ndarray,
    ) -> None:
        self.steps, self.world = simulator.settings.steps, simulator.world
        self.shape = candidates, robots = len(seeds), simulator.settings.robots
        rows = network.parameters(genomes)[participants[:, 0]]
        weights = rows[:, HEADER:].reshape(candidates, INPUTS + NEURONS + 1, NEURONS)
        self.weights = np.ascontiguousarray(weights.transpose(0, 2, 1))
        starts = [start(Stream(seed), robots, self.world) for seed in seeds.tolist()]
        # x, y, heading x, heading y.
        self.starts = np.array(starts, np.float32).transpose(2, 0, 1)
        together = max(1, BLOCK // robots**2)
        self._blocks = [
            slice(first, first + together) for first in range(0, candidates, together)
        ]
        self._dx, self._dy, self._square, self._part = (
            np.empty((together, robots, robots), np.float32) for _ in range(4)
        )

    def play(self) -> tuple[np.ndarray, np.ndarray]:
        """Return fitness (trials,) and metrics (trials, 3)."""
        candidates, robots = self.shape
        self.x, self.y, self.heading_x, self.heading_y = self.starts.reshape(4, -1).copy()
        # What the network hears: what a robot observes, what its neurons said before, and 1 for the
        # bias.
        self.heard = np.zeros((INPUTS + NEURONS + 1, candidates * robots), np.float32)
        self.heard[-1] = 1
        heard = self.heard.reshape(-1, candidates, robots).transpose(1, 0, 2)
        spread, near_by, contacts = np.zeros(candidates), np.zeros(candidates), 0.0
        for step in range(1, self.steps + 1):
            neighbours, overlaps, push_x, push_y = self._look()
            contacts = contacts + overlaps
            outputs = tanh(np.matmul(self.weights, heard))
            self.heard[INPUTS:-1] = outputs.transpose(1, 0, 2).reshape(NEURONS, -1)
            if 2 * step > self.steps:
                x, y = self.x.reshape(self.shape), self.y.reshape(self.shape)
                dx, dy = (
                    x - x.mean(axis=1, keepdims=True),
                    y - y.mean(axis=1, keepdims=True),
                )
                spread += np.sqrt(dx * dx + dy * dy).mean(axis=1)
                near_by += neighbours.reshape(self.shape).mean(axis=1)
            self._drive(self.heard[-3], self.heard[-2], push_x, push_y)
        measured = self.steps - self.steps // 2
        metrics = np.stack(
            [spread / measured, near_by / measured, contacts / 2 / self.steps], axis=1
        )
        return 1 - metrics[:, 0] / (0.3826 * float(self.world.side)), metrics

    def _look(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Write the observations; return neighbours, overlaps per candidate, and pushes."""
        candidates, robots = self.shape
        sight, radius = self.world.sight, self.world.radius
        touch, columns = radius + radius, candidates * robots
        found = zip(*(self._neighbours(block) for block in self._blocks), strict=True)
        robot, dx, dy, square = (
            np.concatenate(parts) if len(parts) > 1 else parts[0] for parts in found
        )
        heading_x, heading_y = self.heading_x.take(robot), self.heading_y.take(robot)
        ahead, aside = dx * heading_x + dy * heading_y, dy * heading_x - dx * heading_y

        reach = np.minimum(self._to_walls(), sight)
        off = aside * RAY_X - ahead * RAY_Y
        chord = radius * radius - off * off
        met = np.flatnonzero(chord > 0)
        line, pair = np.divmod(met, len(robot))
        along = ahead.take(pair) * RAY_X.take(line) + aside.take(pair) * RAY_Y.take(line)
        ray = line + (along < 0) * (LANES // 2)
        np.minimum.at(
            reach.reshape(-1),
            ray * columns + robot.take(pair),
            np.abs(along) - np.sqrt(chord.take(met)),
        )
        neighbours = np.bincount(robot, minlength=columns)
        scale = sight * np.maximum(neighbours, 1)
        self.heard[:LANES] = 1 - reach / sight
        self.heard[LANES] = np.bincount(robot, ahead, columns) / scale
        self.heard[LANES + 1] = np.bincount(robot, aside, columns) / scale

        touching = np.flatnonzero(square < touch * touch)
        robot, distance = robot[touching], np.sqrt(square[touching])
        share = np.float32(0.5) * (touch - distance) / np.maximum(distance, TINY)
        push_x, push_y = (
            np.bincount(robot, -share * way[touching], columns).astype(np.float32)
            for way in (dx, dy)
        )
        return (
            neighbours,
            np.bincount(robot // robots, minlength=candidates),
            push_x,
            push_y,
        )

    def _neighbours(
        self, block: slice
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return pairs that see each other: column, x and y to the other, squared distance."""
        x, y = self.x.reshape(self.shape)[block], self.y.reshape(self.shape)[block]
        count, robots = x.shape
        dx, dy, square, part = (
            self._dx[:count],
            self._dy[:count],
            self._square[:count],
            self._part[:count],
        )
        np.subtract(x[:, None, :], x[:, :, None], out=dx)
        np.subtract(y[:, None, :], y[:, :, None], out=dy)
        np.multiply(dx, dx, out=square)
        np.multiply(dy, dy, out=part)
        np.add(square, part, out=square)
        # No robot is its own neighbour.
        square.reshape(count, -1)[:, :: robots + 1] = FAR
        pairs = np.flatnonzero(square < self.world.sight * self.world.sight)
        return (
            block.start * robots + pairs // robots,
            dx.take(pairs),
            dy.take(pairs),
            square.take(pairs),
        )

    def _to_walls(self) -> np.ndarray:
        """Return the distances to a wall along the eight rays."""
        half = self.world.side * np.float32(0.5)
        reaches = []
        for place, way in (
            (self.x, self.heading_x * RAY_X - self.heading_y * RAY_Y),
            (self.y, self.heading_y * RAY_X + self.heading_x * RAY_Y),
        ):
            per_size, beyond = (
                1 / np.maximum(np.abs(way), TINY),
                np.sign(way) * (place - half),
            )
            reaches.append(
                np.concatenate([(half - beyond) * per_size, (half + beyond) * per_size])
            )
        return np.minimum(*reaches)

    def _drive(
        self, left: np.ndarray, right: np.ndarray, push_x: np.ndarray, push_y: np.ndarray
    ) -> None:
        """Turn and move all robots."""
        low, high = self.world.radius, self.world.side - self.world.radius
        left, right = 2 * cut(left, 0, 1) - 1, 2 * cut(right, 0, 1) - 1
        t, forward = (
            (right - left) * self.world.half_turn,
            (left + right) * self.world.half_stride,
        )
        per_square = 1 / (1 + t * t)
        cosine, sine = (1 - t * t) * per_square, (t + t) * per_square
        x, y = (
            cosine * self.heading_x - sine * self.heading_y,
            cosine * self.heading_y + sine * self.heading_x,
        )
        per_length = np.float32(1.5) - np.float32(0.5) * (x * x + y * y)
        self.heading_x, self.heading_y = x * per_length, y * per_length
        self.x = cut(self.x + forward * self.heading_x + push_x, low, high)
        self.y = cut(self.y + forward * self.heading_y + push_y, low, high)


def start(
    stream: Stream, robots: int, world: ArenaWorld
) -> list[tuple[float, float, float, float]]:
    """Return the positions and headings of robots at the start."""

    def draw(low: float, high: float) -> float:
        return low + stream.integer(1 << 24) * 2.0**-24 * (high - low)

    low, high = float(world.radius), float(world.side - world.radius)
    places = []
    for _ in range(robots):
        x, y, square = draw(low, high), draw(low, high), 0.0
        while not 0.01 <= square <= 1:
            heading_x, heading_y = draw(-1, 1), draw(-1, 1)
            square = heading_x**2 + heading_y**2
        places.append((x, y, heading_x / square**0.5, heading_y / square**0.5))
    return places


def cut(x: np.ndarray, low: float, high: float) -> np.ndarray:
    """Clip like ``np.clip``, but faster."""
    return np.minimum(np.maximum(x, low), high)


def tanh(x: np.ndarray) -> np.ndarray:
    """Return zswarm's tanh, a rational function."""
    size = np.minimum(np.abs(x), np.float32(20))
    root = 1 + size * (T1 + size * (T2 + size * (T3 + size * T4)))
    root *= root
    root *= root
    return np.copysign(1 - 2 / (root + 1), x)
