"""Emergency exit on a grid, exactly FREVO's ``EmergencyExit`` (github.com/smartgrids-aau/Frevo, version 1.5).

Every constant and every order of operations is FREVO's; recorded runs of it are part of the tests.
"""

from collections.abc import Sequence
from typing import Annotated, Literal, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta

from zswarm.draws import draw_java, start_java
from zswarm.errors import ConfigError
from zswarm.jit import STEP, Step, array, float32, float64, inline, int32, int64, kernel, uint64, void
from zswarm.lanes import LANES, any_of, fill, load, scatter, select, store, window
from zswarm.portable import PI
from zswarm.sims.simulator import Batch, Body, CompiledSimulator, Frame, Outcome, Place, Ray, Turn

INPUTS, OUTPUTS = 10, 2
# Sensors 2-9 look at the eight cells around, from north clockwise; y grows downward.
NEIGHBOUR_X = np.array([0, 1, 1, 1, 0, -1, -1, -1])
NEIGHBOUR_Y = np.array([-1, -1, 0, 1, 1, 1, 0, -1])
FREE, BLOCKED = np.float32(1), np.float32(0)
ZERO, HALF, ONE, TWO = np.float32(0), np.float32(0.5), np.float32(1), np.float32(2)
LEFT, STILL, RIGHT = np.int32(-1), np.int32(0), np.int32(1)

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

MOST_KEPT = 100_000  # cells of fields that are kept for the trials to come
LANES_REACH = 2**31  # lanes find a cell by a 32-bit index
FEWEST = 2  # trials from which on playing eight side by side is sooner done than one after the other

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


class Fields(NamedTuple):
    """Fields as kernels want them, one row per field."""

    free: np.ndarray  # (fields, cells) float32, FREE or BLOCKED
    to_exit: np.ndarray  # (fields, 2 cells + 2) float32: dx and dy of each cell to its nearest exit, and two that nobody reads
    starts: np.ndarray  # (fields, agents) int32, cells


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
        self._row_of: dict[int, int] = {}  # of a seed: where its field is in ``_kept``

    def fixed_seeds(self, trials: int) -> Sequence[int]:
        """Field seeds one after another from the settings' ``seed``."""
        return range(self.settings.seed, self.settings.seed + trials)

    def reset(self, seed: int) -> Turn:
        """Lay out the field of a seed; the first agent acts next."""
        free, to_exit, starts = self._fields(np.array([seed], np.uint64))
        self._free, self._to_exit, self._cell = free[0], to_exit[0], starts[0]
        self._inside = np.ones(self.agents, np.uint8)
        for agent in range(self.agents):
            self._free[self._cell[agent]] = BLOCKED
        self._round, self._agent, self._first_all_out = 0, 0, self.settings.steps
        return self._turn()

    def step(self, actions: np.ndarray) -> Turn | None:
        """Move the agent of the last turn; the next one inside acts next."""
        act(self._agent, actions[0], self._cell, self._inside, self._free, self._to_exit, self.stride)
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
            self._to_exit,
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
            rays=[Ray(2 + eighth, (eighth - 2) * PI / 4, 0.0, 1.0) for eighth in range(8)],
        )

    def play(self, step: Step, batch: Batch) -> None:
        """See ``CompiledSimulator.play``."""
        self._play_from(0, self._rows(batch.seeds), step, batch)

    def play_lanes(self, step_lanes: Step, step: Step, batch: Batch) -> None:
        """See ``CompiledSimulator.play_lanes``: eight trials side by side, each in a lane."""
        rows = self._rows(batch.seeds)
        together = len(rows) if len(rows) % LANES >= FEWEST else len(rows) - len(rows) % LANES
        if 2 * self._kept.to_exit.size + 2 * LANES * self.cells >= LANES_REACH:
            together = 0
        if together:
            states = np.zeros((self.agents, LANES * batch.state_size), np.float32)
            play_side_by_side(
                step_lanes, batch.parameters, batch.participants, rows[:together], *self._kept, states, self.stride,
                self.settings.steps, batch.progress, batch.fitness, batch.metrics,
            )  # fmt: skip
        if together < len(rows):
            self._play_from(together, rows, step, batch)

    def _play_from(self, first: int, rows: np.ndarray, step: Step, batch: Batch) -> None:
        states = np.zeros((self.agents, batch.state_size), np.float32)
        play_trials(
            step, batch.parameters, batch.participants, rows, *self._kept, states, self.stride, self.settings.steps, first,
            batch.progress, batch.fitness, batch.metrics,
        )  # fmt: skip

    def _turn(self) -> Turn:
        observation = np.empty((1, INPUTS), np.float32)
        observe(self._cell[self._agent], self._free, self._to_exit, self.stride, observation[0])
        return Turn((self._agent,), observation)

    def _places(self) -> list[tuple[int, int]]:
        return [(x, y) for y in range(self.height) for x in range(self.width)]

    def _nearest(self, place: tuple[int, int]) -> tuple[float, float]:
        cell = (place[1] + 1) * self.stride + place[0] + 1
        return float(self._to_exit[2 * cell]), float(self._to_exit[2 * cell + 1])

    def _rows(self, seeds: np.ndarray) -> np.ndarray:
        """Where the field of each seed is in ``_kept``, after those that are new were laid out."""
        if self.settings.field == "stadium":
            if not self._row_of:
                self._row_of[0], self._kept = 0, self._fields(seeds[:1])
            return np.zeros(len(seeds), np.int64)
        wanted = seeds.tolist()
        new = [seed for seed in dict.fromkeys(wanted) if seed not in self._row_of]
        if new:
            if len(self._row_of) * self.cells > MOST_KEPT:
                self._row_of.clear()
                new = list(dict.fromkeys(wanted))
            laid_out = self._fields(np.array(new, np.uint64))
            if self._row_of:
                laid_out = Fields(*(np.concatenate(both) for both in zip(self._kept, laid_out, strict=True)))
            self._kept = laid_out
            self._row_of.update(zip(new, range(len(self._row_of), len(self._row_of) + len(new)), strict=True))
        return np.array([self._row_of[seed] for seed in wanted], np.int64)

    def _fields(self, seeds: np.ndarray) -> Fields:
        things = self._stadium(len(seeds)) if self.settings.field == "stadium" else self._random_fields(seeds)
        agents, exits, blockades = things
        free = np.full((len(seeds), self.cells), BLOCKED)
        to_exit = np.zeros((len(seeds), 2 * self.cells + 2), np.float32)
        lay_out(exits, blockades, self.width, self.height, free, to_exit)
        return Fields(free, to_exit, agents)

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


@kernel(void(array(uint64), int64, int64, int64, CELL_TABLE))
def place(seeds, width, stride, cells, placed):  # type: ignore[no-untyped-def]  # compiled
    """Per seed put all things, in order, on free cells by rejection; both coordinates are drawn from the width."""
    state = np.empty(1, np.uint64)
    for row in range(seeds.shape[0]):
        taken = np.zeros(cells, np.uint8)
        start_java(state, seeds[row])
        for thing in range(placed.shape[1]):
            cell = 0
            while cell == 0 or taken[cell]:
                x = draw_java(state, width)
                y = draw_java(state, width)
                cell = (y + 1) * stride + x + 1
            taken[cell] = 1
            placed[row, thing] = cell


@kernel(void(CELL_TABLE, CELL_TABLE, int64, int64, GRIDS, GRIDS))
def lay_out(exits, blockades, width, height, free, to_exit):  # type: ignore[no-untyped-def]  # compiled
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
                        to_exit[row, 2 * cell] = float32(dx)
                        to_exit[row, 2 * cell + 1] = float32(dy)
        for i in range(blockades.shape[1]):
            free[row, blockades[row, i]] = BLOCKED


@inline
def observe(cell, free, to_exit, stride, observation):  # type: ignore[no-untyped-def]  # compiled
    """What an agent on a cell observes."""
    observation[0] = to_exit[2 * cell]
    observation[1] = to_exit[2 * cell + 1]
    observation[2] = free[cell - stride]
    observation[3] = free[cell - stride + 1]
    observation[4] = free[cell + 1]
    observation[5] = free[cell + stride + 1]
    observation[6] = free[cell + stride]
    observation[7] = free[cell + stride - 1]
    observation[8] = free[cell - 1]
    observation[9] = free[cell - stride - 1]


@inline
def turned(output):  # type: ignore[no-untyped-def]  # compiled
    """Whether 2 o - 1, rounded as Java's float arithmetic has it, is -1, and whether it is 1; works on lanes, too."""
    moved = TWO * output - ONE
    return (moved < -HALF) & (moved >= -ONE - HALF), (moved >= HALF) & (moved < ONE + HALF)


@inline
def velocity(output):  # type: ignore[no-untyped-def]  # compiled
    """-1, 0 or 1; what is rounded to another number, or NaN, means no move."""
    back, forth = turned(output)
    return int(forth) - int(back)


@inline
def act(agent, action, cells, inside, free, to_exit, stride):  # type: ignore[no-untyped-def]  # compiled
    """Move one agent if the cell is free, and let it out on an exit."""
    here = cells[agent]
    there = here + velocity(action[1]) * stride + velocity(action[0])
    if free[there] == BLOCKED:
        there = here
    free[here] = FREE
    cells[agent] = there
    if to_exit[2 * there] == 0 and to_exit[2 * there + 1] == 0:
        inside[agent] = 0
    else:
        free[there] = BLOCKED


@inline(counts=False)
def judge(cells, inside, to_exit, first_all_out, steps, fitness, metrics):  # type: ignore[no-untyped-def]  # compiled
    """Fitness and metrics of a trial that ended."""
    total = 0.0
    escaped = 0
    for agent in range(cells.shape[0]):
        dx, dy = np.float64(to_exit[2 * cells[agent]]), np.float64(to_exit[2 * cells[agent] + 1])
        total += np.sqrt(dx * dx + dy * dy)
        escaped += 1 - inside[agent]
    fitness[0] = (steps - first_all_out) / steps - total
    metrics[0] = escaped
    metrics[1] = min(first_all_out + 1, steps)


@inline(counts=False)
def play_rounds(  # type: ignore[no-untyped-def]  # compiled
    step, controller, states, exits, grid, cells, inside, observation, action, stride, steps
):
    """The first round after which everybody is out, or ``steps``."""
    remaining = states.shape[0]
    for round_ in range(steps):
        for agent in range(states.shape[0]):
            if inside[agent]:
                observe(cells[agent], grid, exits, stride, observation)
                step(controller, states[agent], observation, action)
                act(agent, action, cells, inside, grid, exits, stride)
                remaining -= 1 - inside[agent]
        if remaining == 0:
            return round_
    return steps


@kernel(
    void(STEP, GRIDS, array(int64, 2), array(int64), GRIDS, GRIDS, CELL_TABLE, GRIDS, int64, int64, int64,
         array(int64), array(float64, 2), array(float64, 2))
)  # fmt: skip
def play_trials(  # type: ignore[no-untyped-def]  # compiled
    step, parameters, participants, field_of_trial, free, to_exit, starts, states, stride, steps, first,
    progress, fitness, metrics,
):  # fmt: skip
    """All trials of a batch from one on, see ``CompiledSimulator.play``."""
    agents = starts.shape[1]
    observation, action = np.empty(INPUTS, np.float32), np.empty(OUTPUTS, np.float32)
    grid, cells, inside = np.empty(free.shape[1], np.float32), np.empty(agents, np.int32), np.empty(agents, np.uint8)
    for trial in range(first, field_of_trial.shape[0]):
        progress[0] = trial
        if progress[1] != 0:
            return
        field = field_of_trial[trial]
        controller, exits = parameters[participants[trial, 0]], to_exit[field]
        inside[:] = 1
        states[:] = 0
        for cell in range(free.shape[1]):  # compiling what numba does on arrays of unequal length would take 2 s
            grid[cell] = free[field, cell]
        for agent in range(agents):
            cells[agent] = starts[field, agent]
            grid[cells[agent]] = BLOCKED
        first_all_out = play_rounds(step, controller, states, exits, grid, cells, inside, observation, action, stride, steps)
        judge(cells, inside, exits, first_all_out, steps, fitness[trial], metrics[trial])


@inline(counts=False)
def observe_lanes(here, exits, grid, stride, observation):  # type: ignore[no-untyped-def]  # compiled
    """``observe`` in each lane; gives the nine cells around and below the agents, row by row."""
    north = window(grid, here, -stride - 1)
    middle = window(grid, here, -1)
    south = window(grid, here, stride - 1)
    for sensor, numbers in enumerate(
        (exits[0], exits[1], north[1], north[2], middle[2], south[2], south[1], south[0], middle[0], north[0])
    ):
        store(observation, sensor * LANES, numbers)
    return north, middle, south


@inline(counts=False)
def ahead(action, around):  # type: ignore[no-untyped-def]  # compiled
    """Directions of all lanes, and whether the cell there is free."""
    west, east = turned(load(action, 0))
    up, down = turned(load(action, LANES))
    north, middle, south = around
    left = select(up, north[0], select(down, south[0], middle[0]))
    same = select(up, north[1], select(down, south[1], BLOCKED))
    right = select(up, north[2], select(down, south[2], middle[2]))
    x = select(east, RIGHT, select(west, LEFT, STILL))
    y = select(down, RIGHT, select(up, LEFT, STILL))
    return x, y, select(east, right, select(west, left, same)) != BLOCKED


@inline(counts=False)
def play_rounds_of_lanes(  # type: ignore[no-untyped-def]  # compiled
    step, packed, states, exit_table, offsets, grid, cells, nearest, observation, action, stride, steps, first_all_out
):
    """``play_rounds`` in each lane, until everybody is out in all of them.

    Nothing is decided by a branch for one lane: an agent that is out takes part, and stays where it is.
    """
    remaining, first_out, offset = fill(np.int32(states.shape[0])), fill(np.int32(steps)), load(offsets, 0)
    for round_ in range(steps):
        for agent in range(states.shape[0]):
            exits = load(nearest, 2 * agent * LANES), load(nearest, (2 * agent + 1) * LANES)
            is_inside = (exits[0] != ZERO) | (exits[1] != ZERO)
            if any_of(is_inside):
                here = load(cells, agent * LANES)
                around = observe_lanes(here, exits, grid, stride, observation)
                step(packed, states[agent], observation, action)
                x, y, is_free = ahead(action, around)
                there = select(is_inside & is_free, here + y * np.int32(stride) + x, here)
                there_x, there_y, _, _ = window(exit_table, there + there + offset, 0)
                stays = (there_x != ZERO) | (there_y != ZERO)
                scatter(grid, here, fill(FREE))
                scatter(grid, there, select(stays, BLOCKED, FREE))
                store(cells, agent * LANES, there)
                store(nearest, 2 * agent * LANES, there_x)
                store(nearest, (2 * agent + 1) * LANES, there_y)
                remaining = remaining - select(is_inside, RIGHT, STILL) + select(stays, RIGHT, STILL)
        first_out = select((remaining == STILL) & (first_out == np.int32(steps)), np.int32(round_), first_out)
        if not any_of(remaining != STILL):
            break
    store(first_all_out, 0, first_out)


@inline(counts=False)
def begin_lanes(  # type: ignore[no-untyped-def]  # compiled
    first, parameters, participants, field_of_trial, free, to_exit, starts, packed, grid, cells, nearest, offsets
):
    """Put eight trials into the lanes; the last trial of the batch into those that are left."""
    count, agents = free.shape[1], starts.shape[1]
    for lane in range(LANES):
        trial = min(first + lane, field_of_trial.shape[0] - 1)
        field = field_of_trial[trial]
        for number in range(parameters.shape[1]):
            packed[number * LANES + lane] = parameters[participants[trial, 0], number]
        for cell in range(count):
            grid[lane * count + cell] = free[field, cell]
        offsets[lane] = field * to_exit.shape[1] - 2 * lane * count
        for agent in range(agents):
            cell = starts[field, agent]
            grid[lane * count + cell] = BLOCKED
            cells[agent * LANES + lane] = lane * count + cell
            nearest[2 * agent * LANES + lane] = to_exit[field, 2 * cell]
            nearest[(2 * agent + 1) * LANES + lane] = to_exit[field, 2 * cell + 1]


@kernel(
    void(STEP, GRIDS, array(int64, 2), array(int64), GRIDS, GRIDS, CELL_TABLE, GRIDS, int64, int64,
         array(int64), array(float64, 2), array(float64, 2))
)  # fmt: skip
def play_side_by_side(  # type: ignore[no-untyped-def]  # compiled
    step, parameters, participants, field_of_trial, free, to_exit, starts, states, stride, steps,
    progress, fitness, metrics,
):  # fmt: skip
    """Trials of a batch, eight side by side; each lane has a field of its own, one behind the other in ``grid``."""
    agents, count = starts.shape[1], free.shape[1]
    exit_table = to_exit.reshape(to_exit.size)
    packed = np.empty(parameters.shape[1] * LANES, np.float32)
    grid = np.empty(count * LANES + 4, np.float32)  # windows of the last cells reach behind them
    cells, nearest = np.empty(agents * LANES, np.int32), np.empty(2 * agents * LANES, np.float32)
    offsets, first_out = np.empty(LANES, np.int32), np.empty(LANES, np.int32)
    observation, action = np.empty(INPUTS * LANES, np.float32), np.empty(OUTPUTS * LANES, np.float32)
    last_cells, inside = np.empty(agents, np.int32), np.empty(agents, np.uint8)
    for first in range(0, field_of_trial.shape[0], LANES):
        progress[0] = first
        if progress[1] != 0:
            return
        begin_lanes(first, parameters, participants, field_of_trial, free, to_exit, starts, packed, grid, cells, nearest, offsets)
        states[:] = 0
        play_rounds_of_lanes(
            step, packed, states, exit_table, offsets, grid, cells, nearest, observation, action, stride, steps, first_out
        )
        for trial in range(first, min(first + LANES, field_of_trial.shape[0])):
            lane = trial - first
            for agent in range(agents):
                at = agent * LANES + lane
                last_cells[agent] = cells[at] - lane * count
                inside[agent] = nearest[at + agent * LANES] != ZERO or nearest[at + (agent + 1) * LANES] != ZERO
            judge(
                last_cells,
                inside,
                to_exit[field_of_trial[trial]],
                np.int64(first_out[lane]),
                steps,
                fitness[trial],
                metrics[trial],
            )
