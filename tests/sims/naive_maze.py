"""The maze implemented a second time, naively, from its reference alone.

Walls are arbitrary line segments, and sines come from the C library.
"""

import math

import numpy as np

Point = tuple[float, float]
Wall = tuple[Point, Point]


class Maze:
    """One trial; walls are those inside, the rim is added."""

    def __init__(
        self, size: Point, inside: list[Wall], start: Point, goal: Point, steps: int
    ) -> None:
        width, height = size
        corners = [(0.0, 0.0), (width, 0.0), (width, height), (0.0, height)]
        self.walls = inside + [(corners[i], corners[(i + 1) % 4]) for i in range(4)]
        self.longest, self.goal, self.steps, self.left = (
            math.hypot(width, height),
            goal,
            steps,
            steps,
        )
        self.place, self.heading, self.speed, self.turning = start, 0.0, 0.0, 0.0

    def observe(self) -> list[float]:
        finders = [
            self.free(self.heading + aside) for aside in (-90, -45, 0, 45, 90, 180)
        ]
        goal = math.degrees(
            math.atan2(self.goal[1] - self.place[1], self.goal[0] - self.place[0])
        )
        aside = (goal - self.heading + 45) % 360
        return finders + [
            1.0 if 90 * quarter <= aside < 90 * (quarter + 1) else 0.0
            for quarter in range(4)
        ]

    def free(self, direction: float) -> float:
        """Return the distance to the nearest wall in a direction, at most 1, by Cramer's rule."""
        dx, dy = math.cos(math.radians(direction)), math.sin(math.radians(direction))
        nearest = 1.0
        for (ax, ay), (bx, by) in self.walls:
            ex, ey = bx - ax, by - ay
            rx, ry = ax - self.place[0], ay - self.place[1]
            determinant = ex * dy - ey * dx
            if abs(determinant) > 1e-12:
                t, s = (
                    (ex * ry - ey * rx) / determinant,
                    (dx * ry - dy * rx) / determinant,
                )
                if t >= 0 and 0 <= s <= 1:
                    nearest = min(nearest, t)
        return nearest

    def is_free(self, place: Point) -> bool:
        for (ax, ay), (bx, by) in self.walls:
            ex, ey = bx - ax, by - ay
            along = ((place[0] - ax) * ex + (place[1] - ay) * ey) / (ex * ex + ey * ey)
            along = min(max(along, 0.0), 1.0)
            if math.dist(place, (ax + along * ex, ay + along * ey)) < 0.08:
                return False
        return True

    def act(self, action: np.ndarray) -> bool:
        """Drive one step; return whether the trial continues."""
        turn, drive = (float(output) - 0.5 for output in action)
        self.turning = max(-3.0, min(3.0, self.turning + turn))
        self.speed = max(-0.03, min(0.03, self.speed + 0.01 * drive))
        self.heading += self.turning
        towards = math.radians(self.heading)
        there = (
            self.place[0] + self.speed * math.cos(towards),
            self.place[1] + self.speed * math.sin(towards),
        )
        if self.is_free(there):
            self.place = there
        self.left -= 1
        return self.left > 0 and not self.is_there()

    def is_there(self) -> bool:
        return math.dist(self.place, self.goal) < 0.05

    def fitness(self) -> float:
        return (
            1 + self.left / self.steps
            if self.is_there()
            else 1 - math.dist(self.place, self.goal) / self.longest
        )
