"""Arena implemented a second time, naively, from its reference alone.

Robots are objects, and every robot checks every other one.
"""

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from zswarm.kernels.random import Stream
from zswarm.sims.arena import ArenaSettings

F = np.float32
ZERO, HALF, ONE, TWO = F(0), F(0.5), F(1), F(2)
S = F(0.70710678)
RAYS = [
    (ONE, ZERO),
    (S, S),
    (ZERO, ONE),
    (-S, S),
    (-ONE, ZERO),
    (-S, -S),
    (ZERO, -ONE),
    (S, -S),
]


def cut(output: np.float32) -> np.float32:
    return F(0) if np.isnan(output) else F(min(max(output, ZERO), ONE))


class Robot:
    def __init__(
        self, x: np.float32, y: np.float32, heading: tuple[np.float32, np.float32]
    ) -> None:
        self.x, self.y = x, y
        self.h, self.k = heading
        self.carries = False
        self.reading = self.said = ZERO
        self.neighbours: list[Robot] = []

    def framed(self, dx: np.float32, dy: np.float32) -> tuple[np.float32, np.float32]:
        return dx * self.h + dy * self.k, dy * self.h - dx * self.k


class NaiveArena:
    """One trial; ``play`` returns fitness and metrics and records ``observations``."""

    def __init__(self, settings: ArenaSettings, seed: int) -> None:
        self.settings, self.stream = settings, Stream(seed)
        self.task = settings.task
        self.side, self.sight, self.r = (
            F(settings.side),
            F(settings.sight),
            F(settings.radius),
        )
        low, high = self.r, self.side - self.r
        if self.task == "dispersion":
            quarter = (high - low) * HALF * HALF
            low, high = low + quarter, high - quarter
        self.robots = []
        for _ in range(settings.robots):
            x, y = self.draw(low, high), self.draw(low, high)
            self.robots.append(Robot(x, y, self.draw_heading()))
        self.items: list[tuple[np.float32, np.float32]] = []
        if self.task == "consensus":
            self.truth = self.draw(ZERO, ONE)
            noise = F(settings.noise)
            for robot in self.robots:
                robot.reading = self.truth + self.draw(-noise, noise)
                robot.said = cut(robot.reading)
        if self.task == "foraging":
            self.items = [self.draw_item() for _ in range(settings.items)]
        self.found = self.delivered = self.overlaps = 0
        self.measured: list[tuple[np.float32, np.float32]] = []
        self.observations: list[np.ndarray] = []

    def draw(self, low: np.float32, high: np.float32) -> np.float32:
        return low + F(self.stream.integer(2**24)) * F(2**-24) * (high - low)

    def draw_heading(self) -> tuple[np.float32, np.float32]:
        while True:
            h, k = self.draw(-ONE, ONE), self.draw(-ONE, ONE)
            if F(0.01) <= h * h + k * k <= ONE:
                return h / np.sqrt(h * h + k * k), k / np.sqrt(h * h + k * k)

    def draw_item(self) -> tuple[np.float32, np.float32]:
        x = self.draw(F(self.settings.nest), self.side - self.r)
        return x, self.draw(self.r, self.side - self.r)

    def play(self, decide: Callable[[int, np.ndarray], np.ndarray]) -> tuple[float, ...]:
        for number in range(1, self.settings.steps + 1):
            self.meet()
            seen = [self.observe(robot) for robot in self.robots]
            self.observations.append(np.array(seen))
            actions = [
                decide(index, observation) for index, observation in enumerate(seen)
            ]
            if 2 * number > self.settings.steps:
                self.measured.append(self.measure())
            pushes = [self.push(robot) for robot in self.robots]
            for robot, action, push in zip(self.robots, actions, pushes, strict=True):
                self.drive(robot, action, push)
            for robot, action in zip(self.robots, actions, strict=True):
                self.work(robot, action)
        return self.outcome()

    def meet(self) -> None:
        """Let robots meet in the order of cells."""
        s = self.settings
        cells = min(int(0.999 * s.side / s.sight), int(s.robots**0.5))
        cells = 1 if cells < 3 else cells
        per_metre = F(cells / s.side)

        def cell(robot: Robot) -> tuple[int, int]:
            return min(int(robot.y * per_metre), cells - 1), min(
                int(robot.x * per_metre), cells - 1
            )

        # The order within a cell is kept.
        ordered = sorted(self.robots, key=cell)
        for robot in self.robots:
            near = [
                other
                for other in ordered
                if self.square(robot, other) < self.sight * self.sight
            ]
            robot.neighbours = [other for other in near if other is not robot]

    def square(self, robot: Robot, other: Robot) -> np.float32:
        dx, dy = other.x - robot.x, other.y - robot.y
        return dx * dx + dy * dy

    def observe(self, robot: Robot) -> np.ndarray:
        places = [
            robot.framed(other.x - robot.x, other.y - robot.y)
            for other in robot.neighbours
        ]
        mean = [ZERO, ZERO]
        for place in places:
            mean = [total + part for total, part in zip(mean, place, strict=True)]
        share = (ONE / self.sight) / F(max(len(places), 1))
        seen = [ONE - self.reach(robot, ray, places) * (ONE / self.sight) for ray in RAYS]
        seen += [total * share for total in mean]
        if self.task == "foraging":
            seen += [*self.nearest_item(robot), -robot.h, robot.k, F(robot.carries)]
        if self.task == "consensus":
            heard = robot.said
            if robot.neighbours:
                heard = ZERO
                for other in robot.neighbours:
                    heard = heard + other.said
                heard = heard / F(len(robot.neighbours))
            seen += [robot.reading, heard]
        return np.array(seen, np.float32)

    def reach(
        self, robot: Robot, ray: tuple[np.float32, np.float32], places: list
    ) -> np.float32:
        u, v = ray
        ways = [self.sight]
        for part, here in (
            (robot.h * u - robot.k * v, robot.x),
            (robot.k * u + robot.h * v, robot.y),
        ):
            left = self.side - here if part > 0 else here
            ways.append(left / max(abs(part), F(1e-6)))
        for a, b in places:
            m, n = a * u + b * v, b * u - a * v
            q = self.r * self.r - n * n
            if m > 0 and q > 0:
                ways.append(m - np.sqrt(q))
        return min(ways)

    def nearest_item(self, robot: Robot) -> tuple[np.float32, np.float32]:
        best, offset = self.sight * self.sight, (ZERO, ZERO)
        for x, y in self.items:
            dx, dy = x - robot.x, y - robot.y
            if dx * dx + dy * dy < best:
                best, offset = dx * dx + dy * dy, (dx, dy)
        way = max(np.sqrt(best), self.r)
        ahead, aside = robot.framed(*offset)
        return ahead / way, aside / way

    def measure(self) -> tuple[np.float32, np.float32]:
        def mean(numbers: list) -> np.float32:
            total = ZERO
            for number in numbers:
                total = total + F(number)
            return total / F(len(numbers))

        near = mean([len(robot.neighbours) for robot in self.robots])
        match self.task:
            case "aggregation":
                x, y = (
                    mean([robot.x for robot in self.robots]),
                    mean([robot.y for robot in self.robots]),
                )
                offsets = [(robot.x - x, robot.y - y) for robot in self.robots]
                return mean([np.sqrt(dx * dx + dy * dy) for dx, dy in offsets]), near
            case "dispersion":
                squares = [
                    [self.square(robot, other) for other in robot.neighbours]
                    for robot in self.robots
                ]
                return mean(
                    [
                        np.sqrt(min(some, default=self.sight * self.sight))
                        for some in squares
                    ]
                ), near
            case "consensus":
                said = mean([robot.said for robot in self.robots])
                errors = [abs(robot.said - self.truth) for robot in self.robots]
                return mean(errors), mean(
                    [abs(robot.said - said) for robot in self.robots]
                )
        return ZERO, ZERO

    def push(self, robot: Robot) -> tuple[np.float32, np.float32]:
        push_x = push_y = ZERO
        both = self.r + self.r
        for other in robot.neighbours:
            square = self.square(robot, other)
            if square < both * both:
                self.overlaps += 1
                d = np.sqrt(square)
                share = HALF * (both - d) / max(d, F(1e-6))
                push_x, push_y = (
                    push_x - share * (other.x - robot.x),
                    push_y - share * (other.y - robot.y),
                )
        return push_x, push_y

    def drive(
        self, robot: Robot, action: np.ndarray, push: tuple[np.float32, np.float32]
    ) -> None:
        w = self.settings.speed * self.settings.step_s / 2
        left, right = (TWO * cut(output) - ONE for output in action[:2])
        t = (right - left) * F(w / (2 * self.settings.radius))
        cos, sin = (ONE - t * t) * (ONE / (ONE + t * t)), (t + t) * (ONE / (ONE + t * t))
        h, k = cos * robot.h - sin * robot.k, cos * robot.k + sin * robot.h
        scale = F(1.5) - HALF * (h * h + k * k)
        robot.h, robot.k = h * scale, k * scale
        forward = (left + right) * F(w)
        x, y = (
            robot.x + forward * robot.h + push[0],
            robot.y + forward * robot.k + push[1],
        )
        robot.x, robot.y = (min(max(part, self.r), self.side - self.r) for part in (x, y))

    def work(self, robot: Robot, action: np.ndarray) -> None:
        if self.task == "consensus":
            robot.said = cut(action[2])
        if self.task != "foraging":
            return
        if robot.carries:
            if robot.x < F(self.settings.nest):
                robot.carries = False
                self.delivered += 1
            return
        for index, (x, y) in enumerate(self.items):
            dx, dy = x - robot.x, y - robot.y
            if dx * dx + dy * dy < self.r * self.r:
                robot.carries = True
                self.found += 1
                self.items[index] = self.draw_item()
                return

    def outcome(self) -> tuple[float, ...]:
        first, second = (
            sum(map(float, column)) / len(column)
            for column in zip(*self.measured, strict=True)
        )
        contacts = self.overlaps / 2 / self.settings.steps
        match self.task:
            case "aggregation":
                return 1 - first / (0.3826 * float(self.side)), first, second, contacts
            case "dispersion":
                return first / float(self.sight), first, second, contacts
            case "foraging":
                return (
                    (self.delivered + self.found) / 2,
                    self.delivered,
                    self.found,
                    contacts,
                )
        return 1 - 4 * first, first, second, contacts


def travelled(places: list[tuple[float, float]]) -> float:
    """Return the longest distance between two successive positions."""
    return max(np.hypot(b[0] - a[0], b[1] - a[1]) for a, b in pairwise(places))
