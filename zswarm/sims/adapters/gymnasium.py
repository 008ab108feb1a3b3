"""Environments of Gymnasium (gymnasium.farama.org) and those registered with it: one agent."""

import weakref
from abc import abstractmethod
from typing import Annotated, Any, ClassVar

import msgspec
import numpy as np

from zswarm.config.meta import PartSettings, about
from zswarm.errors import ConfigError
from zswarm.sims.adapters import environments
from zswarm.sims.adapters.spaces import act, sense
from zswarm.sims.simulator import Outcome, Simulator, Turn
from zswarm.system.extras import need

# The first: packages that register environments.
LIBRARIES = ("gymnasium.envs", "box2d", "box2d-py", "mujoco", "pygame", "pygame-ce")


class EnvironmentSettings(PartSettings, frozen=True):
    """Settings of ``[problem.settings]`` of an environment with one agent."""

    options: environments.Options = msgspec.field(default_factory=dict)
    steps: environments.Steps = 10_000


class GymnasiumSettings(EnvironmentSettings, frozen=True):
    """Settings of ``[problem.settings]``."""

    environment: Annotated[str, about("name of a registered environment")] = "CartPole-v1"


class Environment(Simulator):
    """One agent in an environment; a child creates the environment.

    Data sheet: ``Gymnasium``.
    """

    settings_type: ClassVar[type[msgspec.Struct]] = EnvironmentSettings
    metrics = ("steps",)
    owners = (0,)
    settings: Any

    def __init__(self, settings: Any) -> None:
        super().__init__(settings)
        environments.check_options(settings.options)
        self._environment = self._made()
        self._senses = sense(self._environment.observation_space, "observations")
        self._acts = act(self._environment.action_space, "actions")
        self.inputs = self._senses.size
        self.outputs = self._acts.size

    @abstractmethod
    def make(self, **options: Any) -> Any:
        """Return the environment of one trial, given the options of the settings."""

    def reset(self, seed: int) -> Turn:
        """Start a trial in a new environment, for some carry state over, and a new one is cheap."""
        self._close()
        self._environment = self._made()
        seed = environments.folded(seed)
        environments.seed_generators(seed)
        observation, _ = self._environment.reset(seed=seed)
        self._return = 0.0
        self._steps = 0
        return self._turn(observation)

    def step(self, actions: np.ndarray) -> Turn | None:
        """Let the agent act."""
        action = self._acts.action(actions[0])
        observation, reward, terminated, truncated, _ = self._environment.step(action)
        self._return += float(reward)
        self._steps += 1
        over = terminated or truncated or self._steps >= self.settings.steps
        return None if over else self._turn(observation)

    def outcome(self) -> Outcome:
        """Return fitness and metrics of the trial that ended."""
        return Outcome([self._return], [self._steps])

    def _made(self) -> Any:
        """Return an environment, which ``_close`` closes, at the latest with this simulator."""
        environment = self.make(**self.settings.options)
        self._close = weakref.finalize(self, environment.close)
        return environment

    def _turn(self, observation: Any) -> Turn:
        return Turn(
            (0,), self._senses.numbers(observation).astype(np.float32).reshape(1, -1)
        )


class Gymnasium(Environment):
    """An environment of Gymnasium, or one that another package registers with it.

    Observation: the environment's, flattened as by Gymnasium: numbers as they are, a choice of n as
        n numbers, one of them 1.
    Action: for a number between bounds one output, 0 the lower and 1 the upper bound, clipped; for
        one without bounds 2 output - 1; for a choice of n as many outputs, of which the highest
        wins, the first of equals; for a bit one output, set above 0.5.
    Turns: the agent.
    Start: from the trial's seed, folded to 32 bits, which also seeds numpy's and Python's
        generators.
    End: when the environment ends, or after ``steps`` steps.
    Fitness: the return: the sum of the rewards.
    Metrics: ``steps``.
    """

    settings_type: ClassVar[type[msgspec.Struct]] = GymnasiumSettings

    def make(self, **options: Any) -> Any:
        """Return the environment that the settings name, one of those registered."""
        gymnasium = need("gymnasium", "gym", "simulator gymnasium")
        name = self.settings.environment
        # Refuses "module:name".
        environments.check_name(name, gymnasium.registry, "gymnasium")
        environments.without_window()
        try:
            return gymnasium.make(name, disable_env_checker=True, **options)
        except gymnasium.error.DependencyNotInstalled as error:
            text = " ".join(str(error).split())
            raise ConfigError(f"gymnasium: {name} needs more: {text}") from None
