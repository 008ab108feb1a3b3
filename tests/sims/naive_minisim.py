"""Minisim implemented a second time, naively, from its reference alone.

Positions are pairs, and robots are objects.
"""

from collections.abc import Callable

import numpy as np

from zswarm.kernels.random import Stream
from zswarm.sims.minisim import MinisimSettings

Place = tuple[int, int]


class Robot:
    def __init__(self, start: Place) -> None:
        self.start = start
        self.place = start

    @property
    def at_home(self) -> bool:
        return self.place[0] == 0


class NaiveMinisim:
    """One trial; ``play`` returns fitness, captures, steals and times tagged."""

    def __init__(self, settings: MinisimSettings, seed: int) -> None:
        stream = Stream(seed)
        self.settings = settings
        self.size = max(settings.width, settings.height)
        column = settings.width - 1 - stream.integer(settings.width // 2)
        self.stand = (column, stream.integer(settings.height))
        self.robots = [
            Robot((0, stream.integer(settings.height))) for _ in range(settings.robots)
        ]
        self.defenders = [self.stand] * settings.defenders
        self.carrier: Robot | None = None
        self.counts = {"captures": 0, "steals": 0, "tagged": 0}
        self.distances_to_stand: list[int] = []  # since the last capture
        self.carrier_columns: list[int] = []

    def play(
        self, decide: Callable[[int, np.ndarray], np.ndarray]
    ) -> tuple[float, int, int, int]:
        for number in range(1, self.settings.steps + 1):
            seen = [self.observe(robot) for robot in self.robots]
            actions = [
                decide(index, observation) for index, observation in enumerate(seen)
            ]
            for robot, action in zip(self.robots, actions, strict=True):
                self.move(robot, action)
            self.take_and_capture()
            if not (self.settings.rest and number % self.settings.rest == 0):
                self.chase()
            self.tag()
        there = 1 - min(self.distances_to_stand, default=self.size) / self.size
        back = 1 - min(self.carrier_columns, default=self.stand[0]) / self.stand[0]
        return (self.counts["captures"] + (there + back) / 2, *self.counts.values())

    def observe(self, robot: Robot) -> np.ndarray:
        one, size, carrying = np.float32(1), np.float32(self.size), robot is self.carrier
        goal = (0, robot.place[1]) if carrying else self.stand
        dx, dy = offset(robot.place, goal)
        away = np.float32(king(robot.place, goal))
        return np.array(
            [
                np.float32(dx) / max(one, away),
                np.float32(dy) / max(one, away),
                one - away / size,
                *self.sense(robot.place, self.defenders),
                *self.sense(
                    robot.place,
                    [other.place for other in self.robots if other is not robot],
                ),
                carrying,
                self.carrier is not None and not carrying,
            ],
            np.float32,
        )

    def sense(self, here: Place, places: list[Place]) -> tuple[np.float32, np.float32]:
        sight = self.settings.robot_sight
        near = min(places, key=lambda there: king(here, there), default=here)
        away = king(here, near)
        if away == 0 or away >= sight:
            return np.float32(0), np.float32(0)
        nearness = np.float32(sight - away) / np.float32(sight)
        dx, dy = (
            np.float32(part) / np.float32(away) * nearness for part in offset(here, near)
        )
        return dx, dy

    def move(self, robot: Robot, action: np.ndarray) -> None:
        def along(position: int, output: np.float32, length: int) -> int:
            wanted = position + (int(output > 0.75) - int(output < 0.25))
            return wanted if wanted in range(length) else position

        x, y = robot.place
        robot.place = (
            along(x, action[0], self.settings.width),
            along(y, action[1], self.settings.height),
        )

    def take_and_capture(self) -> None:
        self.distances_to_stand += [
            king(robot.place, self.stand) for robot in self.robots
        ]
        if self.carrier is None:
            self.carrier = next(
                (robot for robot in self.robots if robot.place == self.stand), None
            )
            self.counts["steals"] += self.carrier is not None
        if self.carrier is not None:
            self.carrier_columns.append(self.carrier.place[0])
            if self.carrier.at_home:
                self.counts["captures"] += 1
                self.carrier, self.distances_to_stand, self.carrier_columns = None, [], []

    def chase(self) -> None:
        chosen: set[Robot] = set()
        for index, here in enumerate(self.defenders):
            prey = [
                robot
                for robot in self.robots
                if not robot.at_home and robot not in chosen
            ]
            prey = [
                robot
                for robot in prey
                if king(here, robot.place) <= self.settings.defender_sight
            ]
            target = self.stand
            if prey:
                nearest = min(prey, key=lambda robot: king(here, robot.place))
                chosen.add(nearest)
                target = nearest.place
            dx, dy = (int(np.sign(part)) for part in offset(here, target))
            self.defenders[index] = here[0] + dx, here[1] + dy

    def tag(self) -> None:
        for robot in self.robots:
            within_reach = any(
                king(robot.place, there) <= self.settings.reach
                for there in self.defenders
            )
            if within_reach and not robot.at_home:
                robot.place = robot.start
                self.counts["tagged"] += 1
                if robot is self.carrier:
                    self.carrier = None


def offset(here: Place, there: Place) -> Place:
    return there[0] - here[0], there[1] - here[1]


def king(here: Place, there: Place) -> int:
    return max(abs(part) for part in offset(here, there))
