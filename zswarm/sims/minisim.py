"""Minisim: robots play capture the flag against scripted defenders, on a grid.

The simulator of this name in the paper was never published. This game is our own design on the same
subject: quick to compute, and a matter of teamwork, because a defender that chases one robot leaves
the flag to another.
"""

from typing import Annotated, Literal

import numpy as np
from msgspec import Meta

from zswarm.config.meta import PartSettings, about, within
from zswarm.errors import ConfigError
from zswarm.sims import minisim_rules
from zswarm.sims.minisim_rules import (
    CAPTURES,
    CARRIER,
    GAME_COLUMNS,
    ROBOT_COLUMNS,
    MinisimWorld,
    X,
    Y,
)
from zswarm.sims.simulator import Body, Frame, Label, Rectangle
from zswarm.sims.trial import Teams, play_many, problem

INPUTS = {1: 9, 2: 14}  # by the number of teams

Length = Annotated[int, Meta(ge=2, le=1_000)]
Sight = Annotated[int, Meta(ge=1, le=1_000)]


class MinisimSettings(PartSettings, frozen=True):
    """Settings of ``[problem.settings]``; lengths in cells, distances in king moves."""

    steps: Annotated[
        int,
        within(1, 1_000_000, "steps of a trial; at least 2 (`width` - `width` div 2)"),
    ] = 100
    width: Annotated[Length, about("cells")] = 20
    height: Annotated[Length, about("cells")] = 20
    robots: Annotated[int, within(1, 1_000, "robots")] = 8
    defenders: Annotated[int, within(0, 1_000, "scripted defenders")] = 2
    robot_sight: Annotated[
        Sight,
        about("king moves; a robot senses defenders and other robots that are nearer"),
    ] = 8
    defender_sight: Annotated[
        Sight, about("king moves up to which a defender chases a robot")
    ] = 6
    reach: Annotated[
        int,
        within(
            *(0, 1_000),
            "king moves up to which a defender tags a robot; not above `defender_sight`",
        ),
    ] = 1
    rest: Annotated[
        int,
        within(
            *(0, 1_000_000),
            "defenders stand still in every `rest`-th step; 0: never; not 1 if there are defenders",
        ),
    ] = 4
    teams: Annotated[
        Literal[1, 2],
        about(
            "1: robots against scripted defenders; 2: two teams of `robots`, each a participant, "
            "without defenders"
        ),
    ] = 1


class Minisim(Teams):
    """Simulate robots that fetch a flag repeatedly; defenders that come near send them back.

    Cells have x and y from 0. The distance of an offset is |dx, dy| = max(|dx|, |dy|), king moves.
    Any number of robots and defenders may share a cell. Home is the column x = 0; ``size`` is the
    greater of width and height.

    Observation: (9,) float32, each operation rounded to float32. Where dx, dy is the offset to
        the goal, which is the flag's stand, or for the carrier the cell at x = 0 in its row:
        0-1: dx / max(1, |dx, dy|), dy / max(1, |dx, dy|). 2: 1 - |dx, dy| / size.
        the nearest defender (the first of equals), with d = |dx, dy| and s = ``robot_sight``:
        3-4: (dx / d) * ((s - d) / s), (dy / d) * ((s - d) / s); zeros if d is 0 or d >= s.
        the nearest other robot: 5-6, as for the defender.
        7: 1 for the carrier, else 0. 8: 1 while another robot carries the flag, else 0.
    Action: (2,) float32 for x and y: below .25 a cell back, above .75 a cell forth, else none;
    walls hold robots in.
    Turns: all robots at once, seeing the state before the step. A step (they count from 1):
        1. Robots move. The first robot on the stand takes the flag if no robot has it (a steal). A
        carrier at home has captured it; the flag is back on its stand.
        2. Unless the step is a multiple of ``rest`` (0: always), defender after defender moves one
        cell (dx and dy cut to -1..1) towards the nearest robot (the first of equals) within
        ``defender_sight`` that is not at home and that no earlier defender chose in this step, else
        towards the stand.
        3. Every robot not at home within ``reach`` of a defender is tagged: it is put on its start
        cell, and the flag, if it had it, on the stand.
    Start: from ``Stream(seed)`` of zswarm.kernels.random the stand, x = width - 1 - integer(width
        // 2) and y = integer(height), then per robot y = integer(height), x = 0. Defenders start on
        the stand.
    End: after ``steps`` steps.
    Fitness: captures + (there + back) / 2, where the second part, in 0..1, is what was done since
    the last capture:
        there = 1 - c / size, c the least distance of a robot to the stand after moves of robots
        (``size`` before any); back = 1 - h / (x of the stand), h the least x of a carrier after
        such moves (x of the stand before any).
    Metrics: ``captures``; ``steals``; ``tagged``, counted per robot and time.

    With ``teams`` = 2 two teams of ``robots`` play each other, each driven by a participant; there
    are no defenders. Each sees the field from its own side, as above: home is the column x = 0, the
    other team's flag stands in the far half, and what one team sees at (x, y) the other sees at
    (width - 1 - x, height - 1 - y). So the field is the same for both, no rule depends on the order
    of teams, and a team that plays itself always ties. A robot with 2 x > width - 1 is in the other
    team's half, and intrudes; where 2 x = width - 1 it is in neither half.

    Observation: (14,) float32; 0-8 as above, with the other's robots for defenders and those of the
        own team for others.
        9-11: as 0-2 for the own flag, which is on its stand or where the robot is that carries it.
        12: 1 while one of the others carries the own flag, else 0. 13: 1 for a robot that intrudes,
        else 0.
    Turns: all robots of both teams at once. A step: 1. as above, for each team. 2. An intruder
        and a robot of the other team that does not intrude tag each other within ``reach``; all
        such pairs are found before any robot is put on its start cell. A flag that a tagged robot
        had returns to its stand.
    Start: stand and robots are drawn as above, once: each team starts so in its own view.
    Fitness: of each team as above, so that a team does better by more captures of its own or by
    fewer of the other's.
    Metrics: ``captures`` and ``steals`` of both teams together; ``tagged``, intruders only.
    """

    settings_type = MinisimSettings
    metrics = ("captures", "steals", "tagged")
    outputs = 2
    settings: MinisimSettings

    def __init__(self, settings: MinisimSettings) -> None:
        super().__init__(settings)
        shortest = 2 * (settings.width - settings.width // 2)
        if settings.steps < shortest:
            raise ConfigError(
                f"minisim: no flag can be captured in {settings.steps} steps; width "
                f"{settings.width} takes {shortest}"
            )
        if settings.reach > settings.defender_sight:
            raise ConfigError(
                f"minisim: reach {settings.reach} must not exceed defender_sight "
                f"{settings.defender_sight}: a defender cannot tag what it does not see"
            )
        if settings.rest == 1 and settings.defenders:
            raise ConfigError(
                "minisim: rest 1 keeps the defenders on the flag for ever; give 0 (no rest) or 2 "
                "and more"
            )
        if settings.teams == 2 and settings.defenders:
            raise ConfigError(
                "minisim: two teams guard their flags themselves; give defenders = 0 with teams = 2"
            )
        self.inputs = INPUTS[settings.teams]
        self.participants = settings.teams
        self.owners = tuple(
            team for team in range(settings.teams) for _ in range(settings.robots)
        )
        self.world = MinisimWorld(
            steps=settings.steps,
            width=settings.width,
            height=settings.height,
            number=settings.robots,
            robot_sight=settings.robot_sight,
            defender_sight=settings.defender_sight,
            reach=settings.reach,
            rest=settings.rest,
            robots=np.zeros((len(self.owners), ROBOT_COLUMNS), np.int64),
            defenders=np.zeros((settings.defenders, 2), np.int64),
            stand=np.zeros(2, np.int64),
            games=np.zeros((settings.teams, GAME_COLUMNS), np.int64),
            stream=np.zeros(1, np.uint64),
        )

    def frame(self) -> Frame:
        """Draw the field in cells, of two teams in the view of the first."""
        width = self.settings.width
        height = self.settings.height
        right = width - 1
        bottom = height - 1
        games = self.world.games.tolist()
        bodies = []
        for number, robot in enumerate(self.world.robots.tolist()):
            team = self.owners[number]
            name = ("robot", "opponent")[team]
            kind = f"{name} with the flag" if games[team][CARRIER] == number else name
            x = right - robot[X] if team else robot[X]
            y = bottom - robot[Y] if team else robot[Y]
            bodies.append(
                Body(kind, x + 0.5, y + 0.5, 0.4, shape=("disc", "triangle")[team])
            )
        bodies += [
            Body("defender", x + 0.5, y + 0.5, 0.4, shape="triangle")
            for x, y in self.world.defenders.tolist()
        ]
        places = [Rectangle("home", 0, 0, 1, height)]
        x, y = self.world.stand.tolist()
        if len(games) == 1:
            places.append(Rectangle("flag's stand", x, y, 1, 1))
            score = f"flags home: {games[0][CAPTURES]}"
        else:
            places += [
                Rectangle("opponents' home", right, 0, 1, height),
                Rectangle("flag's stand", right - x, bottom - y, 1, 1),
                Rectangle("opponents' flag's stand", x, y, 1, 1),
            ]
            score = (
                f"flags home: {games[0][CAPTURES]} robots, {games[1][CAPTURES]} opponents"
            )
        label = Label(score, width / 2, 0.05 * height, 0.04 * height)
        return Frame(width, height, places, bodies, labels=[label])


Minisim.problem = problem(
    "play_minisim",
    minisim_rules.start,
    minisim_rules.observe,
    minisim_rules.act,
    minisim_rules.is_over,
    minisim_rules.judge,
    world=MinisimWorld,
    loop=play_many,
)
