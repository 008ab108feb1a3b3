"""Arena: robots on two wheels in a square room, for the classic tasks of swarm robotics.

The world stands in ``arena_world``, the tasks in ``arena_tasks``.
"""

from typing import Annotated, Literal

import msgspec
import numpy as np
from msgspec import Meta

from zswarm.errors import ConfigError
from zswarm.jit import STEP, Step, array, float32, float64, inline, int32, int64, kernel, uint64, void
from zswarm.lanes import LANES, load, select, store, window
from zswarm.portable import PI, atan2
from zswarm.sims.arena_tasks import (
    CARRIES,
    CONTACTS,
    METRICS,
    ROWS,
    STEP_NUMBER,
    TALLIES,
    TASK_ACTUATORS,
    TASK_SENSORS,
    TASKS,
    TRUTH,
    happen,
    judge,
    measure,
    sense_task,
    start,
)
from zswarm.sims.arena_world import (
    COUNT,
    HEADING_X,
    HEADING_Y,
    PLACE_ROWS,
    QUEUE_ROWS,
    RAYS,
    SAID,
    X,
    Y,
    cells_per_side,
    drive,
    look,
)
from zswarm.sims.simulator import Batch, Body, CompiledSimulator, Frame, Label, Outcome, Place, Ray, Turn

ITEM_RADIUS = 0.05  # m, in pictures
ABOUT = 0.1  # of the truth: who says so, says what is true

Metres = Annotated[float, Meta(ge=1e-3, le=1e4)]


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of ``[problem.settings]``."""

    task: Annotated[
        Literal["aggregation", "dispersion", "foraging", "consensus"], Meta(description="what the robots are to do")
    ] = "aggregation"
    steps: Annotated[int, Meta(ge=1, le=1_000_000, description="steps of a trial")] = 500
    step_s: Annotated[float, Meta(gt=0, le=10, description="s of a step")] = 0.1
    robots: Annotated[int, Meta(ge=1, le=1_000, description="robots")] = 16
    side: Annotated[Metres, Meta(description="m, of the square room")] = 4.0
    sight: Annotated[Metres, Meta(description="m up to which a robot senses others, walls and items")] = 1.2
    radius: Annotated[Metres, Meta(description="m, of a robot; its wheels are 2 `radius` apart")] = 0.1
    speed: Annotated[float, Meta(ge=0, le=1e3, description="m/s of a wheel at most")] = 0.3
    items: Annotated[int, Meta(ge=1, le=1_000, description="items that lie about (foraging)")] = 8
    nest: Annotated[Metres, Meta(description="m, how wide the nest along the left wall is (foraging)")] = 0.5
    noise: Annotated[float, Meta(ge=0, le=1e3, description="readings differ from the truth by so much at most (consensus)")] = 0.5


class Arena(CompiledSimulator):
    """Round robots in a square room; what they are to do is a setting.

    Lengths are in m, x to the right, y downwards. Numbers are float32, each operation is rounded to it, from the left; sums
    begin with 0 and are in index order; float64 where it is said. (h, k) is a robot's heading, a unit vector. What lies (dx, dy)
    from it lies (dx h + dy k, dy h - dx k) in its frame. cut(o) is o cut to 0..1 (NaN: 0), r is ``radius``, s is .70710678.

    Neighbours of a robot have their centre nearer than ``sight``: dx dx + dy dy < ``sight`` ``sight``. Where there are many,
    they are added in the order of c x c square cells, row by row, and by index in each; c = min(int(.999 ``side`` / ``sight``),
    int(root of ``robots``)), 1 if below 3; row and column are int(y (c / ``side``)) and int(x (c / ``side``)), at most c - 1.

    Observation: 0-7: 1 - d (1 / ``sight``) of rays from the centre, in the robot's frame to (u, v) = (1, 0), (s, s), (0, 1),
        (-s, s), (-1, 0), (-s, -s), (0, -1), (s, -s). d is the least of ``sight``, walls and neighbours. Walls: with (h u - k v,
        k u + h v) the ray's direction in the room, the way to the wall before it in x, and in y, is what is left to the wall,
        ahead where the part is above 0, through max(abs(part), 1e-6). Neighbours: at (a, b) in the frame, with m = a u + b v, n
        = b u - a v and q = r r - n n: m - root(q) where m and q are above 0.
        8-9: mean place of the neighbours in the frame: their sums times ((1 / ``sight``) / number); zeros without any.
        foraging: 10-11: place of the nearest item in sight (the first of equals) in the frame / max(way to it, r), zeros without
        any; 12-13: the direction of the nest, (-h, k); 14: 1 if it carries an item, else 0.
        consensus: 10: its reading; 11: the mean of what its neighbours said in the step before, without any what it said itself.
    Action: 0-1: left and right wheel, each 2 cut(o) - 1 of ``speed``. consensus: 2: it says cut(o).
    Turns: all robots at once, seeing the state before the step. A step (they count from 1):
        1. If 2 step > ``steps``, what the fitness needs is measured, of the state that was observed.
        2. Robots turn and drive. With w = ``speed`` ``step_s`` / 2 (float64, then rounded) and t = (right - left) (w / (2 r),
        rounded alike): cos = (1 - t t) (1 / (1 + t t)), sin = (t + t) (1 / (1 + t t)). The heading is (cos h - sin k, cos k +
        sin h), times 1.5 - .5 of its square, which keeps its length. The centre moves by (left + right) w along it, then by
        pushes: two whose squared distance was below (2 r) (2 r) when they observed are pushed apart, by the sum over neighbours
        of - (.5 (2 r - d) / max(d, 1e-6)) dx, y likewise, d their distance. Walls keep it r away.
        3. foraging, robot after robot: in the nest (x < ``nest``) one that carries delivers; one that does not and has an item
        nearer than r finds it (the first), and another appears as at the start. consensus: they say what they say.
    Start: from ``Stream(seed)`` of zswarm.draws; draw(a, b) = a + i 2^-24 (b - a), i = integer(2^24). Per robot x and y from r
        to ``side`` - r (dispersion: in the middle half of that, each end moved by .5 .5 of it), and its heading: two draws from
        -1 to 1 until their square is in .01..1, through its root. consensus: the truth from 0 to 1, then per robot its reading,
        the truth + draw(- ``noise``, ``noise``); it has said cut(reading). foraging: per item x from ``nest`` and y from r, to
        ``side`` - r.
    End: after ``steps`` steps.
    Fitness (float64 but for means over robots; other means are over the measured steps):
        aggregation: 1 - spread / (.3826 ``side``): 0 for many strewn evenly, 1 in one point. spread: mean distance to the
        mean place. dispersion: nearest / ``sight``. nearest: mean distance to the nearest neighbour, ``sight`` without any.
        foraging: (delivered + found) / 2. consensus: 1 - 4 error: 0 on average for whoever says .5. error: mean distance of what
        is said from the truth.
    Metrics: those, and aggregation, dispersion: ``neighbours``, their mean number; consensus: ``disagreement``, the mean
        distance of what is said from its mean. All: ``contacts``, the mean number of pairs that overlap, over all steps.
    """

    settings_type = Settings
    settings: Settings

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings)
        room = settings.side - 2 * settings.radius
        if room <= 0:
            raise ConfigError(f"arena: a robot of radius {settings.radius:g} does not fit in a room of side {settings.side:g}")
        if settings.sight < 2 * settings.radius:
            raise ConfigError(
                f"arena: sight {settings.sight:g} must be at least 2 radius, {2 * settings.radius:g}: "
                "robots that touch see each other"
            )
        if settings.task == "foraging" and not settings.radius < settings.nest < settings.side - settings.radius:
            raise ConfigError(
                f"arena: nest {settings.nest:g} must be between radius {settings.radius:g} and side - radius, "
                f"{settings.side - settings.radius:g}: robots come in, and items lie outside"
            )
        self.task = TASKS.index(settings.task)
        self.sensors = (*(f"ray_{45 * ray}" for ray in range(8)), "others_ahead", "others_aside", *TASK_SENSORS[settings.task])
        self.actuators = ("left", "right", *TASK_ACTUATORS[settings.task])
        self.inputs, self.outputs = len(self.sensors), len(self.actuators)
        self.metrics = METRICS[settings.task]
        self.owners = (0,) * settings.robots
        self._per_side = cells_per_side(settings.side, settings.sight, settings.robots)
        half_stride = settings.speed * settings.step_s / 2
        self._lengths = np.array(
            [
                settings.side,
                settings.sight,
                settings.radius,
                half_stride,
                half_stride / (2 * settings.radius),
                self._per_side / settings.side,
                settings.nest,
                settings.noise,
            ],
            np.float32,
        )

    def reset(self, seed: int) -> Turn:
        """Lay out the start of a seed; all robots act next."""
        self._robots, self._queue, self._places, self._cells, self._items, self._stream, self._tally = self._tables()
        start(np.uint64(seed), self.task, self._robots, self._items, self._stream, self._tally, self._lengths)
        return self._turn()

    def step(self, actions: np.ndarray) -> Turn | None:
        """Let the robots drive; all act next."""
        turned = np.ascontiguousarray(actions.T)
        act(self.task, self.settings.steps, turned, self._robots, self._items, self._stream, self._tally, self._lengths)
        return self._turn() if self._tally[STEP_NUMBER] < self.settings.steps else None

    def outcome(self) -> Outcome:
        """Fitness and metrics of the trial that ended."""
        fitness, metrics = np.zeros(1), np.zeros(3)
        judge(self.task, self._tally, self._lengths, fitness, metrics)
        return Outcome(list(fitness), list(metrics))

    def frame(self) -> Frame:
        """The room; robots that carry something, and those that say what is true or not, are of another kind."""
        s = self.settings
        robots, items = self._robots.tolist(), self._items.tolist()
        headings = [float(atan2(y, x)) for x, y in zip(robots[HEADING_X], robots[HEADING_Y], strict=True)]
        places, labels = [], []
        kinds = ["robot with an item" if carries else "robot" for carries in robots[CARRIES]]
        if s.task == "foraging":
            places = [Place("nest", 0, 0, s.nest, s.side)]
        elif s.task == "consensus":
            truth = float(self._tally[TRUTH])
            kinds = [_says(said - truth) for said in robots[SAID]]
            labels = [Label(f"the truth is {truth:.2f}", s.side / 2, 0.05 * s.side, 0.04 * s.side)]
        bodies = [
            Body(kind, x, y, s.radius, heading) for kind, x, y, heading in zip(kinds, robots[X], robots[Y], headings, strict=True)
        ]
        bodies += [Body("item", x, y, ITEM_RADIUS, shape="square") for x, y in zip(items[X], items[Y], strict=True)]
        rays = [Ray(number, number * PI / 4, s.sight, 0.0) for number in range(8)]
        return Frame(s.side, s.side, places, bodies, labels=labels, rays=rays)

    def play(self, step: Step, batch: Batch) -> None:
        """See ``CompiledSimulator.play``."""
        self._play(step, 1, batch)

    def play_lanes(self, step_lanes: Step, step: Step, batch: Batch) -> None:  # noqa: ARG002  eight at once take as long as two
        """See ``CompiledSimulator.play_lanes``: eight robots of a trial decide at once."""
        self._play(step_lanes, LANES, batch)

    def _play(self, step: Step, together: int, batch: Batch) -> None:
        """So many robots decide together."""
        robots, sizes = self.settings.robots, (batch.parameters.shape[1], self.inputs + 3, self.outputs)
        states = np.zeros((-(-robots // together), together * batch.state_size), np.float32)
        controller, seen, said = (np.empty(size * together, np.float32) for size in sizes)
        observations = np.zeros(robots * self.inputs + 3, np.float32)  # three more, as in ``seen``: four are read at once
        actions = np.empty((self.outputs, robots), np.float32)
        play_trials(
            step, together, self.inputs, batch.parameters, batch.participants, batch.seeds, controller, states, seen, said,
            observations, actions, *self._tables(), self._lengths, RAYS, self._per_side, self.task, self.settings.steps,
            batch.progress, batch.fitness, batch.metrics,
        )  # fmt: skip

    def _tables(self) -> tuple[np.ndarray, ...]:
        """Robots, queue, places, cells, items, stream and tally, for ``start`` to fill."""
        number = self.settings.robots
        items = self.settings.items if self.settings.task == "foraging" else 0
        return (
            np.zeros((ROWS, number), np.float32),
            np.zeros((QUEUE_ROWS, number + LANES), np.float32),
            np.zeros((PLACE_ROWS, number + LANES), np.int32),
            np.zeros(self._per_side**2 + 2, np.int32),
            np.zeros((2, items), np.float32),
            np.zeros(1, np.uint64),
            np.zeros(TALLIES),
        )

    def _turn(self) -> Turn:
        observations = np.empty(self.settings.robots * self.inputs, np.float32)
        self._tally[CONTACTS] += look(
            self._robots, self._queue, self._places, self._cells, self._per_side, RAYS, self._lengths, observations
        )
        sense_task(self.task, self._robots, self._items, self._lengths, observations)
        return Turn(range(self.settings.robots), observations.reshape(self.settings.robots, self.inputs))


def _says(off: float) -> str:
    """What to call a robot that says so much more than what is true."""
    return "robot, says it about right" if abs(off) <= ABOUT else "robot, says too much" if off > 0 else "robot, says too little"


@inline(counts=False, inner=True)
def decide(step, together, inputs, controller, states, seen, said, observations, actions):  # type: ignore[no-untyped-def]  # compiled
    """Ask the controllers of all robots; so many decide together, the last one again where there are fewer."""
    outputs, robots = actions.shape
    for group in range(states.shape[0]):
        first = group * together
        if together == 1:
            for number in range(inputs):
                seen[number] = observations[inputs * first + number]
        else:  # rows become columns, four at once
            lanes = load(COUNT, 0) + first
            rows = select(lanes < robots, lanes, robots - 1) * inputs
            for number in range(0, inputs, 4):
                columns = window(observations, rows, number)
                store(seen, number * LANES, columns[0])
                store(seen, (number + 1) * LANES, columns[1])
                store(seen, (number + 2) * LANES, columns[2])
                store(seen, (number + 3) * LANES, columns[3])
        step(controller, states[group], seen[: inputs * together], said)
        for number in range(outputs):
            if first + LANES <= robots and together == LANES:
                store(actions[number], first, load(said, number * LANES))
            else:
                for lane in range(min(together, robots - first)):
                    actions[number, first + lane] = said[number * together + lane]


@inline(counts=False)
def act(task, steps, actions, robots, items, stream, tally, lengths):  # type: ignore[no-untyped-def]  # compiled
    """One step, given the actions of all robots."""
    tally[STEP_NUMBER] += 1.0
    if 2.0 * tally[STEP_NUMBER] > steps:
        measure(task, robots, tally)
    drive(actions, robots, lengths)
    happen(task, actions, robots, items, stream, tally, lengths)


GRIDS = array(float32, 2)
NUMBERS = array(float32)


@kernel(
    void(STEP, int64, int64, GRIDS, array(int64, 2), array(uint64), NUMBERS, GRIDS, NUMBERS, NUMBERS, NUMBERS, GRIDS, GRIDS,
         GRIDS, array(int32, 2), array(int32), GRIDS, array(uint64), array(float64), NUMBERS, NUMBERS, int64, int64, int64,
         array(int64), array(float64, 2), array(float64, 2))
)  # fmt: skip
def play_trials(  # type: ignore[no-untyped-def]  # compiled
    step, together, inputs, parameters, participants, seeds, controller, states, seen, said, observations, actions, robots, queue,
    places, cells, items, stream, tally, lengths, rays, per_side, task, steps, progress, fitness, metrics,
):  # fmt: skip
    """All trials of a batch, see ``CompiledSimulator.play``; ``step`` decides for so many robots together."""
    rows = observations[: inputs * robots.shape[1]]
    for trial in range(seeds.shape[0]):
        progress[0] = trial
        if progress[1] != 0:
            return
        for number in range(parameters.shape[1]):
            for lane in range(together):
                controller[number * together + lane] = parameters[participants[trial, 0], number]
        states[:] = 0
        start(seeds[trial], task, robots, items, stream, tally, lengths)
        for _ in range(steps):
            tally[CONTACTS] += look(robots, queue, places, cells, per_side, rays, lengths, rows)
            sense_task(task, robots, items, lengths, rows)
            decide(step, together, inputs, controller, states, seen, said, observations, actions)
            act(task, steps, actions, robots, items, stream, tally, lengths)
        judge(task, tally, lengths, fitness[trial], metrics[trial])
