"""Minisim's game of two teams implemented a second time, naively, from its reference alone.

Robots are objects. All positions use the first team's frame and are converted for the other team.
"""

from collections.abc import Callable

import numpy as np

from tests.sims.naive_minisim import Place, king, offset
from zswarm.kernels.random import Stream
from zswarm.sims.minisim import MinisimSettings


class Robot:
    def __init__(self, team: "Team", start: Place) -> None:
        self.team, self.start, self.place = team, start, start

    @property
    def intrudes(self) -> bool:
        return 2 * self.team.view(self.place)[0] > self.team.settings.width - 1


class Team:
    """A team: ``stand`` is that of its own flag; ``thief`` is the robot that carries it."""

    def __init__(self, settings: MinisimSettings, far: bool) -> None:
        self.settings, self.far = settings, far
        self.robots: list[Robot] = []
        self.thief: Robot | None = None
        self.captures = self.steals = self.tagged = 0
        self.distances: list[int] = []  # to the other's stand, since the last capture
        self.columns: list[int] = []

    def view(self, place: Place) -> Place:
        """Convert a place of the field to this team's frame, and back."""
        return (
            (self.settings.width - 1 - place[0], self.settings.height - 1 - place[1])
            if self.far
            else place
        )


class NaiveDuel:
    """One trial; ``play`` returns both teams' fitness, then captures, steals and times tagged."""

    def __init__(self, settings: MinisimSettings, seed: int) -> None:
        stream = Stream(seed)
        self.settings, self.size = settings, max(settings.width, settings.height)
        self.teams = [Team(settings, far=False), Team(settings, far=True)]
        seen = (
            settings.width - 1 - stream.integer(settings.width // 2),
            stream.integer(settings.height),
        )
        rows = [stream.integer(settings.height) for _ in range(settings.robots)]
        self.goal_column = seen[0]
        for team, other in zip(self.teams, self.teams[::-1], strict=True):
            other.stand = team.view(seen)
            team.robots = [Robot(team, team.view((0, row))) for row in rows]
        self.robots = [robot for team in self.teams for robot in team.robots]

    def play(self, decide: Callable[[int, np.ndarray], np.ndarray]) -> tuple[float, ...]:
        for _ in range(self.settings.steps):
            seen = [self.observe(robot) for robot in self.robots]
            for robot, action in zip(
                self.robots,
                [decide(index, one) for index, one in enumerate(seen)],
                strict=True,
            ):
                self.move(robot, action)
            for team in self.teams:
                self.take_and_capture(team, self.other(team))
            self.tag()
        fitness = []
        for team in self.teams:
            there = 1 - min(team.distances, default=self.size) / self.size
            back = 1 - min(team.columns, default=self.goal_column) / self.goal_column
            fitness.append(team.captures + (there + back) / 2)
        return (
            *fitness,
            *(
                sum(getattr(team, name) for team in self.teams)
                for name in ("captures", "steals", "tagged")
            ),
        )

    def other(self, team: Team) -> Team:
        return self.teams[1 - self.teams.index(team)]

    def observe(self, robot: Robot) -> np.ndarray:
        team, other = robot.team, self.other(robot.team)
        here = team.view(robot.place)
        carrying = other.thief is robot
        goal = (0, here[1]) if carrying else team.view(other.stand)
        flag = team.view(team.thief.place if team.thief else team.stand)
        return np.array(
            [
                *self.bearing(here, goal),
                *self.arrow(here, [team.view(one.place) for one in other.robots]),
                *self.arrow(
                    here,
                    [team.view(one.place) for one in team.robots if one is not robot],
                ),
                carrying,
                other.thief is not None and not carrying,
                *self.bearing(here, flag),
                team.thief is not None,
                robot.intrudes,
            ],
            np.float32,
        )

    def bearing(self, here: Place, there: Place) -> list[np.float32]:
        away = np.float32(king(here, there))
        dx, dy = offset(here, there)
        one = np.float32(1)
        return [
            np.float32(dx) / max(one, away),
            np.float32(dy) / max(one, away),
            one - away / np.float32(self.size),
        ]

    def arrow(self, here: Place, places: list[Place]) -> tuple[np.float32, np.float32]:
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
        place = list(robot.team.view(robot.place))
        for axis, length in enumerate((self.settings.width, self.settings.height)):
            wanted = place[axis] + (int(action[axis] > 0.75) - int(action[axis] < 0.25))
            place[axis] = wanted if wanted in range(length) else place[axis]
        robot.place = robot.team.view((place[0], place[1]))

    def take_and_capture(self, team: Team, other: Team) -> None:
        team.distances += [king(robot.place, other.stand) for robot in team.robots]
        if other.thief is None:
            other.thief = next(
                (robot for robot in team.robots if robot.place == other.stand), None
            )
            team.steals += other.thief is not None
        if other.thief is not None:
            team.columns.append(team.view(other.thief.place)[0])
            if team.columns[-1] == 0:
                team.captures += 1
                other.thief, team.distances, team.columns = None, [], []

    def tag(self) -> None:
        tagged = set()
        for team in self.teams:
            for intruder in (robot for robot in team.robots if robot.intrudes):
                for guard in (
                    robot for robot in self.other(team).robots if not robot.intrudes
                ):
                    if king(intruder.place, guard.place) <= self.settings.reach:
                        tagged |= {intruder, guard}
        for robot in tagged:
            robot.team.tagged += robot.intrudes
        for robot in tagged:
            robot.place = robot.start
            if self.other(robot.team).thief is robot:
                self.other(robot.team).thief = None
