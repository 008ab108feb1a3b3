"""Scenarios of VMAS (github.com/proroklab/VectorizedMultiAgentSimulator): robots in a plane, by torch.

M. Bettini, R. Kortvelesy, J. Blumenkamp, A. Prorok, "VMAS: A Vectorized Multi-Agent Simulator for Collective Robot Learning",
DARS 2022. VMAS plays many environments as one, whose random numbers come from one generator; so here a trial is one environment.
"""

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

import msgspec
import numpy as np
from msgspec import Meta

from zswarm.extras import need
from zswarm.sims.environments import ParallelEnvironment, ParallelSettings, check_name

LIBRARIES = ("vmas", "torch")


class Settings(ParallelSettings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of ``[problem.settings]``."""

    scenario: Annotated[str, Meta(description="name of a scenario of VMAS")] = "dispersion"
    steps: Annotated[
        int, Meta(ge=1, le=1_000_000, description="steps after which a trial ends, if the scenario does not end it before")
    ] = 100


class Vmas(ParallelEnvironment):
    """A scenario of VMAS: robots in a plane, by torch.

    Observation: what an agent observes. Where agents are of several types, the first number is that of the type: 0, 1, ..., in
        the order of the scenario's agents. Agents that observe less than others have zeros behind it.
    Action: for each number one output, 0 the lower and 1 the upper bound, cut there: forces, and what is said to others.
        Agents that set less than others leave the last outputs aside.
    Turns: all agents.
    Start: from the trial's seed, folded to 32 bits, with which all generators are seeded.
    End: when the scenario says so, or after ``steps`` steps.
    Fitness: sum or mean of the returns of the participant's agents; an agent's return is the sum of its rewards.
    Metrics: ``steps``; for each type ``return_`` and its name, the mean return of its agents. An agent's type is its name without
        the number at the end.
    """

    settings_type: ClassVar[type[msgspec.Struct]] = Settings

    def make(self, **options: Any) -> Any:
        """The scenario that the settings name, one of VMAS's."""
        vmas = need("vmas", "vmas", "simulator vmas")
        name = self.settings.scenario
        check_name(name, {*vmas.scenarios, *vmas.debug_scenarios, *vmas.mpe_scenarios}, "vmas")
        torch = need("torch", "vmas", "simulator vmas")
        torch.set_num_threads(1)  # a slot is one; and sums are in one order
        return OneScenario(vmas.make_env(name, num_envs=1, device="cpu", continuous_actions=True, **options), torch)


class OneScenario:
    """A scenario by the parallel interface of PettingZoo, see ``zswarm.sims.environments``."""

    def __init__(self, scenario: Any, torch: Any) -> None:
        self._scenario, self._torch = scenario, torch
        self._spaces = need("gymnasium.spaces", "vmas", "simulator vmas")
        self.possible_agents = [agent.name for agent in scenario.agents]
        self._agents = dict(zip(self.possible_agents, scenario.agents, strict=True))
        self._observed, _ = self.reset(0)
        self.agents: list[str] = []

    @property
    def unwrapped(self) -> Any:
        """What has the ``world``."""
        return self._scenario.scenario

    def observation_space(self, name: str) -> Any:
        """Numbers without bounds."""
        return self._spaces.Box(-np.inf, np.inf, self._observed[name].shape)

    def action_space(self, name: str) -> Any:
        """Forces within their range, then words from 0 to 1."""
        agent = self._agents[name]
        force = np.array(agent.action.u_range_tensor.tolist(), np.float32)
        words = np.ones(self._scenario.get_agent_action_size(agent) - force.size, np.float32)
        return self._spaces.Box(np.concatenate([-force, 0 * words]), np.concatenate([force, words]))

    def reset(self, seed: int) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Observations."""
        self.agents = list(self.possible_agents)
        return self._by_name(self._scenario.reset(seed=seed)), {}

    def step(
        self, actions: Mapping[str, np.ndarray]
    ) -> tuple[dict[str, np.ndarray], dict[str, float], dict[str, bool], dict[str, bool], dict[str, Any]]:
        """Observations, rewards, whether it is over, and two empty ones."""
        given = [self._torch.from_numpy(actions[name]).unsqueeze(0) for name in self.possible_agents]
        observations, rewards, over, _ = self._scenario.step(given)
        if over.item():
            self.agents = []
        returned = {name: reward.item() for name, reward in zip(self.possible_agents, rewards, strict=True)}
        return self._by_name(observations), returned, dict.fromkeys(self.possible_agents, bool(over.item())), {}, {}

    def close(self) -> None:
        """Nothing is open."""

    def _by_name(self, observations: list[Any]) -> dict[str, np.ndarray]:
        return {name: _flat(observed) for name, observed in zip(self.possible_agents, observations, strict=True)}


def _flat(observed: Any) -> np.ndarray:
    """The numbers of a tensor of one environment, or of several by name."""
    if isinstance(observed, Mapping):
        return np.concatenate([_flat(part) for part in observed.values()])
    numbers: np.ndarray = observed.detach().numpy().astype(np.float32).reshape(-1)
    return numbers
