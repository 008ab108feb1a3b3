"""Emergency exit on a grid, exactly FREVO's ``EmergencyExit`` (github.com/smartgrids-aau/Frevo, version 1.5).

Every constant and every order of operations is FREVO's; recorded runs of it are part of the tests.
"""

from collections.abc import Sequence
from typing import Annotated, Literal

import msgspec
import numpy as np
from msgspec import Meta

from zswarm.errors import ConfigError
from zswarm.jit import STEP, Step, array, float32, float64, inline, int32, int64, kernel, uint64, void
from zswarm.sims.simulator import Body, CompiledSimulator, Frame, Outcome, Place, Turn

INPUTS, OUTPUTS = 10, 2
# Sensors 2-9 look at the eight cells around, from north clockwise; y grows downward.
NEIGHBOUR_X = np.array([0, 1, 1, 1, 0, -1, -1, -1])
NEIGHBOUR_Y = np.array([-1, -1, 0, 1, 1, 1, 0, -1])
FREE, BLOCKED = np.float32(1), np.float32(0)
HALF, ONE, TWO = np.float32(0.5), np.float32(1), np.float32(2)

STADIUM = """
####################
#..................#
#..................#
#..................#
#.......####.......#
#.....##....##.....#
#....#........#....#
#....#........#....#
#...#..........#...#
E...#..........#...E
E...#..........#...E
#...#..........#...#
#....#........#....#
#....#........#....#
#.....##....##.....#
#.......####.......#
#..................#
#..................#
#..................#
####################
""".split()
STADIUM_AGENTS = """
1,1 2,2 3,3 4,4 5,3 6,2 7,1 4,2 3,1 5,1 1,3 2,4 1,5 2,6 3,5 1,7 1,12 2,13 1,14 2,15 1,16 2,17 1,18 3,14 4,15 3,16 4,17
3,18 5,16 6,17 5,18 7,18 12,18 13,17 14,16 15,15 16,14 17,13 18,12 18,14 17,15 16,16 15,17 16,18 17,17 18,16 18,18 14,18
12,1 13,2 14,3 15,4 16,5 17,6 18,7 18,5 17,4 16,3 15,2 14,1 16,1 17,2 18,3 18,1 8,2 11,2 10,1 9,1 8,17 10,18 11,17 9,18
""".split()

Length = Annotated[int, Meta(ge=1, le=1_000)]


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of ``[problem.settings]``; width to seed describe the random field, the stadium has its own."""

    field: Annotated[
        Literal["random", "stadium"],
        Meta(description="fields drawn from the trial's seed, or FREVO's stadium with 72 agents"),
    ] = "random"
    steps: Annotated[int, Meta(ge=1, le=1_000_000, description="rounds of a trial")] = 50
    width: Annotated[Length, Meta(description="cells of a random field; not above `height`")] = 20
    height: Annotated[Length, Meta(description="cells of a random field")] = 20
    agents: Annotated[int, Meta(ge=1, le=1_000, description="robots of a random field; the stadium has 72")] = 10
    exits: Annotated[int, Meta(ge=1, le=10_000, description="exits of a random field; the stadium has its own")] = 5
    blockades: Annotated[int, Meta(ge=0, le=10_000, description="blocked cells of a random field")] = 20
    seed: Annotated[int, Meta(ge=0, lt=2**48, description="of the first field; the trials have `seed`, `seed` + 1, ...")] = 0


class EmergencyExit(CompiledSimulator):
    """Robots in a room must leave through the nearest exit; they block one another.

    Observation: (10,) float32. 0-1: signed dx, dy to the exit nearest by Euclidean distance, in cells, not scaled.
        2-9: the cells N, NE, E, SE, S, SW, W, NW: 1 free, 0 wall, blockade, or an agent still inside; exits are free.
    Action: (2,) float32 x and y, each rounded from 2 o - 1: -1 from o = -.25, 0 from .25, +1 from .75; below -.25 and from 1.25
        on 0. A move onto a blocked cell is none.
    Turns: one agent at a time, in index order; each sees the moves before it. An agent on an exit is out for good.
    Start: fields are drawn from the trial's seed (the standard generator of Java), or the stadium's 72 agents.
    End: after ``steps`` rounds.
    Fitness: (steps - f) / steps - sum over agents of the distance to the nearest exit; f is the first round (from 0) after
        which everybody was out, else ``steps``. At most 1.
    Metrics: ``escaped`` agents; ``rounds`` until all were out (f + 1), or ``steps``.
    Trial seeds: ``seed``, ``seed`` + 1, ... of the settings, as FREVO; the stadium is the same for every seed.
    """

    settings_type = Settings
    metrics = ("escaped", "rounds")
    inputs, outputs = INPUTS, OUTPUTS
    sensors = ("exit_dx", "exit_dy", "n", "ne", "e", "se", "s", "sw", "w", "nw")
    actuators = ("vx", "vy")
    settings: Settings

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings)
        stadium = settings.field == "stadium"
        self.width, self.height = (len(STADIUM[0]), len(STADIUM)) if stadium else (settings.width, settings.height)
        self.agents = len(STADIUM_AGENTS) if stadium else settings.agents
        if not stadium:
            if settings.width > settings.height:
                raise ConfigError(
                    "emergency-exit: width must not exceed height: a random field draws both coordinates from the width"
                )
            wanted = settings.agents + settings.exits + settings.blockades
            if wanted > settings.width**2:
                raise ConfigError(f"emergency-exit: {wanted} agents, exits and blockades do not fit on {settings.width**2} cells")
        self.stride = self.width + 2  # a ring of blocked cells lies around the field
        self.cells = self.stride * (self.height + 2)
        self.owners = (0,) * self.agents

    def fixed_seeds(self, trials: int) -> Sequence[int]:
        """Field seeds one after another from the settings' ``seed``."""
        return range(self.settings.seed, self.settings.seed + trials)

    def reset(self, seed: int) -> Turn:
        """Lay out the field of a seed; the first agent acts next."""
        free, exit_x, exit_y, starts = self._fields(np.array([seed], np.uint64))
        self._free, self._exit_x, self._exit_y, self._cell = free[0], exit_x[0], exit_y[0], starts[0]
        self._inside = np.ones(self.agents, np.uint8)
        for agent in range(self.agents):
            self._free[self._cell[agent]] = BLOCKED
        self._round, self._agent, self._first_all_out = 0, 0, self.settings.steps
        return self._turn()

    def step(self, actions: np.ndarray) -> Turn | None:
        """Move the agent of the last turn; the next one inside acts next."""
        act(self._agent, actions[0], self._cell, self._inside, self._free, self._exit_x, self._exit_y, self.stride)
        self._agent += 1
        while self._round < self.settings.steps:
            while self._agent < self.agents:
                if self._inside[self._agent]:
                    return self._turn()
                self._agent += 1
            if not self._inside.any() and self._first_all_out == self.settings.steps:
                self._first_all_out = self._round
            self._agent, self._round = 0, self._round + 1
        return None

    def outcome(self) -> Outcome:
        """Fitness and metrics of the trial that ended."""
        fitness, metrics = np.zeros(1), np.zeros(2)
        judge(
            self._cell,
            self._inside,
            self._exit_x,
            self._exit_y,
            self._first_all_out,
            self.settings.steps,
            fitness,
            metrics,
        )
        return Outcome(list(fitness), list(metrics))

    def frame(self) -> Frame:
        """The field in cells; whoever is out stays where it left."""
        here = [(int(c) % self.stride - 1, int(c) // self.stride - 1) for c in self._cell]
        blockades = [
            (x, y) for x, y in self._places() if not self._free[(y + 1) * self.stride + x + 1] and (x, y) not in set(here)
        ]
        exits = [place for place in self._places() if self._nearest(place) == (0, 0)]
        return Frame(
            self.width,
            self.height,
            [Place(kind, x, y, 1, 1) for kind, cells in (("blockade", blockades), ("exit", exits)) for x, y in cells],
            [
                Body("robot inside" if inside else "robot outside", x + 0.5, y + 0.5, 0.35)
                for (x, y), inside in zip(here, self._inside, strict=True)
            ],
        )

    def play(
        self,
        step: Step,
        state_size: int,
        parameters: np.ndarray,
        participants: np.ndarray,
        seeds: np.ndarray,
        progress: np.ndarray,
        fitness: np.ndarray,
        metrics: np.ndarray,
    ) -> None:
        """See ``CompiledSimulator.play``; every distinct field is laid out once for the whole batch."""
        distinct, field_of_trial = np.unique(seeds, return_inverse=True)
        if self.settings.field == "stadium":
            distinct, field_of_trial = distinct[:1], np.zeros_like(field_of_trial)
        states = np.zeros((self.agents, state_size), np.float32)
        fields = self._fields(distinct)
        play_trials(
            step, parameters, participants, field_of_trial, *fields, states, self.stride, self.settings.steps,
            progress, fitness, metrics,
        )  # fmt: skip

    def _turn(self) -> Turn:
        observation = np.empty((1, INPUTS), np.float32)
        observe(self._cell[self._agent], self._free, self._exit_x, self._exit_y, self.stride, observation[0])
        return Turn((self._agent,), observation)

    def _places(self) -> list[tuple[int, int]]:
        return [(x, y) for y in range(self.height) for x in range(self.width)]

    def _nearest(self, place: tuple[int, int]) -> tuple[float, float]:
        cell = (place[1] + 1) * self.stride + place[0] + 1
        return float(self._exit_x[cell]), float(self._exit_y[cell])

    def _fields(self, seeds: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Free cells, offsets to the nearest exit, and the agents' start cells, one row per seed."""
        things = self._stadium(len(seeds)) if self.settings.field == "stadium" else self._random_fields(seeds)
        agents, exits, blockades = things
        free = np.full((len(seeds), self.cells), BLOCKED)
        exit_x, exit_y = np.zeros_like(free), np.zeros_like(free)
        lay_out(exits, blockades, self.width, self.height, free, exit_x, exit_y)
        return free, exit_x, exit_y, agents

    def _random_fields(self, seeds: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        counts = (self.settings.agents, self.settings.exits, self.settings.blockades)
        placed = np.empty((len(seeds), sum(counts)), np.int32)
        place(seeds.astype(np.uint64), self.width, self.stride, self.cells, placed)
        agents, exits, blockades = np.split(placed, np.cumsum(counts)[:-1], axis=1)
        return np.ascontiguousarray(agents), np.ascontiguousarray(exits), np.ascontiguousarray(blockades)

    def _stadium(self, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        def cells(places: list[tuple[int, int]]) -> np.ndarray:
            return np.tile(np.array([(y + 1) * self.stride + x + 1 for x, y in places], np.int32), (count, 1))

        agents = [(int(x), int(y)) for x, y in (pair.split(",") for pair in STADIUM_AGENTS)]
        exits = [(x, y) for x, y in self._places() if STADIUM[y][x] == "E"]
        blockades = [(x, y) for x, y in self._places() if STADIUM[y][x] == "#"]
        return cells(agents), cells(exits), cells(blockades)


GRID = array(float32)
GRIDS = array(float32, 2)
CELLS = array(int32)
CELL_TABLE = array(int32, 2)


@inline
def draw_below(state, bound):  # type: ignore[no-untyped-def]  # compiled
    """Java's ``Random.nextInt(bound)``: a 48-bit linear congruential generator, upper 31 bits."""
    while True:
        state[0] = (state[0] * np.uint64(0x5DEECE66D) + np.uint64(0xB)) & np.uint64((1 << 48) - 1)
        bits = np.int64(state[0] >> np.uint64(17))
        if bound & (bound - 1) == 0:
            return (bound * bits) >> 31
        value = bits % bound
        if bits - value + (bound - 1) < 2147483648:
            return value


@kernel(void(array(uint64), int64, int64, int64, CELL_TABLE))
def place(seeds, width, stride, cells, placed):  # type: ignore[no-untyped-def]  # compiled
    """Per seed put all things, in order, on free cells by rejection; both coordinates are drawn from the width."""
    state = np.empty(1, np.uint64)
    for row in range(seeds.shape[0]):
        taken = np.zeros(cells, np.uint8)
        state[0] = (seeds[row] ^ np.uint64(0x5DEECE66D)) & np.uint64((1 << 48) - 1)
        for thing in range(placed.shape[1]):
            cell = 0
            while cell == 0 or taken[cell]:
                x = draw_below(state, width)
                y = draw_below(state, width)
                cell = (y + 1) * stride + x + 1
            taken[cell] = 1
            placed[row, thing] = cell


@kernel(void(CELL_TABLE, CELL_TABLE, int64, int64, GRIDS, GRIDS, GRIDS))
def lay_out(exits, blockades, width, height, free, exit_x, exit_y):  # type: ignore[no-untyped-def]  # compiled
    """Per field mark the free cells and write the offset to the nearest exit (the first of equals) on each."""
    stride = width + 2
    for row in range(free.shape[0]):
        for y in range(1, height + 1):
            for x in range(1, width + 1):
                cell = y * stride + x
                free[row, cell] = FREE
                best = np.int64(1 << 62)
                for i in range(exits.shape[1]):
                    dx = exits[row, i] % stride - x
                    dy = exits[row, i] // stride - y
                    if dx * dx + dy * dy < best:
                        best = dx * dx + dy * dy
                        exit_x[row, cell] = float32(dx)
                        exit_y[row, cell] = float32(dy)
        for i in range(blockades.shape[1]):
            free[row, blockades[row, i]] = BLOCKED


@inline
def observe(cell, free, exit_x, exit_y, stride, observation):  # type: ignore[no-untyped-def]  # compiled
    """What an agent on a cell observes."""
    observation[0] = exit_x[cell]
    observation[1] = exit_y[cell]
    observation[2] = free[cell - stride]
    observation[3] = free[cell - stride + 1]
    observation[4] = free[cell + 1]
    observation[5] = free[cell + stride + 1]
    observation[6] = free[cell + stride]
    observation[7] = free[cell + stride - 1]
    observation[8] = free[cell - 1]
    observation[9] = free[cell - stride - 1]


@inline
def velocity(output):  # type: ignore[no-untyped-def]  # compiled
    """round(2 o - 1) as Java's float arithmetic has it; what is not -1, 0 or 1 then, or NaN, means no move."""
    moved = TWO * output - ONE
    if moved < -HALF:
        return -1 if moved >= -ONE - HALF else 0
    return 1 if HALF <= moved < ONE + HALF else 0


@inline
def act(agent, action, cells, inside, free, exit_x, exit_y, stride):  # type: ignore[no-untyped-def]  # compiled
    """Move one agent if the cell is free, and let it out on an exit."""
    here = cells[agent]
    there = here + velocity(action[1]) * stride + velocity(action[0])
    if free[there] == BLOCKED:
        there = here
    free[here] = FREE
    cells[agent] = there
    if exit_x[there] == 0 and exit_y[there] == 0:
        inside[agent] = 0
    else:
        free[there] = BLOCKED


@inline
def judge(cells, inside, exit_x, exit_y, first_all_out, steps, fitness, metrics):  # type: ignore[no-untyped-def]  # compiled
    """Fitness and metrics of a trial that ended."""
    total = 0.0
    escaped = 0
    for agent in range(cells.shape[0]):
        dx, dy = np.float64(exit_x[cells[agent]]), np.float64(exit_y[cells[agent]])
        total += np.sqrt(dx * dx + dy * dy)
        escaped += 1 - inside[agent]
    fitness[0] = (steps - first_all_out) / steps - total
    metrics[0] = escaped
    metrics[1] = min(first_all_out + 1, steps)


@kernel(
    void(STEP, GRIDS, array(int64, 2), array(int64), GRIDS, GRIDS, GRIDS, CELL_TABLE, GRIDS, int64, int64,
         array(int64), array(float64, 2), array(float64, 2))
)  # fmt: skip
def play_trials(  # type: ignore[no-untyped-def]  # compiled
    step, parameters, participants, field_of_trial, free, exit_x, exit_y, starts, states, stride, steps,
    progress, fitness, metrics,
):  # fmt: skip
    """All trials of a batch, see ``CompiledSimulator.play``."""
    agents = starts.shape[1]
    observation, action = np.empty(INPUTS, np.float32), np.empty(OUTPUTS, np.float32)
    grid, cells, inside = np.empty(free.shape[1], np.float32), np.empty(agents, np.int32), np.empty(agents, np.uint8)
    for trial in range(field_of_trial.shape[0]):
        progress[0] = trial
        if progress[1] != 0:
            return
        field = field_of_trial[trial]
        controller, to_x, to_y = parameters[participants[trial, 0]], exit_x[field], exit_y[field]
        grid[:], cells[:] = free[field], starts[field]
        inside[:] = 1
        states[:] = 0
        for agent in range(agents):
            grid[cells[agent]] = BLOCKED
        first_all_out, remaining = steps, agents
        for round_ in range(steps):
            for agent in range(agents):
                if inside[agent]:
                    observe(cells[agent], grid, to_x, to_y, stride, observation)
                    step(controller, states[agent], observation, action)
                    act(agent, action, cells, inside, grid, to_x, to_y, stride)
                    remaining -= 1 - inside[agent]
            if remaining == 0:
                first_all_out = round_
                break
        judge(cells, inside, to_x, to_y, first_all_out, steps, fitness[trial], metrics[trial])
