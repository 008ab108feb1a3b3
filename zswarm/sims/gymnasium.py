"""Environments of Gymnasium (gymnasium.farama.org), and those that other packages register with it: one agent."""

import weakref
from abc import abstractmethod
from typing import Annotated, Any, ClassVar

import msgspec
import numpy as np
from msgspec import Meta

from zswarm.errors import ConfigError
from zswarm.extras import need
from zswarm.sims.environments import act, check_name, check_options, folded, seed_generators, sense, without_window
from zswarm.sims.simulator import Outcome, Simulator, Turn

LIBRARIES = ("gymnasium.envs", "box2d", "box2d-py", "mujoco", "pygame", "pygame-ce")  # the first: packages that register some


class EnvironmentSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of ``[problem.settings]`` of an environment with one agent."""

    options: Annotated[
        dict[str, Any],
        Meta(description="what the environment is made with, such as `{ max_episode_steps = 200 }`: its keyword arguments"),
    ] = {}
    steps: Annotated[
        int, Meta(ge=1, le=1_000_000, description="steps after which a trial ends, if the environment does not end it before")
    ] = 10_000


class Settings(EnvironmentSettings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of ``[problem.settings]``."""

    environment: Annotated[str, Meta(description="name of an environment that is registered with Gymnasium")] = "CartPole-v1"


class Environment(Simulator):
    """One agent in an environment; a child makes the environment.

    Data sheet: ``Gymnasium``.
    """

    settings_type: ClassVar[type[msgspec.Struct]] = EnvironmentSettings
    metrics = ("steps",)
    owners = (0,)
    settings: Any

    def __init__(self, settings: Any) -> None:
        super().__init__(settings)
        check_options(settings.options)
        self._environment = self._made()
        self._senses = sense(self._environment.observation_space, "observations")
        self._acts = act(self._environment.action_space, "actions")
        self.inputs, self.outputs = self._senses.size, self._acts.size

    @abstractmethod
    def make(self, **options: Any) -> Any:
        """The environment, for one trial.

        Args:
            options: those of the settings.
        """

    def reset(self, seed: int) -> Turn:
        """Start a trial, in a new environment: some leave something over for the next one, and making one takes little."""
        self._close()
        self._environment = self._made()
        seed = folded(seed)
        seed_generators(seed)
        observation, _ = self._environment.reset(seed=seed)
        self._return, self._steps = 0.0, 0
        return self._turn(observation)

    def step(self, actions: np.ndarray) -> Turn | None:
        """Let the agent act."""
        observation, reward, terminated, truncated, _ = self._environment.step(self._acts.action(actions[0]))
        self._return += float(reward)
        self._steps += 1
        over = terminated or truncated or self._steps >= self.settings.steps
        return None if over else self._turn(observation)

    def outcome(self) -> Outcome:
        """Fitness and metrics of the trial that ended."""
        return Outcome([self._return], [self._steps])

    def _made(self) -> Any:
        """An environment, which is closed by ``_close`` or with this simulator."""
        environment = self.make(**self.settings.options)
        self._close = weakref.finalize(self, environment.close)
        return environment

    def _turn(self, observation: Any) -> Turn:
        return Turn((0,), self._senses.numbers(observation).astype(np.float32).reshape(1, -1))


class Gymnasium(Environment):
    """An environment of Gymnasium, or one that another package registers with it.

    Observation: the environment's, flattened as Gymnasium does: numbers as they are, a choice of n as n numbers, one of them 1.
    Action: for a number between bounds one output, 0 the lower and 1 the upper bound, cut there; for one without bounds
        2 output - 1; for a choice of n as many outputs, the highest decides, the first of equal ones; for a bit one output, set
        above .5.
    Turns: the agent.
    Start: from the trial's seed, folded to 32 bits; the generators of numpy and of Python's random are seeded with it, too.
    End: when the environment says so, which most do after a number of steps, or after ``steps`` steps.
    Fitness: the return: the sum of the rewards.
    Metrics: ``steps``.
    """

    settings_type: ClassVar[type[msgspec.Struct]] = Settings

    def make(self, **options: Any) -> Any:
        """The environment that the settings name, one of those that are registered."""
        gymnasium = need("gymnasium", "gym", "simulator gymnasium")
        name = self.settings.environment
        check_name(name, gymnasium.registry, "gymnasium")  # which refuses "module:name", too
        without_window()
        try:
            return gymnasium.make(name, disable_env_checker=True, **options)
        except gymnasium.error.DependencyNotInstalled as error:
            raise ConfigError(f"gymnasium: {name} needs more: {' '.join(str(error).split())}") from None
