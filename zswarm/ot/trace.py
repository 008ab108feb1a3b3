"""A trial, round by round: recomputed from a run's record, and kept in few bytes (docs/replay.md).

Computing is the same everywhere, so a record needs no positions: genomes and seeds give them again, bit for bit. That it is the
same trial is checked: fitness and metrics must be those of the record.
"""

import copy
import itertools
import json
import math
import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from hashlib import blake2b
from typing import Any, NamedTuple

import numpy as np

from zswarm import varied
from zswarm.errors import ConfigError, EvaluationError
from zswarm.evaluate import turns
from zswarm.nets.representation import Representation
from zswarm.ot.chosen import candidate_of, generation_of, numbered, shown
from zswarm.ot.problem import Problem
from zswarm.ot.reading import Run
from zswarm.protocol.codec import clean
from zswarm.sims.simulator import Frame, Simulator
from zswarm.version_hash import version_hash

MAGIC, VERSION = b"zswtrace", 1
MOST_FRAMES = 20_000  # that are kept of a trial
MOST_POSITIONS = 400_000  # of all bodies in them, some 100 MB
MOST_NUMBERS = 8_000_000  # that agents observed and set, and of their neurons; 32 MB
MOST_ENCODED = 150_000  # of these that are encoded, a byte each before they are packed
MOST_LABELS = 2_000  # changes of words that are encoded
TURN = 65_536  # steps of a heading in a full turn
STEPS = 65_535  # of a coordinate
LEVELS = 254  # of a number that agents observe and set, beside the one that means none
DIGEST = 16  # bytes of a genome's hash


@dataclass(frozen=True)
class Trace:
    """What happened in a trial. Frame number i shows the state before round i ``every``, the last one that after all rounds.

    Attributes:
        frames: pictures; none where the simulator draws nothing that can be shown.
        every: rounds from one frame to the next: more than 1 in long trials.
        rounds: of the trial; in a round each agent acts once at most.
        inputs, outputs, hidden: (frames - 1, agents, numbers) float32: what agents observed and set in the rounds of all frames
            but the last, and their hidden neurons after that; NaN for who did not act.
        sensors, actuators, neurons: names of these numbers.
        owners: per agent the participant that drives it.
        fitness: of each participant; NaN where the trial failed.
        metrics: by name.
        error: why it failed, or "".
        no_picture: what the simulator's ``frame`` raised, or "".
        about: where it is from, by names that people read.
        note: what is to be known before anybody trusts it, or "".
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
        """The round before which a frame is, ``rounds`` for the last."""
        return min(number * self.every, self.rounds)

    def encode(self) -> bytes:
        """A few bytes for the player: see docs/replay.md, "A trace's bytes"."""
        header, tracks = _header(self), _tracks(self)
        header["tracks"] = [track.said() for track in tracks]
        said = json.dumps(header, ensure_ascii=False, allow_nan=False, separators=(",", ":")).encode()
        packed = zlib.compress(b"".join(track.packed() for track in tracks), 9)
        return MAGIC + struct.pack("<II", VERSION, len(said)) + said + packed


def trace(run: Run, generation: int | None = None, candidate: int | None = None, trial: int = 0) -> Trace:
    """Play a trial of a recorded candidate again.

    Args:
        generation: a finished one, from 0; None: where the best was found.
        candidate: of it, in the order asked, from 0; None: the best.
        trial: of its trials, from 0; in tournaments those of all its games, one game after another.

    Raises:
        ConfigError: the run has no such trial, or this program computes it differently.
        EvaluationError: the simulator's program ended.
    """
    generation = generation_of(run, generation)
    candidates = {one["candidate"]: one for one in run.candidates(generation)}
    candidate = candidate_of(run, generation, candidates, candidate)
    problem = Problem(run.experiment)
    trials = [one for one in run.trials(generation) if candidate in one.get("candidates", (one.get("candidate"),))]
    count = len(trials) if problem.simulator.participants > 1 else problem.experiment.problem.trials
    what = f"trial {trial} of candidate {candidate} in generation {generation}"
    if not 0 <= trial < count:
        raise ConfigError(f"{shown(run)}: no {what}; {numbered('trial', count)}")
    if problem.simulator.participants > 1:
        recorded: dict[str, Any] | None = trials[trial]
        players, number = trials[trial]["candidates"], trials[trial]["trial"]
    else:
        recorded = next((one for one in trials if one["trial"] == trial), None)
        players, number = [candidate], trial
    seed = int(problem.trial_seeds(generation)[number])
    if missing := [player for player in players if player not in candidates]:
        raise ConfigError(f"{shown(run)}: damaged: candidate {missing[0]} played in generation {generation}, and has no genome")
    genomes = [candidates[player]["genome"] for player in players]
    try:
        found = record(problem.simulator, problem.representation, genomes, seed)
    except ValueError as error:
        raise ConfigError(f"{shown(run)}: damaged: a genome does not fit its network: {error}") from None
    network = run.experiment.representation.kind
    note = _difference(found, recorded)
    said = run.meta.get("version_hash")
    ours = version_hash(run.experiment.problem.simulator, network)
    if note and said != ours:
        raise ConfigError(f"{shown(run)}: computed by other code (version hash {said}, here {ours}), and {what} differs: {note}")
    about = {
        "run": run.name,
        "generation": generation,
        "candidate": candidate,
        "trial": trial,
        "simulator": run.experiment.problem.simulator,
        "settings": varied.drawn(run.experiment.problem.settings, seed),
        "network": network,
        "seed": str(seed),
        "genome": [blake2b(genome, digest_size=DIGEST).hexdigest() for genome in genomes],
    }
    if len(players) > 1:
        about["players"] = players
    return Trace(**{**found.__dict__, "about": about, "note": note})


def record(
    simulator: Simulator,
    representation: Representation,
    genomes: Sequence[bytes],
    seed: int,
    most_turns: int | None = None,
) -> Trace:
    """Play a trial and write down what happens; one that fails is there up to that.

    A frame is before each round: whenever an agent is about to act a second time. Of a long trial every second one is kept, or
    every fourth, and so on.

    Args:
        genomes: of the participants.
        most_turns: it is left after so many.

    Raises:
        ValueError: a genome does not fit the network.
        EvaluationError: the simulator's program ended.
    """
    parameters = representation.parameters(genomes)
    watched = _Watched(simulator, representation)
    fitness, metrics, error = [math.nan] * simulator.participants, [math.nan] * len(simulator.metrics), ""
    try:
        for turn in itertools.islice(turns(simulator, watched.network(), parameters, seed), most_turns):
            watched.look(turn.agents)
        watched.end()
        if most_turns is None:
            outcome = simulator.outcome()
            fitness, metrics = ([_finite(value) for value in values] for values in (outcome.fitness, outcome.metrics))
    except (EvaluationError, MemoryError):
        raise
    except (Exception, SystemExit) as raised:  # whatever the code of a simulator raises is the trial's outcome
        error = clean(f"{type(raised).__name__}: {raised}")
    hidden = len(representation.hidden_at)
    return Trace(
        frames=watched.frames if _drawable(watched.frames) else [],
        every=watched.every,
        rounds=watched.rounds,
        inputs=watched.part(0, simulator.inputs),
        outputs=watched.part(simulator.inputs, simulator.inputs + simulator.outputs),
        hidden=watched.part(simulator.inputs + simulator.outputs, watched.width),
        sensors=_named(simulator.sensors, "input", simulator.inputs),
        actuators=_named(simulator.actuators, "output", simulator.outputs),
        neurons=_named((), "hidden", hidden),
        owners=list(simulator.owners),
        fitness=fitness,
        metrics=dict(zip(map(clean, simulator.metrics), metrics, strict=True)),
        error=error,
        no_picture=watched.no_picture,
    )


class _Watched:
    """A trial under way, and what is kept of it."""

    def __init__(self, simulator: Simulator, representation: Representation) -> None:
        self.simulator, self.representation = simulator, representation
        self.width = simulator.inputs + simulator.outputs + len(representation.hidden_at)
        self.frames: list[Frame] = []
        self.no_picture = ""
        self.every, self.rounds = 1, 0
        self._numbers: list[np.ndarray] = []  # (agents, width) float32 each
        self._now = np.empty((0, self.width), np.float32)
        self._acting: list[int] = []  # the agents of this turn that have not decided yet
        self._acted: set[int] = set()

    def network(self) -> Representation:
        """The same, observed."""
        network, decide = copy.copy(self.representation), self.representation.step
        inputs, outputs, hidden = self.simulator.inputs, self.simulator.outputs, self.representation.hidden_at
        first = slice(hidden.start, hidden.stop)

        def step(parameters: np.ndarray, state: np.ndarray, observation: np.ndarray, output: np.ndarray) -> None:
            decide(parameters, state, observation, output)
            row = self._now[self._acting.pop(0)]
            row[:inputs], row[inputs : inputs + outputs], row[inputs + outputs :] = observation, output, state[first]

        network.step = step
        return network

    def look(self, agents: Sequence[int]) -> None:
        """These are about to act."""
        if not self._numbers or not self._acted.isdisjoint(agents):
            self.rounds += bool(self._numbers)
            self._now = np.full((len(self.simulator.owners), self.width), np.nan, np.float32)
            if self.rounds % self.every == 0 or not self._numbers:
                self._keep()
            self._acted.clear()
        self._acted.update(agents)
        self._acting = list(agents)

    def end(self) -> None:
        """The trial is over, or left."""
        self.rounds += 1
        self._picture()

    def part(self, begin: int, end: int) -> np.ndarray:
        """Some of the numbers of all rounds: (rounds, agents, end - begin)."""
        if not self._numbers:
            return np.empty((0, 0, end - begin), np.float32)
        return np.stack([numbers[:, begin:end] for numbers in self._numbers])

    def _keep(self) -> None:
        self._picture()
        self._numbers.append(self._now)
        kept, bodies = len(self._numbers), len(self.frames[-1].bodies) if self.frames else 0
        if kept >= MOST_FRAMES or kept * bodies >= MOST_POSITIONS or kept * self._now.size >= MOST_NUMBERS:
            self.frames, self._numbers = self.frames[::2], self._numbers[::2]
            self.every *= 2

    def _picture(self) -> None:
        """Of the present state; the trial goes on without where there is none."""
        if self.no_picture:
            return
        try:
            if (frame := self.simulator.frame()) is not None:
                self.frames.append(frame)
        except Exception as raised:  # a plug-in's may raise anything
            self.frames, self.no_picture = [], clean(f"{type(raised).__name__}: {raised}")


# ---- what a run has -----------------------------------------------------------------------------------------------


def _difference(found: Trace, recorded: dict[str, Any] | None) -> str:
    """In what a trial is not the recorded one, bit for bit; "" where it is."""
    if recorded is None:
        return ""
    told = [*map(_nan, recorded["fitness"]), *map(_nan, recorded["metrics"].values())]
    again = [*found.fitness, *found.metrics.values()]
    names = [*(["fitness"] * len(found.fitness)), *found.metrics]
    if len(told) != len(again):
        return f"{len(told)} numbers are recorded, and {len(again)} are played"
    for name, one, other in zip(names, told, again, strict=True):
        if struct.pack("<d", one) != struct.pack("<d", other):
            return f"the record has {name} {one!r}, and it is {other!r} when it is played again"
    return ""


def _nan(value: float | None) -> float:
    return math.nan if value is None else value


def _finite(value: float) -> float:
    return float(value) if math.isfinite(value) else math.nan


def _named(names: Sequence[str], what: str, count: int) -> list[str]:
    return [clean(name) for name in names] if len(names) == count and count else [f"{what} {i + 1}" for i in range(count)]


def _drawable(frames: Sequence[Frame]) -> bool:
    """Whether the same things are somewhere in every frame: a plug-in's may be anything."""
    if not frames:
        return False
    first = frames[0]
    fixed = ([*place[1:]] for place in first.places)
    moving = (
        [each for body in frame.bodies for each in (body.x, body.y, body.radius, body.heading or 0.0)]
        + [each for line in frame.lines for each in line[1:]]
        + [each for label in frame.labels for each in label[1:]]
        for frame in frames
    )
    return (
        all(frame.width > 0 < frame.height for frame in frames)
        and all((len(frame.bodies), len(frame.lines)) == (len(first.bodies), len(first.lines)) for frame in frames)
        and all(map(math.isfinite, itertools.chain((first.width, first.height), *fixed, *moving)))
    )


# ---- bytes --------------------------------------------------------------------------------------------------------


class _Track(NamedTuple):
    """A table of whole numbers, a row per frame or round."""

    name: str
    values: np.ndarray  # (rows, columns) uint16 or uint8
    low: Sequence[float]  # what the least and the greatest number stand for, one for all columns, or for so many in turn
    high: Sequence[float]

    def said(self) -> dict[str, Any]:
        rows, columns = self.values.shape
        return {
            "name": self.name, "rows": rows, "columns": columns, "bytes": self.values.itemsize,
            "low": [*self.low], "high": [*self.high],
        }  # fmt: skip

    def packed(self) -> bytes:
        """Differences from row to row, column after column; all high bytes, then all low ones: like stands beside like."""
        steps = np.diff(self.values, axis=0, prepend=self.values[:1] * 0).T
        halves = np.ascontiguousarray(steps).astype(steps.dtype.newbyteorder(">")).view(np.uint8)
        return np.ascontiguousarray(halves.reshape(-1, self.values.itemsize).T).tobytes()


def _header(of: Trace) -> dict[str, Any]:
    """All that is no table."""
    header: dict[str, Any] = {
        "about": of.about, "note": of.note, "error": of.error, "no_picture": of.no_picture,
        "fitness": [_shown_number(value) for value in of.fitness],
        "metrics": {name: _shown_number(value) for name, value in of.metrics.items()},
        "rounds": of.rounds, "every": of.every, "agents": len(of.owners), "owners": [*map(int, of.owners)],
        "sensors": [*of.sensors], "actuators": [*of.actuators], "neurons": [*of.neurons],
        "numbers_every": _numbers_every(of),
    }  # fmt: skip
    if of.frames:
        first, kinds = of.frames[0], _kinds(of.frames)
        header |= {
            "width": float(first.width), "height": float(first.height), "kinds": [clean(kind) for kind in kinds],
            "places": [[kinds[place.kind], *map(float, place[1:])] for place in first.places],
            "radii": [float(body.radius) for body in first.bodies],
            "shapes": [body.shape for body in first.bodies],
            "headed": [int(body.heading is not None) for body in first.bodies],
            "lines": [kinds[line.kind] for line in first.lines],
            "rays": [[*map(float, ray)] for ray in first.rays],
            "labels": _labels(of.frames),
        }  # fmt: skip
    return header


def _tracks(of: Trace) -> list[_Track]:
    tracks = []
    if of.frames:
        frames, kinds = of.frames, _kinds(of.frames)
        width, height = frames[0].width, frames[0].height
        x = np.array([[body.x for body in frame.bodies] + [e for line in frame.lines for e in line[1::2]] for frame in frames])
        y = np.array([[body.y for body in frame.bodies] + [e for line in frame.lines for e in line[2::2]] for frame in frames])
        heading = np.array([[body.heading or 0.0 for body in frame.bodies] for frame in frames])
        tracks += [
            _scaled("x", x, width),
            _scaled("y", y, height),
            _Track("heading", (np.rint(heading / (2 * math.pi) * TURN).astype(np.int64) % TURN).astype(np.uint16), [0.0], [1.0]),
            _Track("kind", np.array([[kinds[body.kind] for body in frame.bodies] for frame in frames], np.uint16), [0.0], [1.0]),
        ]
    every = _numbers_every(of)
    for name, numbers in (("inputs", of.inputs), ("outputs", of.outputs), ("hidden", of.hidden)):
        if numbers.size:
            tracks.append(_levelled(name, numbers[::every]))
    return tracks


def _scaled(name: str, values: np.ndarray, size: float) -> _Track:
    """Coordinates, those within the field and those that are further out."""
    low, high = min(0.0, float(values.min(initial=0.0))), max(size, float(values.max(initial=0.0)))
    scaled = np.rint((values - low) * (STEPS / (high - low))).astype(np.uint16)
    return _Track(name, scaled.reshape(len(values), -1), [low], [high])


def _levelled(name: str, numbers: np.ndarray) -> _Track:
    """Numbers of agents, 0 for none; each kind of number has a scale of its own."""
    known = np.where(np.isfinite(numbers), numbers, np.nan).astype(np.float64)
    some = np.isfinite(known)
    low = np.where(some, known, np.inf).min(axis=(0, 1))
    high = np.where(some, known, -np.inf).max(axis=(0, 1))
    low, high = np.where(np.isfinite(low), low, 0.0), np.where(np.isfinite(high), high, 0.0)
    size = np.where(high > low, high - low, 1.0)
    levels = np.where(some, np.rint((np.where(some, known, low) - low) / size * LEVELS) + 1, 0).astype(np.uint8)
    return _Track(name, levels.reshape(len(numbers), -1), low.tolist(), (low + size).tolist())


def _numbers_every(of: Trace) -> int:
    """Frames from one whose numbers are encoded to the next."""
    return max(1, -(-sum(part.size for part in (of.inputs, of.outputs, of.hidden)) // MOST_ENCODED))


def _kinds(frames: Sequence[Frame]) -> dict[str, int]:
    """Numbers of all kinds, in the order in which they come."""
    found = dict.fromkeys(place.kind for place in frames[0].places)
    found |= dict.fromkeys(line.kind for line in frames[0].lines)
    found |= dict.fromkeys(body.kind for frame in frames for body in frame.bodies)
    return {kind: number for number, kind in enumerate(found)}


def _labels(frames: Sequence[Frame]) -> list[list[Any]]:
    """Number of a frame, and the words from it on."""
    said: list[list[Any]] = []
    for number, frame in enumerate(frames):
        words = [[clean(label.text), float(label.x), float(label.y), float(label.size)] for label in frame.labels]
        if (said[-1][1] if said else []) != words and len(said) < MOST_LABELS:
            said.append([number, words])
    return said


def _shown_number(value: float) -> float | None:
    return None if math.isnan(value) else value
