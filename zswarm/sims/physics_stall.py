"""Simulate robots as Stage does: at once at their velocity, and a move that touches is undone.

After rtv/Stage 4.3, ``ModelPosition::Move``: in each step of the physics a robot drives straight
along its heading and then turns; if it would touch something there, it stays where it was, its
heading included. There are no masses and no friction, and nothing is pushed.
"""

# mypy: disable-error-code=no-untyped-def
# because numba infers the types of kernels.

import numpy as np

from zswarm.kernels.jit import float64, inline, kernel, void
from zswarm.kernels.portable import cos, sin
from zswarm.kernels.signatures import Float64Rows, Float64s, Int64s
from zswarm.sims.physics import RobotWorld, directions
from zswarm.sims.physics_kernels import ANGLE, X, Y


class StallWorld(RobotWorld):
    """Robots and walls; a robot that would touch something does not move."""

    def start(self, poses: np.ndarray, things: np.ndarray) -> None:
        """Begin a trial at (robots, 3) float64 poses; there are no things."""
        del things
        settings = self.settings
        self._rays = directions(settings.view, settings.rays)  # needs the compiler
        self._linear[:] = self._angular[:] = 0
        self.inside[:] = 1
        self._rows[: settings.robots, : ANGLE + 1] = poses
        self._look()

    def drive(self, linear: np.ndarray, angular: np.ndarray) -> None:
        """Let ``step_s`` pass, see ``RobotWorld.drive``."""
        settings = self.settings
        for substep in range(settings.substeps):
            if substep == settings.substeps - 1:
                self._look()  # Stage scans before it moves
            stall(
                self._rows,
                self.inside,
                np.clip(linear, -settings.speed, settings.speed) * self._substep_s,
                np.clip(angular, -settings.turn, settings.turn) * self._substep_s,
                settings.radius,
                self.walls,
            )
        inside = self.inside != 0
        self.poses[inside] = self._rows[: settings.robots, : ANGLE + 1][inside]

    def take_out(self, robot: int) -> None:
        """Remove a robot from this world."""
        self.inside[robot] = 0


@inline
def touches(rows, inside, x, y, radius, walls, robot):
    """Return whether a robot at a place would touch a wall or another robot."""
    square = radius * radius
    for wall in range(walls.shape[0]):
        dx = x - max(walls[wall, 0], min(x, walls[wall, 2]))
        dy = y - max(walls[wall, 1], min(y, walls[wall, 3]))
        if dx * dx + dy * dy < square:
            return True
    for other in range(inside.shape[0]):
        if other != robot and inside[other]:
            dx, dy = x - rows[other, X], y - rows[other, Y]
            if dx * dx + dy * dy < 4.0 * square:
                return True
    return False


@kernel(void(Float64Rows, Int64s, Float64s, Float64s, float64, Float64Rows))
def stall(rows, inside, ahead, around, radius, walls):
    """Move each robot, one after the other, unless it would touch something there.

    Args:
        rows: see ``physics_kernels``.
        inside: (robots,) int64, 0 for those that were taken out.
        ahead, around: (robots,) float64, m and radians of each in this step of the physics.
        radius: m, of a robot.
        walls: (walls, 4) float64.
    """
    for robot in range(inside.shape[0]):
        if inside[robot] == 0:
            continue
        x = rows[robot, X] + ahead[robot] * cos(rows[robot, ANGLE])
        y = rows[robot, Y] + ahead[robot] * sin(rows[robot, ANGLE])
        if not touches(rows, inside, x, y, radius, walls, robot):
            rows[robot, X] = x
            rows[robot, Y] = y
            rows[robot, ANGLE] += around[robot]
