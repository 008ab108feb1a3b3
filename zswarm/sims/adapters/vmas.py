"""Scenarios of VMAS: robots in a plane, by torch.

Source: github.com/proroklab/VectorizedMultiAgentSimulator;
M. Bettini, R. Kortvelesy, J. Blumenkamp, A. Prorok, DARS 2022. VMAS plays many environments as one,
with random numbers from one generator; so here a trial is one environment.
"""

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

import msgspec
import numpy as np

from zswarm.config.meta import about
from zswarm.sims.adapters.environments import (
    ParallelEnvironment,
    ParallelSettings,
    Steps,
    check_name,
)
from zswarm.system.extras import need

LIBRARIES = ("vmas", "torch")


class VmasSettings(ParallelSettings, frozen=True):
    """Settings of ``[problem.settings]``."""

    scenario: Annotated[str, about("name of a scenario of VMAS")] = "dispersion"
    steps: Steps = 100


class Vmas(ParallelEnvironment):
    """A scenario of VMAS: robots in a plane, by torch.

    Observation: an agent's. If there are several types of agents, the first number is the type: 0,
        1, ..., in the order of the scenario's agents. Shorter observations end in zeros.
    Action: for each number one output, 0 the lower and 1 the upper bound, clipped: forces, then
        messages to others. Agents with fewer actions ignore the last outputs.
    Turns: all agents.
    Start: from the trial's seed, folded to 32 bits, which seeds all generators.
    End: when the scenario ends, or after ``steps`` steps.
    Fitness: sum or mean of the returns of the participant's agents. A return is the sum of an
        agent's rewards.
    Metrics: ``steps``; for each type ``return_`` and its name, the mean return of its agents. The
        type is the agent's name without the number at the end.
    """

    settings_type: ClassVar[type[msgspec.Struct]] = VmasSettings

    def make(self, **options: Any) -> Any:
        """Return the scenario that the settings name."""
        vmas = need("vmas", "vmas", "simulator vmas")
        name = self.settings.scenario
        check_name(
            name, {*vmas.scenarios, *vmas.debug_scenarios, *vmas.mpe_scenarios}, "vmas"
        )
        torch = need("torch", "vmas", "simulator vmas")
        torch.set_num_threads(1)  # a slot is one core; and sums have one order
        made = vmas.make_env(
            name, num_envs=1, device="cpu", continuous_actions=True, **options
        )
        return OneScenario(made, torch)


class OneScenario:
    """A scenario with the parallel interface of PettingZoo; see ``environments.py``."""

    def __init__(self, scenario: Any, torch: Any) -> None:
        self._scenario = scenario
        self._torch = torch
        self._spaces = need("gymnasium.spaces", "vmas", "simulator vmas")
        self.possible_agents = [agent.name for agent in scenario.agents]
        self._agents = dict(zip(self.possible_agents, scenario.agents, strict=True))
        self._observed, _ = self.reset(0)
        self.agents: list[str] = []

    @property
    def unwrapped(self) -> Any:
        """Return what has the ``world``."""
        return self._scenario.scenario

    def observation_space(self, name: str) -> Any:
        """Return numbers without bounds."""
        return self._spaces.Box(-np.inf, np.inf, self._observed[name].shape)

    def action_space(self, name: str) -> Any:
        """Return forces within their range, then messages from 0 to 1."""
        agent = self._agents[name]
        force = np.array(agent.action.u_range_tensor.tolist(), np.float32)
        words = np.ones(
            self._scenario.get_agent_action_size(agent) - force.size, np.float32
        )
        return self._spaces.Box(
            np.concatenate([-force, 0 * words]), np.concatenate([force, words])
        )

    def reset(self, seed: int) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Return observations."""
        self.agents = list(self.possible_agents)
        return self._by_name(map(_flat, self._scenario.reset(seed=seed))), {}

    def step(self, actions: Mapping[str, np.ndarray]) -> tuple[dict[str, Any], ...]:
        """Return observations, rewards, and whether it is over; other results are empty."""
        names = self.possible_agents
        given = [self._torch.from_numpy(actions[name]).unsqueeze(0) for name in names]
        observations, rewards, over, _ = self._scenario.step(given)
        is_over = bool(over.item())
        if is_over:
            self.agents = []
        returned = self._by_name(reward.item() for reward in rewards)
        seen = self._by_name(map(_flat, observations))
        return seen, returned, dict.fromkeys(names, is_over), {}, {}

    def close(self) -> None:
        """Do nothing: nothing is open."""

    def _by_name(self, values: Any) -> dict[str, Any]:
        return dict(zip(self.possible_agents, values, strict=True))


def _flat(observed: Any) -> np.ndarray:
    """Return the numbers of a tensor of one environment, or of several by name."""
    if isinstance(observed, Mapping):
        return np.concatenate([_flat(part) for part in observed.values()])
    numbers: np.ndarray = observed.detach().numpy().astype(np.float32).reshape(-1)
    return numbers
