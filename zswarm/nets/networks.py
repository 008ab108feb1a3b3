"""The controllers of a trial: one network per agent, each with its own state."""

from collections.abc import Sequence

import numpy as np

from zswarm.nets.representation import Representation


class Networks:
    """Networks of one trial. All states are zero at its start.

    Args:
        parameters: (participants, P) float32.
    """

    def __init__(self, representation: Representation, parameters: np.ndarray) -> None:
        self._step = representation.step
        self._outputs = representation.outputs
        self._state_size = representation.state_size
        self._parameters = parameters
        self._states: dict[int, np.ndarray] = {}  # by agent

    def decide(
        self, agents: Sequence[int], participants: Sequence[int], observations: np.ndarray
    ) -> np.ndarray:
        """Return one decision of each agent: (agents, outputs) float32.

        Args:
            agents: agents that decide.
            participants: per agent the participant that drives it.
            observations: (agents, inputs) float32.
        """
        actions = np.empty((len(agents), self._outputs), np.float32)
        for row, (agent, participant) in enumerate(
            zip(agents, participants, strict=True)
        ):
            state = self._states.get(agent)
            if state is None:
                state = np.zeros(self._state_size, np.float32)
                self._states[agent] = state
            self._step(
                self._parameters[participant], state, observations[row], actions[row]
            )
        return actions
