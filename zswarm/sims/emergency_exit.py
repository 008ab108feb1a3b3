"""Emergency exit on a grid, exactly as FREVO's ``EmergencyExit``.

FREVO is at github.com/smartgrids-aau/Frevo; this is its version 1.5. Every constant and every order
of operations is FREVO's; recorded runs of it are part of the tests. ``exit_fields`` lays out the
fields, ``exit_lanes`` plays eight trials in parallel.
"""

# mypy: disable-error-code=no-untyped-def
# because numba infers the types of kernels.

from collections.abc import Sequence
from typing import Annotated, Literal

import numpy as np
from msgspec import Meta

from zswarm.config.meta import PartSettings, about, only_with, within
from zswarm.errors import ConfigError
from zswarm.kernels.jit import STEP, Step, inline, int64, kernel, void
from zswarm.kernels.lanes import LANES
from zswarm.kernels.portable import PI
from zswarm.kernels.signatures import Int64s
from zswarm.sims.exit_fields import BLOCKED, FREE, Fields, RandomFields, Stadium
from zswarm.sims.exit_lanes import play_lanes
from zswarm.sims.exit_rules import INPUTS, OUTPUTS, Room, judge, rounded
from zswarm.sims.simulator import (
    Body,
    CompiledSimulator,
    Frame,
    KernelBatch,
    Outcome,
    Ray,
    Rectangle,
    Turn,
)

LANES_REACH = 2**31  # lanes find a cell by a 32-bit index
# Trials from which on playing eight in parallel is faster than one after the other.
FEWEST = 2

Length = Annotated[int, Meta(ge=1, le=1_000)]
RANDOM = only_with(field="random")
RUNS = -1  # in place of a seed: trials have those of the run


class EmergencyExitSettings(PartSettings, frozen=True):
    """Settings of ``[problem.settings]``; ``width`` to ``seed`` describe the random field."""

    field: Annotated[
        Literal["random", "stadium"],
        about("fields drawn from the trial's seed, or FREVO's stadium with 72 agents"),
    ] = "random"
    steps: Annotated[int, within(1, 1_000_000, "rounds of a trial")] = 50
    width: Annotated[
        Length, about("cells of a random field; not above `height`"), RANDOM
    ] = 20
    height: Annotated[Length, about("cells of a random field"), RANDOM] = 20
    agents: Annotated[
        int, within(1, 1_000, "robots of a random field; the stadium has 72"), RANDOM
    ] = 10
    exits: Annotated[
        int, within(1, 10_000, "exits of a random field; the stadium has its own"), RANDOM
    ] = 5
    blockades: Annotated[
        int, within(0, 10_000, "blocked cells of a random field"), RANDOM
    ] = 20
    seed: Annotated[
        Annotated[int, Meta(ge=RUNS, lt=2**48)],
        about(
            "seed of the first field; trials have `seed`, `seed` + 1, ...; -1: the run's seeds, "
            "which may be fresh"
        ),
        RANDOM,
    ] = 0


class EmergencyExit(CompiledSimulator):
    """Robots in a room must leave through the nearest exit; they block one another.

    Observation: (10,) float32. 0-1: signed dx, dy to the exit nearest by Euclidean distance, in
        cells, not scaled.
        2-9: the cells N, NE, E, SE, S, SW, W, NW: 1 free, 0 wall, blockade, or an agent still
        inside; exits are free.
    Action: (2,) float32 x and y, each rounded from 2 o - 1: -1 from o = -0.25, 0 from 0.25, +1 from
        0.75; 0 below -0.25 and from 1.25 on. An agent does not move onto a blocked cell.
    Turns: one agent at a time, in index order; each sees the moves before it. An agent on an exit
    is out for good.
    Start: fields are drawn from the trial's seed (the standard generator of Java), or the stadium's
    72 agents.
    End: after ``steps`` rounds.
    Fitness: (steps - f) / steps - sum over agents of the distance to the nearest exit; f is the
        first round (from 0) after which all agents were out, else ``steps``. At most 1.
    Metrics: ``escaped`` agents; ``rounds`` until all were out (f + 1), or ``steps``.
    Trial seeds: ``seed``, ``seed`` + 1, ... of the settings, as in FREVO, unless it is -1; the
    stadium is the same for every seed.
    """

    settings_type = EmergencyExitSettings
    metrics = ("escaped", "rounds")
    inputs, outputs = INPUTS, OUTPUTS
    sensors = ("exit_dx", "exit_dy", "n", "ne", "e", "se", "s", "sw", "w", "nw")
    actuators = ("vx", "vy")
    settings: EmergencyExitSettings

    def __init__(self, settings: EmergencyExitSettings) -> None:
        super().__init__(settings)
        if settings.field == "stadium":
            self.fields: RandomFields = Stadium()
        else:
            counts = settings.agents, settings.exits, settings.blockades
            if settings.width > settings.height:
                raise ConfigError(
                    "emergency-exit: width must not exceed height: a random field draws both "
                    "coordinates from the width"
                )
            count = int(sum(counts))
            if count > settings.width**2:
                raise ConfigError(
                    f"emergency-exit: {count} agents, exits and blockades do not fit on "
                    f"{settings.width**2} cells"
                )
            self.fields = RandomFields(settings.width, settings.height, counts)
        self.owners = (0,) * self.fields.agents

    def fixed_seeds(self, trials: int) -> Sequence[int] | None:
        """Return consecutive seeds from the settings' ``seed`` on; None if it is -1."""
        first = self.settings.seed
        return None if first == RUNS else range(first, first + trials)

    def reset(self, seed: int) -> Turn:
        """Lay out the field of a seed; the first agent acts next."""
        (free,), (to_exit,), (cells,) = self.fields.lay_out(np.array([seed], np.uint64))
        free[cells] = BLOCKED
        inside = np.ones(len(cells), np.uint8)
        self._room = Room(free, to_exit, cells, inside, self.fields.stride)
        self._round = 0
        self._agent = 0
        self._first_all_out = self.settings.steps
        return self._turn()

    def step(self, actions: np.ndarray) -> Turn | None:
        """Move the agent of the last turn; the next one inside acts next."""
        act(self._room, self._agent, actions[0])
        inside = self._room.inside
        self._agent += 1
        while self._round < self.settings.steps:
            while self._agent < len(inside):
                if inside[self._agent]:
                    return self._turn()
                self._agent += 1
            if not inside.any() and self._first_all_out == self.settings.steps:
                self._first_all_out = self._round
            self._agent = 0
            self._round += 1
        return None

    def outcome(self) -> Outcome:
        """Return fitness and metrics of the trial that ended."""
        fitness = np.zeros(1)
        metrics = np.zeros(2)
        judge(self._room, self._first_all_out, self.settings.steps, fitness, metrics)
        return Outcome(list(fitness), list(metrics))

    def frame(self) -> Frame:
        """Draw the field in cells; agents that are out stay where they left."""
        room = self._room
        fields = self.fields
        agents = [
            (cell % room.stride - 1, cell // room.stride - 1)
            for cell in room.cells.tolist()
        ]
        exits = []
        blockades = []
        for y in range(fields.height):
            for x in range(fields.width):
                cell = fields.cell(x, y)
                if not room.to_exit[2 * cell : 2 * cell + 2].any():
                    exits.append(Rectangle("exit", x, y, 1, 1))
                if not room.free[cell] and (x, y) not in agents:
                    blockades.append(Rectangle("blockade", x, y, 1, 1))
        bodies = [
            Body("robot inside" if inside else "robot outside", x + 0.5, y + 0.5, 0.35)
            for (x, y), inside in zip(agents, room.inside, strict=True)
        ]
        rays = [Ray(2 + eighth, (eighth - 2) * PI / 4, 0.0, 1.0) for eighth in range(8)]
        return Frame(fields.width, fields.height, [*blockades, *exits], bodies, rays=rays)

    def play(self, step: Step, batch: KernelBatch) -> None:
        """See ``CompiledSimulator.play``."""
        self._play_from(0, self.fields.rows(batch.seeds), step, batch)

    def play_lanes(self, step_lanes: Step, step: Step, batch: KernelBatch) -> None:
        """See ``CompiledSimulator.play_lanes``: eight trials in parallel, one in each lane."""
        rows = self.fields.rows(batch.seeds)
        fields = self.fields
        remaining = len(rows) % LANES
        parallel = len(rows) if remaining >= FEWEST else len(rows) - remaining
        if 2 * fields.cached.to_exit.size + 2 * LANES * fields.cells >= LANES_REACH:
            parallel = 0
        if parallel:
            play_lanes(
                *(step_lanes, fields.cached, rows[:parallel], batch),
                *(fields.stride, self.settings.steps),
            )
        if parallel < len(rows):
            self._play_from(parallel, rows, step, batch)

    def _play_from(
        self, first: int, rows: np.ndarray, step: Step, batch: KernelBatch
    ) -> None:
        fields = self.fields
        steps = self.settings.steps
        play_trials(step, fields.cached, rows, batch, fields.stride, steps, first)

    def _turn(self) -> Turn:
        observation = np.empty((1, INPUTS), np.float32)
        observe(self._room, self._agent, observation[0])
        return Turn((self._agent,), observation)


@inline(counts=False)
def observe(room, agent, observation):
    """Write what an agent observes."""
    cell = room.cells[agent]
    free = room.free
    stride = room.stride
    observation[0] = room.to_exit[2 * cell]
    observation[1] = room.to_exit[2 * cell + 1]
    observation[2] = free[cell - stride]
    observation[3] = free[cell - stride + 1]
    observation[4] = free[cell + 1]
    observation[5] = free[cell + stride + 1]
    observation[6] = free[cell + stride]
    observation[7] = free[cell + stride - 1]
    observation[8] = free[cell - 1]
    observation[9] = free[cell - stride - 1]


@inline
def velocity(output):
    """Return -1, 0 or 1; an output that is rounded to another number, or NaN, means no move."""
    back, forth = rounded(output)
    return int(forth) - int(back)


@inline(counts=False)
def act(room, agent, action):
    """Move one agent if the cell is free, and let it out on an exit."""
    free = room.free
    to_exit = room.to_exit
    here = room.cells[agent]
    there = here + velocity(action[1]) * room.stride + velocity(action[0])
    if free[there] == BLOCKED:
        there = here
    free[here] = FREE
    room.cells[agent] = there
    if to_exit[2 * there] == 0 and to_exit[2 * there + 1] == 0:
        room.inside[agent] = 0
    else:
        free[there] = BLOCKED


@inline(counts=False)
def play_rounds(step, controller, states, room, observation, action, steps):
    """Return the first round after which all agents are out, or ``steps``."""
    remaining = states.shape[0]
    for round_ in range(steps):
        for agent in range(states.shape[0]):
            if room.inside[agent]:
                observe(room, agent, observation)
                step(controller, states[agent], observation, action)
                act(room, agent, action)
                remaining -= 1 - room.inside[agent]
        if remaining == 0:
            return round_
    return steps


@kernel(void(STEP, Fields, Int64s, KernelBatch, int64, int64, int64))
def play_trials(step, fields, rows, batch, stride, steps, first):
    """Play the trials of a batch from ``first`` on; ``rows`` are their fields.

    See ``CompiledSimulator.play``.
    """
    size = fields.free.shape[1]
    agents = fields.starts.shape[1]
    states = np.zeros((agents, batch.state_size), np.float32)
    observation = np.empty(INPUTS, np.float32)
    action = np.empty(OUTPUTS, np.float32)
    free = np.empty(size, np.float32)
    cells = np.empty(agents, np.int32)
    inside = np.empty(agents, np.uint8)
    for trial in range(first, rows.shape[0]):
        batch.progress[0] = trial
        if batch.progress[1] != 0:
            return
        field = rows[trial]
        room = Room(free, fields.to_exit[field], cells, inside, stride)
        controller = batch.parameters[batch.participants[trial, 0]]
        inside[:] = 1
        states[:] = 0
        for cell in range(size):  # copying whole arrays takes 2 s to compile
            free[cell] = fields.free[field, cell]
        for agent in range(agents):
            cells[agent] = fields.starts[field, agent]
            free[cells[agent]] = BLOCKED
        rounds = play_rounds(step, controller, states, room, observation, action, steps)
        judge(room, rounds, steps, batch.fitness[trial], batch.metrics[trial])
