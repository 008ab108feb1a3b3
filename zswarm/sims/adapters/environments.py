"""Environments with several agents as simulators, by the parallel interface of PettingZoo.

See pettingzoo.farama.org/api/parallel. An environment has ``possible_agents``, names; ``agents``,
those that act next; ``observation_space(name)`` and ``action_space(name)``, spaces of Gymnasium;
``reset(seed=...)``, ``step(actions)`` and ``close()``.
"""

import os
import random
import re
import weakref
from abc import abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal

import msgspec
import numpy as np

from zswarm.config.meta import PartSettings, about, within
from zswarm.config.suggest import nearest
from zswarm.errors import ConfigError
from zswarm.sims.adapters.spaces import act, sense
from zswarm.sims.simulator import Body, Frame, Outcome, Simulator, Turn

LIBRARIES = ("gymnasium",)
HALF_WORD, MASK = 32, 0xFFFFFFFF  # bits and largest of the seeds that environments take
DEEPEST = 5  # nested tables of options
TEXT = re.compile(r"\w[\w .+-]*|")  # cannot name a file or a module
# Width of a picture; agents of most environments start within 1 of its middle.
PLANE = 3.0
NUMBERED = re.compile(r"[ _-]?\d+$")  # the end of an agent's name
QUIET = {
    "SDL_VIDEODRIVER": "dummy",
    "SDL_AUDIODRIVER": "dummy",
    "PYGAME_HIDE_SUPPORT_PROMPT": "1",
}

Options = Annotated[
    dict[str, Any], about("keyword arguments of the environment, such as `{ N = 5 }`")
]
Steps = Annotated[int, within(1, 1_000_000, "maximum steps of a trial")]


class ParallelSettings(PartSettings, frozen=True):
    """Settings of ``[problem.settings]`` of an environment with several agents."""

    options: Options = msgspec.field(default_factory=dict)
    genomes: Annotated[
        Literal["one", "types"],
        about(
            '"one": one genome drives all agents; "types": one for each type of '
            "agents, which is a participant: it needs a [ranking](co-evolution.md)"
        ),
    ] = "one"
    fitness: Annotated[
        Literal["sum", "mean"], about("mean or sum of a participant's returns")
    ] = "sum"
    steps: Steps = 10_000


class ParallelEnvironment(Simulator):
    """Agents of an environment act at the same time; a child creates the environment.

    Data sheet: ``zswarm.sims.adapters.pettingzoo.PettingZoo``.
    """

    settings_type: ClassVar[type[msgspec.Struct]] = ParallelSettings
    settings: Any

    def __init__(self, settings: Any) -> None:
        super().__init__(settings)
        check_options(settings.options)
        self._environment = environment = self.make(**settings.options)
        weakref.finalize(self, environment.close)
        self._names = names = list(environment.possible_agents)
        self._index = {name: agent for agent, name in enumerate(names)}
        kinds = [kind(name) for name in names]
        self.types = list(dict.fromkeys(kinds))
        self._type_of = [self.types.index(each) for each in kinds]
        self._sees_type = int(len(self.types) > 1)
        space = environment.observation_space
        self._senses = [sense(space(name), f"observations of {name}") for name in names]
        space = environment.action_space
        self._acts = [act(space(name), f"actions of {name}") for name in names]
        self.inputs = self._sees_type + max(senses.size for senses in self._senses)
        self.outputs = max(acts.size for acts in self._acts)
        self.owners = self._type_of if settings.genomes == "types" else [0] * len(names)
        self.participants = 1 + max(self.owners)
        self.metrics = ("steps", *(f"return_{each}" for each in self.types))

    @abstractmethod
    def make(self, **options: Any) -> Any:
        """Return the environment, given the options of the settings."""

    def reset(self, seed: int) -> Turn:
        """Start a trial."""
        seed = folded(seed)
        seed_generators(seed)
        observations, _ = self._environment.reset(seed=seed)
        self._returns = [0.0] * len(self._names)
        self._steps = 0
        turn = self._turn(observations)
        if turn is None:
            raise ValueError("the environment has no agent after reset")
        return turn

    def step(self, actions: np.ndarray) -> Turn | None:
        """Let the present agents act."""
        chosen = {
            self._names[agent]: self._acts[agent].action(row)
            for agent, row in zip(self._acting, actions, strict=True)
        }
        observations, rewards, *_ = self._environment.step(chosen)
        for name, reward in rewards.items():
            self._returns[self._index[name]] += float(reward)
        self._steps += 1
        return self._turn(observations)

    def outcome(self) -> Outcome:
        """Return fitness and metrics of the trial that ended."""
        fitness = [self._total(self.owners, owner) for owner in range(self.participants)]
        if self.settings.fitness == "mean":
            counts = map(self.owners.count, range(self.participants))
            fitness = [
                total / count for total, count in zip(fitness, counts, strict=True)
            ]
        means = [
            self._total(self._type_of, type_) / self._type_of.count(type_)
            for type_ in range(len(self.types))
        ]
        return Outcome(fitness, [self._steps, *means])

    def frame(self) -> Frame | None:
        """Return the plane of MPE2 and VMAS; other environments state no positions."""
        world = getattr(getattr(self._environment, "unwrapped", None), "world", None)
        try:
            bodies = [body(entity) for entity in [*world.agents, *world.landmarks]]  # type: ignore[union-attr]  # caught
        except (AttributeError, TypeError, ValueError):
            return None
        return Frame(PLANE, PLANE, [], bodies)

    def _total(self, groups: Sequence[int], group: int) -> float:
        """Return the returns of the agents of a group, added in their order."""
        total = 0.0
        for member, value in zip(groups, self._returns, strict=True):
            if member == group:
                total += value
        return total

    def _turn(self, observations: Mapping[Any, Any]) -> Turn | None:
        unknown = [name for name in self._environment.agents if name not in self._index]
        if unknown:
            text = "is not among the environment's possible agents"
            raise ValueError(f"agent {unknown[0]!r:.60} {text}")
        self._acting = sorted(self._index[name] for name in self._environment.agents)
        if not self._acting or self._steps >= self.settings.steps:
            return None
        rows = np.zeros((len(self._acting), self.inputs), np.float32)
        for row, agent in zip(rows, self._acting, strict=True):
            if self._sees_type:
                row[0] = self._type_of[agent]
            senses = self._senses[agent]
            numbers = senses.numbers(observations[self._names[agent]])
            row[self._sees_type : self._sees_type + senses.size] = numbers
        return Turn(self._acting, rows)


def kind(name: Any) -> str:
    """Return the type of an agent: its name without the number at the end."""
    text = str(name)
    return re.sub(r"\W+", "_", NUMBERED.sub("", text) or text)


def body(entity: Any) -> Body:
    """Return an agent or landmark of MPE2 or VMAS for drawing; what is not round is a square.

    Raises:
        AttributeError, TypeError, ValueError: it states no position.
    """
    name = kind(entity.name)
    state = entity.state
    middle = PLANE / 2
    is_mpe = hasattr(state, "p_pos")
    x, y = map(float, state.p_pos) if is_mpe else state.pos[0].tolist()
    x = middle + x
    y = middle - y
    radius = entity.size if is_mpe else getattr(entity.shape, "radius", None)
    if radius is None:
        half_side = entity.shape.circumscribed_radius() / 2
        angle = float(state.rot[0, 0])
        return Body(name, x, y, float(half_side), -angle, "square")
    return Body(name, x, y, float(radius), None, "disc" if entity.movable else "diamond")


def folded(seed: int) -> int:
    """Return a trial's seed in 32 bits."""
    return (seed ^ seed >> HALF_WORD) & MASK


def seed_generators(seed: int) -> None:
    """Seed the global generators that environments may draw from."""
    random.seed(seed)
    np.random.seed(seed)


def check_options(options: Mapping[str, Any]) -> None:
    """Refuse options that may name a file or a module, for an experiment may be a stranger's.

    Raises:
        ConfigError: a value is not plain, or would open a window.
    """
    if "render_mode" in options:
        raise ConfigError("options: render_mode: a trial is played without a window")
    _check_option(options, "options", 0)


def _check_option(value: Any, where: str, depth: int) -> None:
    match value:
        case str() if not TEXT.fullmatch(value):
            text = "expected a text of letters, digits, blanks and _ . + -"
            raise ConfigError(f"{where}: {text}, not {value!r:.60}")
        case Mapping() | list() if depth == DEEPEST:
            raise ConfigError(f"{where}: expected at most {DEEPEST} nested tables")
        case Mapping():
            for key, item in value.items():
                _check_option(item, f"{where}: {key}", depth + 1)
        case list():
            for item in value:
                _check_option(item, where, depth + 1)


def check_name(name: str, known: Iterable[str], simulator: str) -> None:
    """Raise ``ConfigError`` with the known names unless the environment is one of them."""
    names = sorted(known)
    if name not in names:
        hint = f"{nearest(name, names)}; known are: {', '.join(names)}"
        raise ConfigError(f"{simulator}: unknown environment {name!r:.60}{hint}")


def without_window() -> None:
    """Keep pygame, with which many environments draw, from opening a window and printing."""
    for name, value in QUIET.items():
        os.environ.setdefault(name, value)
