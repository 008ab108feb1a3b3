"""The room: robots and exits on a plane, moved by plain arithmetic."""

import math
import random

# From the east counter-clockwise.
AROUND = [(1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1)]
APART_M = 0.2  # robots are discs


class Room:
    """Walls, exits and the positions of the robots."""

    def __init__(self, parameters):
        self.half = parameters["half_width"]
        self.exits = [
            parameters[f"exit_{number}"] for number in range(parameters["exits"])
        ]
        self.step_m, self.epsilon = parameters["step_size"], parameters["epsilon"]
        draw, (x, y) = random.Random(parameters["seed"]), parameters["start"]  # noqa: S311  the trial's seed
        self.places = []
        while len(self.places) < parameters["numAgents"]:
            place = x + 3.0 * (draw.random() - 0.5), y + 2.0 * (draw.random() - 0.5)
            if self.free(place, -1):
                self.places.append(place)
        self.inside = [True] * len(self.places)

    def free(self, place, robot):
        """Return whether a robot fits there."""
        if max(abs(place[0]), abs(place[1])) > self.half:
            return False
        others = (
            other
            for number, other in enumerate(self.places)
            if number != robot and (robot < 0 or self.inside[number])
        )
        return all(
            (place[0] - x) * (place[0] - x) + (place[1] - y) * (place[1] - y)
            >= APART_M * APART_M
            for x, y in others
        )

    def nearest(self, robot):
        """Return distance and position of the exit nearest to a robot."""
        x, y = self.places[robot]
        return min(
            (math.sqrt((x - to_x) * (x - to_x) + (y - to_y) * (y - to_y)), (to_x, to_y))
            for to_x, to_y in self.exits
        )

    def observe(self, robot):
        """Return the ten inputs of a robot's controller."""
        x, y = self.places[robot]
        _, (to_x, to_y) = self.nearest(robot)
        around = [
            (x + self.step_m * east, y + self.step_m * north) for east, north in AROUND
        ]
        return [
            to_x - x,
            to_y - y,
            *(1.0 if self.free(place, robot) else 0.0 for place in around),
        ]

    def move(self, robot, east, north):
        """Move a robot by steps clipped to -1 .. 1. At an exit it leaves."""
        x, y = self.places[robot]
        place = (
            x + self.step_m * min(1.0, max(-1.0, east)),
            y + self.step_m * min(1.0, max(-1.0, north)),
        )
        if self.free(place, robot):
            self.places[robot] = place
        self.inside[robot] = self.nearest(robot)[0] >= self.epsilon
