"""Play a trial in turns, and check that the simulator keeps its contract."""

from collections.abc import Iterator, Sequence
from typing import Protocol

import numpy as np

from zswarm.sims.simulator import MAX_TURNS, Outcome, Simulator, Turn


class Controllers(Protocol):
    """Decides for the agents of one trial."""

    def decide(
        self, agents: Sequence[int], participants: Sequence[int], observations: np.ndarray
    ) -> np.ndarray:
        """See ``Networks``."""


class BrokenContractError(Exception):
    """A simulator broke a rule of ``Simulator``; the text says what was expected and found."""


def play_turns(
    simulator: Simulator,
    controllers: Controllers,
    seed: int,
    fitness: np.ndarray,
    metrics: np.ndarray,
) -> None:
    """Play one trial; ``fitness`` and ``metrics`` are filled."""
    for _ in take_turns(simulator, controllers, seed):
        pass
    fill(simulator.outcome(), fitness, metrics)


def fill(outcome: Outcome, fitness: np.ndarray, metrics: np.ndarray) -> None:
    """Copy an outcome after checking it."""
    if not isinstance(outcome, Outcome):
        raise BrokenContractError(f"outcome must return an Outcome, not {outcome!r:.80}")
    if len(outcome.fitness) != len(fitness) or len(outcome.metrics) != len(metrics):
        raise BrokenContractError(
            f"an outcome must have {len(fitness)} fitness numbers and {len(metrics)} metrics, "
            f"not {len(outcome.fitness)} and {len(outcome.metrics)}"
        )
    fitness[:] = outcome.fitness
    metrics[:] = outcome.metrics


def take_turns(
    simulator: Simulator, controllers: Controllers, seed: int
) -> Iterator[Turn]:
    """Play a trial, and yield each turn before its agents act."""
    turn: Turn | None = simulator.reset(seed)
    if turn is None:
        raise BrokenContractError("reset must return a Turn: an agent must act")
    owners = simulator.owners  # only now: they may differ by trial
    for _ in range(MAX_TURNS):
        yield turn
        observations = _observations(simulator, turn)
        if min(turn.agents) < 0 or max(turn.agents) >= len(owners):
            raise BrokenContractError(
                f"agents must be in {range(len(owners))}, not {list(turn.agents)}"
            )
        turn = simulator.step(
            controllers.decide(
                turn.agents, [owners[agent] for agent in turn.agents], observations
            )
        )
        if turn is None:
            return
    raise BrokenContractError(
        f"the trial continues after {MAX_TURNS:,} turns: step must return None when it is over"
    )


def _observations(simulator: Simulator, turn: Turn) -> np.ndarray:
    """Return the observations of a turn after checking them: (agents, inputs) float32."""
    if not isinstance(turn, Turn):
        raise BrokenContractError(
            f"reset and step must return a Turn, and step None at the end; not {turn!r:.80}"
        )
    if not len(turn.agents):
        raise BrokenContractError(
            "a turn must name an agent; a trial that is over returns None"
        )
    observations = np.ascontiguousarray(turn.observations, np.float32)
    expected = len(turn.agents), simulator.inputs
    if observations.shape != expected:
        raise BrokenContractError(
            f"observations must be {expected}, not {observations.shape}"
        )
    if not np.isfinite(observations).all():
        row, number = np.argwhere(~np.isfinite(observations))[0]
        name = f" ({simulator.sensors[number]})" if simulator.sensors else ""
        agent = turn.agents[row]
        value = observations[row, number]
        raise BrokenContractError(
            f"observations must be finite; number {number}{name} of agent {agent} is {value}"
        )
    return observations
