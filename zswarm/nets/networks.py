"""The controllers of a trial's agents: a network for each, with a state of its own."""

from collections.abc import Sequence

import numpy as np

from zswarm.nets.representation import Representation


class Networks:
    """Of one trial: all states are zero at its start.

    Args:
        parameters: (participants, P) float32.
    """

    def __init__(self, representation: Representation, parameters: np.ndarray) -> None:
        self._step, self._state_size, self._parameters = representation.step, representation.state_size, parameters
        self._outputs = representation.outputs
        self._states: dict[int, np.ndarray] = {}  # by agent

    def decide(self, agents: Sequence[int], participants: Sequence[int], observations: np.ndarray) -> np.ndarray:
        """One decision of each of these agents: (agents, outputs) float32.

        Args:
            participants: which of the trial's participants drives each.
            observations: (agents, inputs) float32.
        """
        actions = np.empty((len(agents), self._outputs), np.float32)
        for row, (agent, participant) in enumerate(zip(agents, participants, strict=True)):
            state = self._states.get(agent)
            if state is None:
                state = self._states[agent] = np.zeros(self._state_size, np.float32)
            self._step(self._parameters[participant], state, observations[row], actions[row])
        return actions
