"""Simulate e-puck robots on the field's published missions."""

from typing import Annotated, Literal

import numpy as np

from zswarm.config.meta import PartSettings, about, only_with, within
from zswarm.kernels.lanes import LANES
from zswarm.sims.epuck import generated, missions, trial
from zswarm.sims.epuck.arenas import wall_rows
from zswarm.sims.epuck.contacts import CONTACT_COLUMNS, LINK_COLUMNS
from zswarm.sims.epuck.grey_readings import GREYS
from zswarm.sims.epuck.impulses import BODY_COLUMNS
from zswarm.sims.epuck.missions import MISSIONS
from zswarm.sims.epuck.reference_models import SENSOR_NAMES
from zswarm.sims.epuck.world import (
    ANGLE,
    BLACK,
    CARRIES,
    CHANGE_ROWS,
    COUNTS,
    DISC,
    FAR_AWAY,
    IMPULSE_COLUMNS,
    LISTS,
    MEETING_ROWS,
    MEMORY_ROWS,
    NOISY,
    RADIUS,
    ROBOT_ROWS,
    STEP_S,
    EpuckWorld,
    X,
    Y,
)
from zswarm.sims.simulator import Body, Frame, Line, Rectangle
from zswarm.sims.trial import Teams, play_many, problem

MODELS = {"1.1": 1, "1.2": 2, "1.2-machine": 3}
# Noise of wheels, proximity, light and ground, and the probability that a message is lost.
REALITIES = {
    "design": (0.05, 0.05, 0.05, 0.05, 0.85),
    "pseudo": (0.15, 0.05, 0.9, 0.05, 0.9),
    "exact": (0.0, 0.0, 0.0, 0.0, 0.0),
}


class EpuckSettings(PartSettings, frozen=True):
    """Settings of ``[problem.settings]``."""

    mission: Annotated[
        Literal[
            "aggregation",
            "foraging",
            "grid-exploration",
            "aac",
            "sca",
            "spc",
            "lcn",
            "cfa",
            "cfa-corrected",
            "homing",
            "generated",
        ],
        about("mission of the robots"),
    ] = "aggregation"
    reference_model: Annotated[
        Literal["1.1", "1.2", "1.2-machine"],
        about("what controllers see: 24 inputs, 14, or 15 for machines"),
    ] = "1.2"
    reality: Annotated[
        Literal["design", "pseudo", "exact"],
        about("noise: that of design, of the published pseudo-reality, or none"),
    ] = "design"
    robots: Annotated[int, within(0, 100, "robots; 0: as many as the mission has")] = 0
    seconds: Annotated[
        float,
        within(0, 100_000, "s, duration of a trial; 0: that of the published mission"),
    ] = 0.0
    mission_seed: Annotated[
        int,
        within(0, 2**63 - 1, "seed from which a generated mission is drawn"),
        only_with(mission="generated"),
    ] = 0


class Epuck(Teams):
    """Simulate e-puck robots in a dodecagonal arena, on the published missions of the field.

    Robots, physics, sensors, noise and missions are those of ARGoS3 with the e-puck plug-in;
    docs/epuck.md has the equations and compares controllers in both.

    Observation: reference model 1.2: 0-3: proximity to the front left, back left, back right and
        front right; 4-7: light, likewise; 8: ground, 0 black, 1 white, in between grey; 9: 1 - 2 /
        (1 + e^n) for n messages heard; 10-13: attraction to neighbours, as 0-3. Model 1.1: 0-7:
        proximity readings, 8-15: light readings, 16-18: ground, 19-23: as 9-13. Model
        1.2-machine: as 1.2; but 8: 0, 1, or 1/2 for grey; 9: n; 14: random, uniform in 0..1.
    Action: 0-1: left and right wheel, 0 is -12 cm/s and 1 is 12 cm/s.
    Turns: all robots at once, ten a second. A command takes effect in the next step.
    Start: places uniform in the disc of radius 1.2 m, headings uniform; docs/epuck.md has more.
    End: after the duration of the mission.
    Fitness: aggregation, aac: robots in the black spot, summed over steps. foraging: deliveries.
        grid-exploration: minus the mean over 100 cells of the steps since the last visit, summed
        over steps. sca: robots in the shelter, summed over steps. spc: minus the mean distances
        of the square's area and the circle's line to robots, weighted. lcn: m^2 that the largest
        connected group covers. homing: robots at home, summed over steps. cfa: 250 - 100 x the
        mean distance in m of the floor to robots that are not on black, with the published code's
        wrong mean; cfa-corrected: with the right one. generated: as drawn from `mission_seed`:
        deliveries, robots at home, or the share of robots in the home that has most.
    Metrics: ``neighbours``, the mean number of messages that a robot hears in a step.
    """

    settings_type = EpuckSettings
    settings: EpuckSettings
    actuators = "left", "right"
    metrics = ("neighbours",)
    outputs = 2

    def __init__(self, settings: EpuckSettings) -> None:
        super().__init__(settings)
        model = MODELS[settings.reference_model]
        self.sensors = SENSOR_NAMES[model]
        self.inputs = len(self.sensors)
        mission = MISSIONS.get(settings.mission)
        if mission is None:
            mission = generated.mission(settings.mission_seed)
        self._mission = mission
        number = settings.robots or mission.robots
        self.owners = (0,) * number
        arena = mission.arena
        walls = wall_rows(arena.outer + mission.walls)
        pairs = number * (number + len(walls))
        lanes = -(-number // LANES) * LANES
        robots = np.zeros((ROBOT_ROWS, lanes))
        robots[[X, Y], number:] = FAR_AWAY
        seconds = settings.seconds or mission.seconds
        self.world = EpuckWorld(
            mission=missions.SCORES.index(mission.score or settings.mission),
            steps=max(1, round(seconds / STEP_S)),
            number=number,
            model=model,
            outer_walls=len(arena.outer),
            free=arena.free,
            hearing=mission.hearing,
            around=arena.around,
            start=mission.start,
            sector_from=mission.sector[0],
            sector_to=mission.sector[1],
            spots=mission.spots,
            at_end=int(mission.at_end),
            constants=np.array([*REALITIES[settings.reality], *mission.lamp]),
            walls=walls,
            floor=np.array(mission.floor, np.float64).reshape(-1, 6),
            greys=GREYS,
            places=np.arange(lanes, dtype=np.float64),
            robots=robots,
            meetings=np.zeros((MEETING_ROWS, number * number + LANES), np.int32),
            chances=np.zeros((2, number * number)),
            rays=np.zeros(LANES * number),
            memory=np.zeros((MEMORY_ROWS, lanes)),
            noise=np.zeros((NOISY, lanes)),
            seen=np.zeros((self.inputs, lanes)),
            pairs=np.zeros((pairs, 2), np.int64),
            contacts=np.zeros((pairs + 1, CONTACT_COLUMNS)),
            links=np.zeros((pairs, LINK_COLUMNS), np.int64),
            bodies=np.zeros((number, BODY_COLUMNS)),
            impulses=np.zeros((pairs, IMPULSE_COLUMNS)),
            lists=np.zeros((LISTS, pairs), np.int64),
            changes=np.zeros((CHANGE_ROWS, number)),
            tally=np.zeros(missions.FIRST_CELL + missions.CELLS**2),
            counts=np.zeros(COUNTS, np.int64),
            stream=np.zeros(1, np.uint64),
        )

    def frame(self) -> Frame:
        """Return the arena from above, y upwards in the world and downwards in the picture."""
        world, side = self.world, self._mission.arena.half_side
        bodies = [self._body(robot) for robot in range(world.number)]
        places = [Rectangle("grey floor", 0.0, 0.0, 2 * side, 2 * side)]
        for shape, x, y, half_x, half_y, grey in self._mission.floor:
            kind = "black floor" if grey == BLACK else "white floor"
            if shape == DISC:
                bodies.append(Body(kind, side + x, side - y, half_x))
            else:
                left, right = max(x - half_x, -side), min(x + half_x, side)
                low, high = max(y - half_y, -side), min(y + half_y, side)
                corner = side + left, side - high
                # Of floors that overlap the first one counts: it is drawn last.
                places.insert(1, Rectangle(kind, *corner, right - left, high - low))
        if self._mission.lamp[-1] > 0.0:
            x, y, _, _ = self._mission.lamp
            bodies.append(Body("lamp", side + x, side - y, RADIUS / 2))
        lines = []
        for x, y, cosine, sine, half_x, half_y, _ in world.walls.tolist():
            # The longer middle line of the box.
            dx, dy = (cosine * half_x, sine * half_x)
            if half_y > half_x:
                dx, dy = (-sine * half_y, cosine * half_y)
            ends = (side + x - dx, side - y + dy, side + x + dx, side - y - dy)
            lines.append(Line("wall", *ends))
        return Frame(2 * side, 2 * side, places, bodies, lines)

    def _body(self, robot: int) -> Body:
        """Return a robot in the picture."""
        x, y, angle = self.world.robots[[X, Y, ANGLE], robot].tolist()
        forages = self.world.mission in (missions.FORAGING, missions.DELIVERIES)
        carries = forages and self.world.robots[CARRIES, robot]
        kind = "robot with an object" if carries else "robot"
        side = self._mission.arena.half_side
        return Body(kind, side + x, side - y, RADIUS, float(-angle))


Epuck.problem = problem(
    "play_epuck",
    trial.start,
    trial.observe,
    trial.act,
    trial.is_over,
    missions.judge,
    world=EpuckWorld,
    loop=play_many,
)
