"""Environments of other packages as simulators, by the parallel interface of PettingZoo (pettingzoo.farama.org/api/parallel).

An environment has ``possible_agents``, names; ``agents``, those that act next; ``observation_space(name)`` and
``action_space(name)``, spaces of Gymnasium; ``reset(seed=...)``, which gives observations by name, and infos;
``step(actions)``, which takes actions by name and gives observations, rewards, terminations, truncations and infos by name;
``close()``.
"""

import os
import random
import re
import weakref
from abc import abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta

from zswarm.errors import ConfigError
from zswarm.extras import need
from zswarm.nearest import nearest
from zswarm.sims.simulator import Body, Frame, Outcome, Simulator, Turn

LIBRARIES = ("gymnasium",)
HALF_WORD, MASK = 32, 0xFFFFFFFF  # the seeds that environments take: bits, and the largest
DEEPEST = 5  # tables in tables
TEXT = re.compile(r"\w[\w .+-]*|")  # names no file, and no module
PLANE = 3.0  # width of what a picture shows; agents of most environments start within 1 of its middle
NUMBERED = re.compile(r"[ _-]?\d+$")  # the end of an agent's name


class ParallelSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of ``[problem.settings]`` of an environment with several agents."""

    options: Annotated[
        dict[str, Any], Meta(description="what the environment is made with: its keyword arguments, such as `{ N = 5 }`")
    ] = {}
    genomes: Annotated[
        Literal["one", "types"],
        Meta(
            description='"one": one genome drives all agents; "types": one for each type of agents, which is a participant: it '
            "needs a [ranking](co-evolution.md)"
        ),
    ] = "one"
    fitness: Annotated[
        Literal["sum", "mean"], Meta(description="of the returns of a participant's agents: their sum, or their mean")
    ] = "sum"
    steps: Annotated[
        int, Meta(ge=1, le=1_000_000, description="steps after which a trial ends, if the environment does not end it before")
    ] = 10_000


class ParallelEnvironment(Simulator):
    """Agents of an environment act at the same time; a child makes the environment.

    Data sheet: ``zswarm.sims.pettingzoo.PettingZoo``.
    """

    settings_type: ClassVar[type[msgspec.Struct]] = ParallelSettings
    settings: Any

    def __init__(self, settings: Any) -> None:
        super().__init__(settings)
        check_options(settings.options)
        self._environment = environment = self.make(**settings.options)
        weakref.finalize(self, environment.close)
        self._names = list(environment.possible_agents)
        self._index = {name: agent for agent, name in enumerate(self._names)}
        kinds = [kind(name) for name in self._names]
        self.types = list(dict.fromkeys(kinds))
        self._type_of = [self.types.index(each) for each in kinds]
        self._told = int(len(self.types) > 1)  # whether agents are told their type
        self._senses = [sense(environment.observation_space(name), f"observations of {name}") for name in self._names]
        self._acts = [act(environment.action_space(name), f"actions of {name}") for name in self._names]
        self.inputs = self._told + max(senses.size for senses in self._senses)
        self.outputs = max(acts.size for acts in self._acts)
        self.owners = self._type_of if settings.genomes == "types" else [0] * len(self._names)
        self.participants = 1 + max(self.owners)
        self.metrics = ("steps", *(f"return_{each}" for each in self.types))

    @abstractmethod
    def make(self, **options: Any) -> Any:
        """The environment.

        Args:
            options: those of the settings.
        """

    def reset(self, seed: int) -> Turn:
        """Start a trial."""
        seed = folded(seed)
        seed_generators(seed)
        observations, _ = self._environment.reset(seed=seed)
        self._returns = [0.0] * len(self._names)
        self._steps = 0
        turn = self._turn(observations)
        if turn is None:
            raise ValueError("no agent is there after reset")
        return turn

    def step(self, actions: np.ndarray) -> Turn | None:
        """Let the agents that are there act."""
        chosen = {self._names[agent]: self._acts[agent].action(actions[row]) for row, agent in enumerate(self._acting)}
        observations, rewards, *_ = self._environment.step(chosen)
        for name, reward in rewards.items():
            self._returns[self._index[name]] += float(reward)
        self._steps += 1
        return self._turn(observations)

    def outcome(self) -> Outcome:
        """Fitness and metrics of the trial that ended."""
        fitness = [self._total(self.owners, participant) for participant in range(self.participants)]
        if self.settings.fitness == "mean":
            fitness = [total / self.owners.count(participant) for participant, total in enumerate(fitness)]
        means = [self._total(self._type_of, each) / self._type_of.count(each) for each in range(len(self.types))]
        return Outcome(fitness, [self._steps, *means])

    def frame(self) -> Frame | None:
        """The plane in which the agents and landmarks of MPE2 and VMAS are; other environments say of no place."""
        world = getattr(getattr(self._environment, "unwrapped", None), "world", None)
        try:
            things = [*world.agents, *world.landmarks]  # type: ignore[union-attr]  # None has no such attributes, which is told below
            return plane([place(thing) for thing in things])
        except (AttributeError, TypeError, ValueError):
            return None

    def _total(self, groups: Sequence[int], group: int) -> float:
        """Returns of the agents of a group, added in their order."""
        total = 0.0
        for agent, of in enumerate(groups):
            if of == group:
                total += self._returns[agent]
        return total

    def _turn(self, observations: Mapping[Any, Any]) -> Turn | None:
        unknown = [name for name in self._environment.agents if name not in self._index]
        if unknown:
            raise ValueError(f"agent {unknown[0]!r:.60} is not among the environment's possible agents")
        self._acting = sorted(self._index[name] for name in self._environment.agents)
        if not self._acting or self._steps >= self.settings.steps:
            return None
        rows = np.zeros((len(self._acting), self.inputs), np.float32)
        for row, agent in zip(rows, self._acting, strict=True):
            if self._told:
                row[0] = self._type_of[agent]
            senses = self._senses[agent]
            row[self._told : self._told + senses.size] = senses.numbers(observations[self._names[agent]])
        return Turn(self._acting, rows)


def kind(name: Any) -> str:
    """The type of an agent: its name without the number at the end."""
    text = str(name)
    return re.sub(r"\W+", "_", NUMBERED.sub("", text) or text)


class Thing(NamedTuple):
    """An agent or landmark in a plane, x to the right and y up from the middle."""

    kind: str
    x: float
    y: float
    radius: float
    angle: float
    shape: Literal["disc", "square", "diamond"]


def place(thing: Any) -> Thing:
    """Where something of MPE2 is (``state.p_pos``), or of VMAS (``state.pos``); what is not round is shown as a square.

    Raises:
        AttributeError, TypeError, ValueError: it does not say.
    """
    name = kind(thing.name)
    if hasattr(thing.state, "p_pos"):
        x, y = map(float, thing.state.p_pos)
        return Thing(name, x, y, float(thing.size), 0.0, "disc" if thing.movable else "diamond")
    x, y = thing.state.pos[0].tolist()
    radius = getattr(thing.shape, "radius", None)
    if radius is None:
        return Thing(name, x, y, float(thing.shape.circumscribed_radius()) / 2, float(thing.state.rot[0, 0]), "square")
    return Thing(name, x, y, float(radius), 0.0, "disc" if thing.movable else "diamond")


def plane(things: Sequence[Thing]) -> Frame:
    """A picture of what is in a plane; that may be further out than it is wide."""
    middle = PLANE / 2
    bodies = [
        Body(one.kind, middle + one.x, middle - one.y, one.radius, -one.angle if one.shape == "square" else None, one.shape)
        for one in things
    ]
    return Frame(PLANE, PLANE, [], bodies)


def folded(seed: int) -> int:
    """A trial's seed in 32 bits."""
    return (seed ^ seed >> HALF_WORD) & MASK


def seed_generators(seed: int) -> None:
    """Seed the generators of a process that environments may draw from."""
    random.seed(seed)
    np.random.seed(seed)


def check_options(options: Mapping[str, Any]) -> None:
    """Plain values only: what comes from elsewhere names no file and no module.

    Raises:
        ConfigError: one is not, or would open a window.
    """
    if "render_mode" in options:
        raise ConfigError("options: render_mode: nothing is shown while a trial is played")
    _check_option(options, "options", 0)


def _check_option(value: Any, where: str, depth: int) -> None:
    match value:
        case str() if not TEXT.fullmatch(value):
            raise ConfigError(f"{where}: expected a text of letters, digits, blanks and _ . + -, not {value!r:.60}")
        case Mapping() | list() if depth == DEEPEST:
            raise ConfigError(f"{where}: nested too deep")
        case Mapping():
            for key, item in value.items():
                _check_option(item, f"{where}: {key}", depth + 1)
        case list():
            for item in value:
                _check_option(item, where, depth + 1)


def check_name(name: str, known: Iterable[str], simulator: str) -> None:
    """One of the known environments.

    Raises:
        ConfigError: it is not; this names them.
    """
    names = sorted(known)
    if name not in names:
        raise ConfigError(f"{simulator}: unknown environment {name!r:.60}{nearest(name, names)}; known are: {', '.join(names)}")


def without_window() -> None:
    """Have pygame, which many environments draw with, neither open a window nor say hello."""
    for name, value in (("SDL_VIDEODRIVER", "dummy"), ("SDL_AUDIODRIVER", "dummy"), ("PYGAME_HIDE_SUPPORT_PROMPT", "1")):
        os.environ.setdefault(name, value)


# ---- spaces -------------------------------------------------------------------------------------------------------


class Senses(NamedTuple):
    """How an agent observes."""

    size: int
    numbers: Callable[[Any], np.ndarray]  # of an observation: (size,)


class Acts(NamedTuple):
    """How an agent acts."""

    size: int
    action: Callable[[np.ndarray], Any]  # of outputs, (size,) float32 at least


def sense(space: Any, where: str) -> Senses:
    """What observations of a space are as numbers.

    Raises:
        ConfigError: it has no fixed number of them.
    """
    spaces = need("gymnasium.spaces", "gym", where)
    if not space.is_np_flattenable:
        raise ConfigError(f"{where}: expected a fixed number of numbers, not {space!s:.80}")
    size = spaces.flatdim(space)

    def numbers(observation: Any) -> np.ndarray:
        flat = np.asarray(observation) if isinstance(space, spaces.Box) else spaces.flatten(space, observation)
        if flat.size != size:
            raise ValueError(f"{where}: expected {size} numbers, not {flat.size}")
        return flat.reshape(-1)

    return Senses(size, numbers)


def act(space: Any, where: str) -> Acts:
    """What outputs are as actions of a space.

    Raises:
        ConfigError: it is of a kind that outputs cannot set.
    """
    spaces = need("gymnasium.spaces", "gym", where)
    match space:
        case spaces.Box():
            return _numbers(space)
        case spaces.Discrete():
            count, start = int(space.n), int(space.start)
            return Acts(count, lambda outputs: start + int(np.argmax(outputs[:count])))
        case spaces.MultiDiscrete():
            return _choices(space)
        case spaces.MultiBinary():
            bits = int(np.prod(space.shape))
            return Acts(bits, lambda outputs: (outputs[:bits] > np.float32(0.5)).astype(space.dtype).reshape(space.shape))
        case spaces.Tuple() | spaces.Dict():
            return _composed(space, where, spaces)
    raise ConfigError(f"{where}: expected numbers or choices, not {space!s:.80}")


def _numbers(space: Any) -> Acts:
    bounded = np.isfinite(space.low) & np.isfinite(space.high)
    low = np.where(bounded, space.low, -1).astype(np.float64).reshape(-1)
    high = np.where(bounded, space.high, 1).astype(np.float64).reshape(-1)
    cut = bounded.reshape(-1)
    whole = np.issubdtype(space.dtype, np.integer)

    def action(outputs: np.ndarray) -> np.ndarray:
        share = outputs[: low.size].astype(np.float64)
        values = low + np.where(cut, np.clip(share, 0.0, 1.0), share) * (high - low)
        values = np.rint(values) if whole else values
        values = np.where(cut, np.clip(values, low, high), values)
        return values.astype(space.dtype).reshape(space.shape)

    return Acts(low.size, action)


def _choices(space: Any) -> Acts:
    counts = [int(count) for count in space.nvec.reshape(-1)]
    starts = np.asarray(getattr(space, "start", 0)) + np.zeros(space.shape, np.int64)
    ends = [sum(counts[: number + 1]) for number in range(len(counts))]

    def action(outputs: np.ndarray) -> np.ndarray:
        chosen = [int(np.argmax(outputs[end - count : end])) for count, end in zip(counts, ends, strict=True)]
        made: np.ndarray = (np.array(chosen).reshape(space.shape) + starts).astype(space.dtype)
        return made

    return Acts(ends[-1], action)


def _composed(space: Any, where: str, spaces: Any) -> Acts:
    named = isinstance(space, spaces.Dict)
    keys = list(space.spaces) if named else list(range(len(space.spaces)))
    parts = [act(space.spaces[key], f"{where}: {key}") for key in keys]
    ends = [sum(part.size for part in parts[: number + 1]) for number in range(len(parts))]

    def action(outputs: np.ndarray) -> Any:
        made = [part.action(outputs[end - part.size : end]) for part, end in zip(parts, ends, strict=True)]
        return dict(zip(keys, made, strict=True)) if named else tuple(made)

    return Acts(sum(part.size for part in parts), action)
