"""Play one trial of the room, in this process or in ROS: all poses, and the outcome."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from zswarm import evaluate
from zswarm.kernels.random import Stream
from zswarm.sims.simulator import Outcome

Policy = Callable[[np.ndarray], np.ndarray]  # (robots, inputs) -> (robots, 2), float32


class Played(NamedTuple):
    """Describe the poses and the outcome of a trial."""

    poses: np.ndarray  # (steps + 1, robots, 4) float64
    outcome: Outcome

    @property
    def bits(self) -> bytes:
        """Return all poses and the fitness as bytes."""
        return self.poses.tobytes() + np.array(self.outcome.fitness).tobytes()


def built(simulator: str, **settings: Any) -> Any:
    """Build a simulator by name."""
    return evaluate.build(simulator, settings, "fully-meshed", {})[0]


def by_policy(simulator: Any, policy: Policy, seed: int) -> Played:
    """Play a trial with a handwritten policy."""
    turn, poses = simulator.reset(seed), [simulator.poses.copy()]
    while turn is not None:
        turn = simulator.step(policy(turn.observations))
        poses.append(simulator.poses.copy())
    return Played(np.stack(poses), simulator.outcome())


def by_network(
    simulator: Any, seed: int, network: str = "fully-meshed", **shape: Any
) -> Played:
    """Play a trial of a random recurrent network."""
    _, drawn = evaluate.build("turtlebot-exit", {}, network, shape)
    parameters = drawn.parameters(drawn.random(1, Stream(seed)))
    poses = [
        simulator.poses.copy() for _ in evaluate.turns(simulator, drawn, parameters, seed)
    ]
    return Played(np.stack([*poses, simulator.poses]), simulator.outcome())
