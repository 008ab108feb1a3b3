"""Play a recorded trial again and watch it, round by round (docs/replay.md).

Computing is the same everywhere, so a record needs no positions: genomes and seeds reproduce them
bit for bit. Fitness and metrics are compared with the record.
"""

import copy
import itertools
import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from hashlib import blake2b
from typing import Any

import numpy as np

from zswarm.errors import ConfigError, EvaluationError
from zswarm.evaluate import turns
from zswarm.nets.representation import Representation
from zswarm.ot.problem import Problem
from zswarm.ot.record.reader import Run
from zswarm.ot.record.selection import (
    available,
    candidate_of,
    genome_of,
    place_of,
)
from zswarm.plugins.used_settings import used_settings
from zswarm.plugins.version_hash import version_hash
from zswarm.sims import randomized
from zswarm.sims.simulator import Frame, Outcome, Simulator
from zswarm.system.text import clean

# Of a trial; of a longer one every second frame is dropped, repeatedly.
MOST_FRAMES = 20_000
MOST_POSITIONS = 400_000  # of all bodies in these frames, some 100 MB
MOST_NUMBERS = 8_000_000  # of agents' inputs, outputs and neurons, 32 MB
DIGEST = 16  # bytes of a genome's hash


@dataclass(frozen=True)
class Trace:
    """A trial. Frame i shows the state before round i * ``every``, the last one that at the end.

    Attributes:
        frames: empty if the simulator draws nothing that can be shown.
        every: rounds per frame: more than 1 in long trials.
        rounds: of the trial; in a round each agent acts at most once.
        inputs, outputs, hidden: (frames - 1, agents, numbers) float32: what agents observed and
            set, and their hidden neurons after that; NaN if an agent did not act.
        sensors, actuators, neurons: names of these numbers.
        owners: for each agent the participant that drives it.
        fitness: of each participant; NaN if the trial failed.
        metrics: by name.
        error: why the trial failed, or "".
        no_picture: what the simulator's ``frame`` raised, or "".
        about: run, candidate and settings, for people.
        note: how the trial differs from the recorded one, or "".
    """

    frames: Sequence[Frame]
    every: int
    rounds: int
    inputs: np.ndarray
    outputs: np.ndarray
    hidden: np.ndarray
    sensors: Sequence[str]
    actuators: Sequence[str]
    neurons: Sequence[str]
    owners: Sequence[int]
    fitness: Sequence[float]
    metrics: dict[str, float]
    error: str = ""
    no_picture: str = ""
    about: dict[str, Any] = field(default_factory=dict)
    note: str = ""

    def at(self, number: int) -> int:
        """Return the round before a frame, ``rounds`` for the last frame."""
        return min(number * self.every, self.rounds)


def trace(
    run: Run, generation: int | None = None, candidate: int | None = None, trial: int = 0
) -> Trace:
    """Play a trial of a recorded candidate again.

    Args:
        generation: a finished one, from 0; None: the one that found the best.
        candidate: from 0, in the order asked; None: the best. Without both: the champion.
        trial: from 0; in tournaments it counts through all games of the candidate.

    Raises:
        ConfigError: the run has no such trial, or this program computes it differently.
        EvaluationError: the simulator's program ended.
    """
    generation, candidate = place_of(run, generation, candidate)
    candidates = {one["candidate"]: one for one in run.candidates(generation)}
    candidate = candidate_of(run, generation, candidates, candidate)
    problem = Problem(run.experiment)
    what = f"trial {trial} of candidate {candidate} in generation {generation + 1}"
    recorded = _recorded(run, problem, (generation, candidate, trial), what)
    players = recorded.get("candidates", [candidate])
    number = recorded.get("trial", trial)
    seed = int(problem.trial_seeds(generation)[number])
    for player in players:
        if player not in candidates:
            why = f"candidate {player} played in generation {generation + 1}, and has no genome"
            raise ConfigError(f"{run.shown}: damaged: {why}")
    genomes = [genome_of(run, generation, candidates, player) for player in players]
    try:
        found = record(problem.simulator, problem.representation, genomes, seed)
    except ValueError as error:
        why = f"a genome does not fit its network: {error}"
        raise ConfigError(f"{run.shown}: damaged: {why}") from None
    simulator = run.experiment.problem.simulator
    settings = randomized.drawn(run.experiment.problem.settings, seed)
    network = run.experiment.representation.kind
    theirs, ours = run.meta.get("version_hash"), version_hash(simulator, network)
    note = _difference(found, recorded)
    if note and theirs != ours:
        code = f"computed by other code (version hash {theirs}, here {ours})"
        raise ConfigError(f"{run.shown}: {code}, and {what} differs: {note}")
    about = {
        "run": run.name,
        "generation": generation,
        "candidate": candidate,
        "trial": trial,
        "simulator": simulator,
        "settings": used_settings("simulator", simulator, settings),
        "network": network,
        "seed": str(seed),
        "genome": [blake2b(genome, digest_size=DIGEST).hexdigest() for genome in genomes],
        **({"players": players} if len(players) > 1 else {}),
    }
    return replace(found, about=about, note=note)


def record(
    simulator: Simulator,
    representation: Representation,
    genomes: Sequence[bytes],
    seed: int,
    most_turns: int | None = None,
) -> Trace:
    """Play a trial and watch it; of one that fails, up to there.

    Args:
        genomes: of the participants.
        most_turns: stop after this many turns.

    Raises:
        ValueError: a genome does not fit the network.
        EvaluationError: the simulator's program ended.
    """
    parameters = representation.parameters(genomes)
    watched = _Watched(simulator, representation)
    outcome = Outcome(
        [math.nan] * simulator.participants, [math.nan] * len(simulator.metrics)
    )
    error = ""
    try:
        played = turns(simulator, watched.network(), parameters, seed)
        for turn in itertools.islice(played, most_turns):
            watched.begin_turn(turn.agents)
        watched.end()
        if most_turns is None:
            outcome = Outcome(*([*map(_finite, part)] for part in simulator.outcome()))
    except (EvaluationError, MemoryError):
        raise
    except (Exception, SystemExit) as raised:
        # What a simulator raises is the trial's outcome.
        error = clean(f"{type(raised).__name__}: {raised}")
    inputs, outputs, hidden = watched.numbers()
    return Trace(
        frames=watched.frames if _drawable(watched.frames) else [],
        every=watched.every,
        rounds=watched.rounds,
        inputs=inputs,
        outputs=outputs,
        hidden=hidden,
        sensors=named(simulator.sensors, "input", simulator.inputs),
        actuators=named(simulator.actuators, "output", simulator.outputs),
        neurons=named((), "hidden", len(representation.hidden_at)),
        owners=list(simulator.owners),
        fitness=outcome.fitness,
        metrics=dict(zip(map(clean, simulator.metrics), outcome.metrics, strict=True)),
        error=error,
        no_picture=watched.no_picture,
    )


class _Watched:
    """The frames and numbers of a trial that is being played."""

    def __init__(self, simulator: Simulator, representation: Representation) -> None:
        self.simulator, self.representation = simulator, representation
        self.width = simulator.inputs + simulator.outputs + len(representation.hidden_at)
        self.frames: list[Frame] = []
        self.no_picture = ""
        self.every, self.rounds = 1, 0
        self._numbers: list[np.ndarray] = []  # (agents, width) float32 each
        self._now = np.empty((0, self.width), np.float32)
        self._acting: list[int] = []  # agents of this turn that have not decided yet
        self._acted: set[int] = set()

    def network(self) -> Representation:
        """Return the network, whose decisions are watched."""
        network, decide = copy.copy(self.representation), self.representation.step
        hidden = slice(
            self.representation.hidden_at.start, self.representation.hidden_at.stop
        )

        def step(
            parameters: np.ndarray,
            state: np.ndarray,
            observation: np.ndarray,
            output: np.ndarray,
        ) -> None:
            decide(parameters, state, observation, output)
            self._now[self._acting.pop(0)] = np.concatenate(
                (observation, output, state[hidden])
            )

        network.step = step
        return network

    def begin_turn(self, agents: Sequence[int]) -> None:
        """Watch these agents act; a round ends when an agent is about to act a second time."""
        if not self._numbers or not self._acted.isdisjoint(agents):
            self.rounds += bool(self._numbers)
            self._now = np.full(
                (len(self.simulator.owners), self.width), np.nan, np.float32
            )
            if self.rounds % self.every == 0 or not self._numbers:
                self._add()
            self._acted.clear()
        self._acted.update(agents)
        self._acting = list(agents)

    def end(self) -> None:
        """Draw the last frame."""
        self.rounds += 1
        self._draw()

    def numbers(self) -> list[np.ndarray]:
        """Return inputs, outputs and hidden neurons: (rounds, agents, numbers) each."""
        table = np.stack(self._numbers or [self._now])[: len(self._numbers)]
        inputs, outputs = self.simulator.inputs, self.simulator.outputs
        return np.split(table, (inputs, inputs + outputs), axis=2)

    def _add(self) -> None:
        self._draw()
        self._numbers.append(self._now)
        count = len(self._numbers)
        bodies = len(self.frames[-1].bodies) if self.frames else 0
        too_many = count >= MOST_FRAMES or count * bodies >= MOST_POSITIONS
        if too_many or count * self._now.size >= MOST_NUMBERS:
            self.frames, self._numbers = self.frames[::2], self._numbers[::2]
            self.every *= 2

    def _draw(self) -> None:
        if self.no_picture:
            return
        try:
            if (frame := self.simulator.frame()) is not None:
                self.frames.append(frame)
        except Exception as raised:  # a plug-in may raise anything; the trial continues
            self.frames, self.no_picture = [], clean(f"{type(raised).__name__}: {raised}")


def _recorded(
    run: Run, problem: Problem, number: tuple[int, int, int], what: str
) -> dict[str, Any]:
    """Return a trial of the record, {} if it has none; raise ConfigError if the run has none."""
    generation, candidate, trial = number
    trials = _trials(run, generation, candidate)
    by_number = {one["trial"]: one for one in trials}
    count = problem.experiment.problem.trials
    if problem.simulator.participants > 1:
        by_number, count = dict(enumerate(trials)), len(trials)
    if not 0 <= trial < count:
        raise ConfigError(f"{run.shown}: no {what}; {available('trial', count)}")
    return by_number.get(trial, {})


def _trials(run: Run, generation: int, candidate: int) -> list[dict[str, Any]]:
    """Return the recorded trials of a candidate, those of all its games."""
    return [
        one
        for one in run.trials(generation)
        if candidate in one.get("candidates", (one.get("candidate"),))
    ]


def count_trials(run: Run, generation: int, candidate: int | None) -> int:
    """Return how many trials of a candidate can be played again; None: of the best.

    Raises:
        ConfigError: the run has no such candidate.
    """
    count = run.experiment.problem.trials
    if Problem(run.experiment).simulator.participants == 1:
        return count
    candidates = {one["candidate"]: one for one in run.candidates(generation)}
    candidate = candidate_of(run, generation, candidates, candidate)
    return len(_trials(run, generation, candidate))


def _difference(found: Trace, recorded: dict[str, Any]) -> str:
    """Describe the first difference in bits from a recorded trial, or return ""."""
    if not recorded:
        return ""
    old = [*recorded["fitness"], *recorded["metrics"].values()]
    new = [*found.fitness, *found.metrics.values()]
    names = [*["fitness"] * len(found.fitness), *found.metrics]
    if len(old) != len(new):
        return f"{len(old)} numbers are recorded, and {len(new)} are played"
    for name, value, other in zip(names, old, new, strict=True):
        one = math.nan if value is None else value
        if struct.pack("<d", one) != struct.pack("<d", other):
            return f"the record has {name} {one!r}, and it is {other!r} when it is played again"
    return ""


def _finite(value: float) -> float:
    return float(value) if math.isfinite(value) else math.nan


def named(names: Sequence[str], what: str, count: int) -> list[str]:
    """Return the names of numbers, or numbered ones if these are not as many."""
    if len(names) == count and count:
        return list(map(clean, names))
    return [f"{what} {i + 1}" for i in range(count)]


def _drawable(frames: Sequence[Frame]) -> bool:
    """Return whether all frames are valid and have equally many bodies and lines."""
    if not frames:
        return False
    first = frames[0]
    counts = len(first.bodies), len(first.lines)
    numbers: list[Any] = [first.width, first.height]
    for frame in frames:
        if (
            min(frame.width, frame.height) <= 0
            or (len(frame.bodies), len(frame.lines)) != counts
        ):
            return False
        for body in frame.bodies:
            numbers += (body.x, body.y, body.radius, body.heading or 0.0)
    for drawn in (
        *first.places,
        *(one for frame in frames for one in (*frame.lines, *frame.labels)),
    ):
        numbers += drawn[1:]
    return all(map(math.isfinite, numbers))
