"""The kernels of ``physics``: motors, lasers, and what its tasks observe."""

# mypy: disable-error-code=no-untyped-def
# because numba infers the types of kernels.

import numpy as np

from zswarm.kernels.jit import float32, float64, inline, int64, kernel, void
from zswarm.kernels.portable import cos, sin
from zswarm.kernels.signatures import Float32Rows, Float64Rows, Float64s, Int64s
from zswarm.sims.robot_interface import velocity
from zswarm.sims.toolbox.sensors import inverse, to_disc, to_rectangle, to_square

SECTORS = 8  # of a laser scan
SCAN = tuple(f"scan_{sector}" for sector in range(SECTORS))  # from the right to the left
OUTSIDE = 1e6  # m; bodies that were taken out are beyond this, each at a separate place
FAR = OUTSIDE / 2
ZERO, ONE = np.float32(0), np.float32(1)
# ``rows``: float64, for each robot, then for each movable, then for the ground; speeds per step.
X, Y, ANGLE, SPEED_X, SPEED_Y, TURNING = range(6)


@kernel(
    void(
        Float64Rows,
        Int64s,
        Float64s,
        Float64s,
        float64,
        float64,
        float64,
        float64,
        float64,
        float64,
        float64,
        Float64Rows,
    )
)
def push(
    rows,
    inside,
    linear,
    angular,
    speed,
    turn,
    mass,
    moment,
    force,
    torque,
    duration_s,
    forces,
):
    """Set the wheels' forces in a step of the physics: those for the wanted velocity, limited.

    Args:
        linear, angular, speed, turn, force, torque: m/s, rad/s, N, N m; the last four are the most
        of each.
        duration_s: of the step.
        forces: (robots + things + 1, 3) float64, filled for robots: kg m/step^2 along x and y, and
        kg m^2/step^2.
    """
    most = force * duration_s * duration_s
    most_around = torque * duration_s * duration_s
    for robot in range(inside.shape[0]):
        forces[robot, 0] = 0.0
        forces[robot, 1] = 0.0
        forces[robot, 2] = 0.0
        if inside[robot] == 0:
            continue
        ahead = max(min(linear[robot], speed), -speed)
        around = max(min(angular[robot], turn), -turn)
        ahead *= duration_s
        around *= duration_s
        towards = rows[robot, ANGLE] + 0.5 * around  # the middle of the arc
        along = ahead * cos(towards)
        aside = ahead * sin(towards)
        x = (along - rows[robot, SPEED_X]) * mass
        y = (aside - rows[robot, SPEED_Y]) * mass
        size = np.sqrt(x * x + y * y)
        if size > most:
            x *= most / size
            y *= most / size
        turning = (around - rows[robot, TURNING]) * moment
        forces[robot, 0] = x
        forces[robot, 1] = y
        forces[robot, 2] = max(min(turning, most_around), -most_around)


@inline(counts=False, inner=True)
def locate(rows, inside, poses, headings, things):
    """Write the poses of robots and things that were not taken out."""
    robots = inside.shape[0]
    for robot in range(robots):
        if inside[robot]:
            poses[robot, X] = rows[robot, X]
            poses[robot, Y] = rows[robot, Y]
            poses[robot, ANGLE] = rows[robot, ANGLE]
            headings[robot, 0] = cos(rows[robot, ANGLE])
            headings[robot, 1] = sin(rows[robot, ANGLE])
    for thing in range(things.shape[0]):
        row = robots + thing
        if abs(rows[row, X]) < FAR:
            things[thing, X] = rows[row, X]
            things[thing, Y] = rows[row, Y]
            things[thing, ANGLE] = rows[row, ANGLE]


@kernel(
    void(
        Float64Rows,
        Int64s,
        Float64Rows,
        Int64s,
        Float64s,
        Float64Rows,
        float64,
        float64,
        Float64Rows,
        Float64Rows,
        Float64Rows,
        Float32Rows,
    )
)
def look(
    rows, inside, walls, boxes, half, rays, radius, reach, poses, headings, things, ranges
):
    """Write the poses of robots and things that were not taken out, and what lasers read.

    Lasers see walls, boxes and other robots; discs are too low.

    Args:
        boxes: (boxes,) int64, which of the things are.
        half: (things,) float64, half the sides of boxes.
        rays: (rays, 2) float64, in the robot's frame.
        poses, headings, things, ranges: filled, see ``RobotWorld``.
    """
    robots = inside.shape[0]
    locate(rows, inside, poses, headings, things)
    squares = np.empty((boxes.shape[0], 3))
    for box in range(boxes.shape[0]):
        angle = things[boxes[box], ANGLE]
        squares[box, 0] = cos(angle)
        squares[box, 1] = sin(angle)
        squares[box, 2] = half[boxes[box]]
    for robot in range(robots):
        if inside[robot] == 0:
            continue
        x, y = poses[robot, X], poses[robot, Y]
        ahead, left = headings[robot, 0], headings[robot, 1]
        for ray in range(rays.shape[0]):
            dx = ahead * rays[ray, 0] - left * rays[ray, 1]
            dy = left * rays[ray, 0] + ahead * rays[ray, 1]
            far = reach
            per_x = inverse(dx)
            per_y = inverse(dy)
            for wall in range(walls.shape[0]):
                from_x = walls[wall, 0] - x
                from_y = walls[wall, 1] - y
                until_x = walls[wall, 2] - x
                until_y = walls[wall, 3] - y
                far = to_rectangle(from_x, from_y, until_x, until_y, per_x, per_y, far)
            for box in range(boxes.shape[0]):
                to_x = things[boxes[box], X] - x
                to_y = things[boxes[box], Y] - y
                c = squares[box, 0]
                s = squares[box, 1]
                size = squares[box, 2]
                far = to_square(to_x, to_y, c, s, size, dx, dy, far)
            for other in range(robots):
                if other != robot and inside[other]:
                    far = to_disc(
                        poses[other, X] - x, poses[other, Y] - y, dx, dy, radius, far
                    )
            ranges[robot, ray] = far


@kernel(void(Float32Rows, float32, Float32Rows))
def sectors(ranges, reach, observations):
    """Write 1 - shortest range / reach in each eighth of a scan into the first columns.

    Args:
        ranges: (robots, rays) float32.
        observations: (robots, >= SECTORS) float32, filled.
    """
    rays = ranges.shape[1]
    for robot in range(ranges.shape[0]):
        for sector in range(SECTORS):
            nearest = reach
            for ray in range(sector * rays // SECTORS, (sector + 1) * rays // SECTORS):
                nearest = min(nearest, ranges[robot, ray])
            observations[robot, sector] = ONE - nearest / reach


@kernel(
    void(
        Float64Rows,
        Float64Rows,
        Float64Rows,
        Int64s,
        float64,
        int64,
        Float64s,
        Float32Rows,
        Float64s,
        Int64s,
    )
)
def bearings(
    poses,
    headings,
    targets,
    gone,
    reach,
    column,
    towards,
    observations,
    distances,
    nearest,
):
    """Write the nearest target and a direction, both in each robot's frame, into five columns.

    The first are the target's direction, a unit vector, and how near it is: 1 - distance / reach.
    These are zeros without a target within reach.

    Args:
        targets: (targets, >= 2) float64: x, y.
        gone: (targets,) int64, not 0 for those that do not count.
        column: the first of the five.
        towards: (2,) float64, factors that turn a heading into the direction.
        distances: (robots,) float64, filled: m; infinite without a target.
        nearest: (robots,) int64, filled: index of the target, the first of equals; -1 without any.
    """
    for robot in range(poses.shape[0]):
        best = np.inf
        which = -1
        for target in range(targets.shape[0]):
            if gone[target] == 0:
                dx = targets[target, 0] - poses[robot, X]
                dy = targets[target, 1] - poses[robot, Y]
                if dx * dx + dy * dy < best:
                    best = dx * dx + dy * dy
                    which = target
        distance = np.sqrt(best)
        distances[robot] = distance
        nearest[robot] = which
        observations[robot, column : column + 3] = ZERO
        observations[robot, column + 3] = headings[robot, 0] * towards[0]
        observations[robot, column + 4] = headings[robot, 1] * towards[1]
        if which >= 0 and 0.0 < distance <= reach:
            dx = (targets[which, 0] - poses[robot, X]) / distance
            dy = (targets[which, 1] - poses[robot, Y]) / distance
            observations[robot, column] = (
                dx * headings[robot, 0] + dy * headings[robot, 1]
            )
            observations[robot, column + 1] = (
                dy * headings[robot, 0] - dx * headings[robot, 1]
            )
            observations[robot, column + 2] = 1.0 - distance / reach


@kernel(void(Float32Rows, Int64s, float64, float64, Float64s, Float64s))
def command(actions, agents, speed, turn, linear, angular):
    """Convert what robots decided to velocities, see ``robot_interface.velocity``.

    Args:
        actions: (agents, 2) float32: drive, turn.
        agents: (agents,) int64, which robots these are.
        linear, angular: (robots,) float64, filled for them: m/s, rad/s.
    """
    for row in range(agents.shape[0]):
        linear[agents[row]] = velocity(actions[row, 0], speed)
        angular[agents[row]] = velocity(actions[row, 1], turn)
