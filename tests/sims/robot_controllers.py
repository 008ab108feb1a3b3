"""Handwritten controllers for the robots of ``physics``.

Each maps (robots, inputs) to (robots, 2), float32.
"""

import numpy as np

# Of the laser's eighths, counter-clockwise.
CENTRES = np.radians((np.arange(8) + 0.5) * 270 / 8 - 135)
VIEW = np.column_stack([np.cos(CENTRES), np.sin(CENTRES)])


def steer(goal: np.ndarray) -> np.ndarray:
    """Turn towards a direction in the robots' frame, driving faster the more it lies ahead."""
    angle = np.arctan2(goal[:, 1], goal[:, 0])
    drive = 0.5 + 0.5 * np.maximum(np.cos(angle), 0)
    return np.column_stack([drive, 0.5 + 0.5 * np.clip(angle, -1, 1)]).astype(np.float32)


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.hypot(vectors[:, 0], vectors[:, 1]), 1e-9)[:, None]


def away_from_what_is_near(seen: np.ndarray, from_nearness: float) -> np.ndarray:
    return -np.maximum(seen[:, :8] - from_nearness, 0.0) @ VIEW


def turtlebot_exit(seen: np.ndarray) -> np.ndarray:
    """Drive to the exit, around obstacles."""
    return steer(seen[:, 8:10] + 8 * away_from_what_is_near(seen, 0.85))


def behind(
    seen: np.ndarray, way: np.ndarray, reach: float, behind_m: float, clear_m: float
) -> np.ndarray:
    """Drive to the side of a body from which to push it in a direction, and then straight on.

    Args:
        way: (robots, 2) where it is to be pushed, in the robots' frame.
        reach: m that robots see.
        behind_m: from its middle to where pushing begins.
        clear_m: from its middle; a robot that is nearer does not go around it.
    """
    to_thing = seen[:, 8:10]
    offset = to_thing * ((1 - seen[:, 10:11]) * reach)
    lies_before = (to_thing * way).sum(axis=1)
    spot = offset - way * behind_m
    # Across the way to the body, away from its destination.
    aside = unit(lies_before[:, None] * to_thing - way)
    near = np.hypot(offset[:, 0], offset[:, 1]) < clear_m
    around = np.where(near[:, None], aside - 0.3 * to_thing, spot)
    pushing = lies_before > 0.85
    return np.where(
        pushing[:, None], unit(offset) - 0.4 * (way - unit(offset)), unit(around)
    )


def from_behind(seen: np.ndarray) -> np.ndarray:
    """Push a body that lies in the right direction; drive back if on its wrong side."""
    to_thing, way = seen[:, 8:10], seen[:, 11:13]
    before = (to_thing * way).sum(axis=1, keepdims=True) > 0.3
    return np.where(before, to_thing, -way)


def box_pushing(seen: np.ndarray) -> np.ndarray:
    """Push the box if it lies ahead, else get behind it."""
    return steer(from_behind(seen))


def clever_box_pushing(seen: np.ndarray) -> np.ndarray:
    """Drive behind the box, around it, and push."""
    return steer(behind(seen, seen[:, 11:13], 4.0, 0.55, 0.75))


def strolling(seen: np.ndarray) -> np.ndarray:
    return [[1.0, 0.0]] + 8 * away_from_what_is_near(seen, 0.85)


def foraging_physical(seen: np.ndarray) -> np.ndarray:
    """Push the nearest puck if it is ahead, else get behind it; stroll if no puck is visible."""
    return steer(
        np.where(
            (seen[:, 8:10] != 0).any(axis=1, keepdims=True),
            from_behind(seen),
            strolling(seen),
        )
    )


def clever_foraging_physical(seen: np.ndarray) -> np.ndarray:
    """Drive behind the nearest puck, around it, and push."""
    goal = behind(seen, seen[:, 11:13], 4.0, 0.35, 0.4)
    return steer(
        np.where((seen[:, 8:10] != 0).any(axis=1, keepdims=True), goal, strolling(seen))
    )


def foraging_physical_carry(seen: np.ndarray) -> np.ndarray:
    """Drive to a puck, and home with it, around obstacles."""
    goal = np.where(seen[:, 13:14] > 0, seen[:, 11:13], seen[:, 8:10])
    goal = np.where((goal != 0).any(axis=1, keepdims=True), goal, [[1.0, 0.0]])
    return steer(goal + 8 * away_from_what_is_near(seen, 0.85))
