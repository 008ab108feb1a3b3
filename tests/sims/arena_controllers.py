"""Handwritten controllers for the arena tasks: (robots, inputs) -> (robots, outputs), float32."""

import numpy as np

RAYS = np.array([[np.cos(a), np.sin(a)] for a in np.arange(8) * np.pi / 4])


def steer(goal: np.ndarray, slow: np.ndarray | float = 1.0) -> np.ndarray:
    """Drive wheels that turn robots towards a direction in their frame and move them there."""
    ahead, aside = goal[:, 0], goal[:, 1]
    length = np.maximum(np.hypot(ahead, aside), 1e-9)
    turn, forward = aside / length, np.maximum(ahead / length, 0.0) * slow
    turn = np.where(ahead < 0, np.where(aside < 0, -1.0, 1.0), turn)
    return (
        0.5 + 0.5 * np.clip(np.column_stack([forward - turn, forward + turn]), -1, 1)
    ).astype(np.float32)


def away_from_what_is_near(seen: np.ndarray, from_nearness: float) -> np.ndarray:
    return -np.maximum(seen[:, :8] - from_nearness, 0.0) @ RAYS


def ahead(seen: np.ndarray) -> np.ndarray:
    return np.tile([1.0, 0.0], (len(seen), 1))


def aggregation(seen: np.ndarray) -> np.ndarray:
    """Drive to the neighbours; a robot that sees none goes straight on and avoids walls."""
    others = seen[:, 8:10]
    alone = (others == 0).all(axis=1, keepdims=True)
    return steer(
        np.where(alone, ahead(seen) + 4 * away_from_what_is_near(seen, 0.5), others)
    )


def dispersion(seen: np.ndarray) -> np.ndarray:
    """Drive away from the neighbours and from walls."""
    goal = -seen[:, 8:10] + away_from_what_is_near(seen, 0.4)
    return steer(goal, np.minimum(1.0, 3 * np.hypot(goal[:, 0], goal[:, 1])))


def foraging(seen: np.ndarray) -> np.ndarray:
    """Drive to the nest with an item, else to an item, else straight on; around obstacles."""
    item, nest, carries = seen[:, 10:12], seen[:, 12:14], seen[:, 14:15] > 0
    sees = (item != 0).any(axis=1, keepdims=True)
    goal = np.where(carries, nest, np.where(sees, item, ahead(seen)))
    return steer(goal + 3 * away_from_what_is_near(seen, 0.7))


def consensus(seen: np.ndarray) -> np.ndarray:
    """Drive about and send the mean of what is read and heard."""
    return np.column_stack(
        [strolling(seen), 0.5 * seen[:, 10] + 0.5 * seen[:, 11]]
    ).astype(np.float32)


def patient_consensus(seen: np.ndarray) -> np.ndarray:
    """Send the opinion heard, shifted slightly towards the reading.

    The weight 0.02 beats 0.05 and 0.1 and is near the best known.
    """
    return np.column_stack(
        [strolling(seen), 0.02 * seen[:, 10] + 0.98 * seen[:, 11]]
    ).astype(np.float32)


def strolling(seen: np.ndarray) -> np.ndarray:
    return steer(ahead(seen) + 4 * away_from_what_is_near(seen, 0.6))
