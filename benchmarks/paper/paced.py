"""The simulator ``paced``: a bundled one whose steps take a given time."""

import time
from collections.abc import Sequence
from typing import Literal

import msgspec
import numpy as np

from zswarm.sims.emergency_exit import EmergencyExit
from zswarm.sims.emergency_exit import EmergencyExitSettings as ExitSettings
from zswarm.sims.minisim import Minisim, MinisimSettings
from zswarm.sims.simulator import Outcome, Simulator, Turn

MINISIM_CELLS = 10  # of a side: games of 10 steps are the shortest


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Whose steps, and how long they take."""

    world: Literal["emergency-exit", "minisim"] = "emergency-exit"
    agents: int = 8
    steps: int = 50
    step_s: float = 0.0


class Paced(Simulator):
    """Play emergency exit or minisim, sleeping ``step_s`` after each step.

    Turns: those of the world. In emergency exit one agent after another acts, in minisim all of
    them at once.
    """

    settings_type = Settings
    settings: Settings

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings)
        agents, steps = settings.agents, settings.steps
        self._world: Simulator = (
            EmergencyExit(ExitSettings(agents=agents, steps=steps, width=20, height=20))
            if settings.world == "emergency-exit"
            else Minisim(
                MinisimSettings(
                    robots=agents, steps=steps, width=MINISIM_CELLS, height=MINISIM_CELLS
                )
            )
        )
        self.metrics, self.owners = self._world.metrics, self._world.owners
        self.inputs, self.outputs = self._world.inputs, self._world.outputs
        self.sensors, self.actuators = self._world.sensors, self._world.actuators

    def fixed_seeds(self, trials: int) -> Sequence[int]:
        """Return the world's seeds."""
        return range(trials)

    def reset(self, seed: int) -> Turn:
        """Begin the world's trial."""
        turn = self._world.reset(seed)
        self._acted = turn.agents[-1]
        return turn

    def step(self, actions: np.ndarray) -> Turn | None:
        """Act; a world's step ends when the next agents are not later ones."""
        turn = self._world.step(actions)
        if self.settings.step_s and (turn is None or turn.agents[0] <= self._acted):
            time.sleep(self.settings.step_s)
        if turn is not None:
            self._acted = turn.agents[-1]
        return turn

    def outcome(self) -> Outcome:
        """Return the world's outcome."""
        return self._world.outcome()
