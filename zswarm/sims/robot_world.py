"""A floor with walls, robots on two wheels, and things that they push: the world of the simulators on pymunk.

The world knows commands (linear and angular velocity) and readings (poses, a laser scan), as a robot's driver does, and no task.
Axes are those of ROS: x ahead, y to the left, angles in radians, counter-clockwise from x. Lengths are in m, masses in kg.

pymunk moves discs and boxes and has them push each other; motors and lasers are kernels. What pymunk computes has the same bits
on machines of one architecture, whatever their C library. It asks that for powers, sines and cosines, which differ in the last
bit between C libraries and processors. So its unit of time is a step of the physics: x to the power of 1 is x everywhere. And
boxes, and robots that hold something, are at angle 0 for it: what turns with them is turned here (``_turn_here``). How far a disc
has turned makes no difference to it.
"""

from collections.abc import Callable, Sequence
from typing import Annotated, NamedTuple

import msgspec
import numpy as np
import pymunk
from msgspec import Meta
from pymunk import batch
from pymunk.batch import BodyFields

from zswarm.draws import Stream
from zswarm.errors import ConfigError
from zswarm.jit import array, float32, float64, inline, int64, kernel, void
from zswarm.portable import PI, cos, exp, sin
from zswarm.sims.robot_interface import velocity
from zswarm.sims.simulator import Body, Frame, Place, Ray

LIBRARIES = ("pymunk",)  # its machine code plays the trials
GRAVITY = 9.81  # m/s^2
TRACK = 0.65  # half the distance between the wheels / radius; that of a TurtleBot 2
SLOP = 0.001  # m that bodies may overlap; without any, contacts come and go
PARTING = 6.3  # 1/s: of what they overlap more, and of the way to what a robot holds, exp(-PARTING t) is left after t s
RIM = 0.1  # m, thickness of the walls around a room
OUTSIDE = 1e6  # m from here robots and things stand that were taken out, each at a place of its own
TRIES = 4096  # places that are tried for all robots or things of a start
FILLED = 0.35  # of an area at most may be covered at the start, so that a few tries find a place
SECTORS = 8
SCAN = tuple(f"scan_{sector}" for sector in range(SECTORS))  # from the right to the left
ZERO, ONE = np.float32(0), np.float32(1)
STEEP = 1e12  # in place of 1 / 0

# ``rows``: float64, one for each robot, then for each thing, then for the ground; speeds are in m and radians per step.
X, Y, ANGLE, SPEED_X, SPEED_Y, TURNING = range(6)
READ = BodyFields.POSITION | BodyFields.ANGLE | BodyFields.VELOCITY | BodyFields.ANGULAR_VELOCITY
WRITTEN = BodyFields.FORCE | BodyFields.TORQUE
# pymunk never gives a buffer's memory back, so there is one of each; what is in it is used at once.
READ_BUFFER, WRITE_BUFFER = batch.Buffer(), batch.Buffer()

Pose = tuple[float, float, float]  # m, m, radians
Area = tuple[float, float, float, float]  # m: least x, least y, greatest x, greatest y
Metres = Annotated[float, Meta(ge=1e-3, le=1e3)]


class RobotSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of ``[problem.settings]`` that all simulators in this world have; the defaults are a TurtleBot 2's."""

    steps: Annotated[int, Meta(ge=1, le=1_000_000, description="steps of a trial")] = 150
    step_s: Annotated[float, Meta(ge=1e-3, le=10, description="s of a step: robots decide once in each")] = 0.2
    substeps: Annotated[int, Meta(ge=1, le=1_000, description="steps of the physics in a step")] = 2
    robots: Annotated[int, Meta(ge=1, le=200, description="robots")] = 8
    radius: Annotated[Metres, Meta(description="m, of a robot")] = 0.177
    mass: Annotated[float, Meta(ge=1e-3, le=1e4, description="kg, of a robot")] = 6.3
    speed: Annotated[float, Meta(ge=0, le=100, description="m/s of a robot at most")] = 0.65
    turn: Annotated[float, Meta(ge=0, le=100, description="rad/s of a robot at most")] = 3.14
    force: Annotated[float, Meta(gt=0, le=1e6, description="N with which a robot drives and brakes at most")] = 15.0
    friction: Annotated[float, Meta(ge=0, le=10, description="coefficient of friction where robots, things and walls touch")] = (
        0.3
    )
    restitution: Annotated[
        float, Meta(ge=0, le=1, description="share of the speed that is left after a bump: 0 stays, 1 bounces off")
    ] = 0.1
    rays: Annotated[int, Meta(ge=SECTORS, le=2_000, description="rays of a robot's laser scanner")] = 36
    view: Annotated[
        float, Meta(ge=1, le=360, description="degrees from the first ray to the last, half of them to each side")
    ] = 270.0
    range: Annotated[Metres, Meta(description="m that a ray reaches; so much is read where nothing is")] = 4.0


class Thing(NamedTuple):
    """Something that robots push; the ground holds it by friction."""

    kind: str
    size: float  # m, half its side, or its radius
    mass: float  # kg
    grip: float  # coefficient of friction with the ground
    is_box: bool


class RobotWorld:
    """Robots, walls and things, from the start of a trial on.

    Attributes:
        walls: (walls, 4) float64, an ``Area`` each, those around the room included.
        inside: (robots,) int64, 0 for those that were taken out.
        poses: (robots, 3) float64: x, y, angle; of one that was taken out, where that was.
        headings: (robots, 2) float64, unit vectors.
        ranges: (robots, rays) float32, the last scan: the first ray is on the right; ``settings.range`` where nothing is.
        things: (things, 3) float64, as ``poses``.
    """

    def __init__(self, settings: RobotSettings, room: Area, walls: Sequence[Area], things: Sequence[Thing] = ()) -> None:
        left, low, right, high = self.room = room
        around = [
            (left - RIM, low - RIM, right + RIM, low),
            (left - RIM, high, right + RIM, high + RIM),
            (left - RIM, low, left, high),
            (right, low, right + RIM, high),
        ]
        self.settings, self._of = settings, tuple(things)
        self.walls = np.array([*around, *walls])
        angles = [(settings.view * (ray / (settings.rays - 1)) - settings.view / 2) * PI / 180 for ray in range(settings.rays)]
        self._rays = np.array([[cos(angle), sin(angle)] for angle in angles])
        self._moment = 0.5 * settings.mass * settings.radius * settings.radius  # kg m^2, of a disc
        self._substep_s = settings.step_s / settings.substeps
        self._left = exp(-PARTING * self._substep_s)
        robots = settings.robots
        self._rows = np.zeros((robots + len(things) + 1, 6))
        self._turned = np.zeros(robots + len(things) + 1)  # by how much more than pymunk has it turned
        self._forces = np.zeros((robots + len(things) + 1, 3))
        self._linear, self._angular = np.zeros(robots), np.zeros(robots)
        self.inside = np.ones(robots, np.int64)
        self.poses, self.headings = np.zeros((robots, 3)), np.zeros((robots, 2))
        self.ranges = np.zeros((robots, settings.rays), np.float32)
        self.things = np.zeros((len(things), 3))
        self._boxes = np.array([number for number, thing in enumerate(things) if thing.is_box], np.int64)
        self._half = np.array([thing.size for thing in things])

    def start(self, poses: np.ndarray, things: np.ndarray) -> None:
        """Begin a trial with everything at rest.

        Args:
            poses: (robots, 3) float64, of the robots.
            things: (things, 3) float64, of the things.
        """
        settings = self.settings
        self._space = space = pymunk.Space()
        space.collision_slop, space.collision_bias = SLOP, self._left
        for left, low, right, high in self.walls.tolist():
            self._touching(pymunk.Poly(space.static_body, [(left, low), (right, low), (right, high), (left, high)]))
        self._bodies: list[pymunk.Body] = []
        self._joints: dict[int, pymunk.PivotJoint] = {}  # of robots that hold something
        self._turned[:] = 0
        self._interrupted: BaseException | None = None
        for pose in poses.tolist():
            body = self._body(settings.mass, self._moment, pose)
            self._touching(pymunk.Circle(body, settings.radius))
        for thing, pose in zip(self._of, things.tolist(), strict=True):
            self._put(thing, pose)
        self._linear[:] = self._angular[:] = 0
        self.inside[:] = 1
        self._rows[:] = 0
        self._rows[: settings.robots, : ANGLE + 1] = poses
        self._rows[settings.robots : -1, : ANGLE + 1] = things
        self._look()

    def drive(self, linear: np.ndarray, angular: np.ndarray) -> None:
        """Let ``step_s`` pass.

        Args:
            linear: (robots,) float64, m/s ahead, cut to what robots can; not looked at for those that were taken out.
            angular: (robots,) float64, rad/s counter-clockwise, likewise.
        """
        settings, space = self.settings, self._space
        WRITE_BUFFER.set_float_buf(self._forces)
        for _ in range(settings.substeps):
            push(
                self._rows, self.inside, linear, angular, settings.speed, settings.turn, settings.mass, self._moment,
                settings.force, settings.force * settings.radius * TRACK, self._substep_s, self._forces,
            )  # fmt: skip
            batch.set_space_bodies(space, WRITTEN, WRITE_BUFFER)
            space.step(1.0)
            if self._interrupted:
                raise self._interrupted
            READ_BUFFER.clear()
            batch.get_space_bodies(space, READ, READ_BUFFER)
            self._rows.ravel()[:] = np.frombuffer(READ_BUFFER.float_buf())
            self._rows[:, ANGLE] += self._turned
        self._look()

    def obey(self, actions: np.ndarray, agents: np.ndarray) -> None:
        """Let ``step_s`` pass while robots do what they decided.

        Args:
            actions: (agents, 2) float32: drive, turn; 0 full speed back or to the right, .5 none, 1 ahead or to the left.
            agents: (agents,) int64, which robots these are; the others do as before.
        """
        command(np.ascontiguousarray(actions), agents, self.settings.speed, self.settings.turn, self._linear, self._angular)
        self.drive(self._linear, self._angular)

    def hold(self, robot: int, thing: int) -> None:
        """A robot holds a disc at its front from now on."""
        body, held = self._bodies[robot], self._bodies[self.settings.robots + thing]
        joint = pymunk.PivotJoint(body, held, (0, 0), (0, 0))
        joint.collide_bodies, joint.error_bias = False, self._left
        self._space.add(joint)
        self._joints[robot] = joint
        arm = self.settings.radius + self._of[thing].size

        def turn(c: float, s: float) -> None:
            joint.anchor_a = arm * c, arm * s

        self._turn_here(robot, turn)

    def let_go(self, robot: int) -> None:
        """It holds that no more."""
        self._space.remove(self._joints.pop(robot))
        self._bodies[robot].position_func = pymunk.Body.update_position

    def take_out(self, robot: int) -> None:
        """A robot is in this world no more."""
        self.inside[robot] = 0
        self._move_outside(robot)

    def take_out_thing(self, thing: int) -> None:
        """A thing is in this world no more; it is shown where it was."""
        self._move_outside(self.settings.robots + thing)

    def frame(self, places: Sequence[Place], robots: Sequence[str], things: Sequence[str]) -> Frame:
        """A picture.

        Args:
            places: beside the walls, in this world's axes: x and y are of the corner with the least of both.
            robots: per robot what to call it.
            things: per thing likewise.
        """
        left, low, right, high = self.room
        top = high + RIM
        walls = [Place("wall", x, y, to_x - x, to_y - y) for x, y, to_x, to_y in self.walls.tolist()]
        shown = [
            Place(place.kind, place.x - left + RIM, top - place.y - place.height, place.width, place.height)
            for place in (*places, *walls)
        ]
        bodies = [
            Body(kind, x - left + RIM, top - y, self.settings.radius, -angle)
            for kind, (x, y, angle) in zip(robots, self.poses.tolist(), strict=True)
        ]
        bodies += [
            Body(kind, x - left + RIM, top - y, thing.size, -angle, "square" if thing.is_box else "diamond")
            for kind, thing, (x, y, angle) in zip(things, self._of, self.things.tolist(), strict=True)
        ]
        view = self.settings.view * PI / 180
        rays = [
            Ray(sector, view * (0.5 - (sector + 0.5) / SECTORS), self.settings.range, 0.0, view / SECTORS)
            for sector in range(SECTORS)
        ]
        return Frame(right - left + 2 * RIM, high - low + 2 * RIM, shown, bodies, rays=rays)

    def _put(self, thing: Thing, pose: Sequence[float]) -> None:
        """Friction with the ground is a joint with limited force: it holds what stands and brakes what moves."""
        weight = thing.mass * GRAVITY * thing.grip * self._substep_s * self._substep_s
        if thing.is_box:
            side, size = 2 * thing.size, thing.size
            body = self._body(thing.mass, thing.mass * side * side / 6, pose)
            box = pymunk.Poly.create_box(body, (side, side))

            def turn(c: float, s: float) -> None:
                p, q = size * (c - s), size * (c + s)
                box.unsafe_set_vertices([(p, q), (-q, p), (-p, -q), (q, -p)])

            self._turn_here(len(self._bodies) - 1, turn)
            self._touching(box)
            arm = 0.3826 * side  # mean distance of a square's points from its middle
        else:
            body = self._body(thing.mass, thing.mass * thing.size * thing.size / 2, pose)
            self._touching(pymunk.Circle(body, thing.size))
            arm = 2 / 3 * thing.size
        ground = self._space.static_body
        sliding, turning = pymunk.PivotJoint(ground, body, (0, 0), (0, 0)), pymunk.GearJoint(ground, body, 0, 1)
        sliding.max_bias = turning.max_bias = 0  # it is not drawn anywhere
        sliding.max_force, turning.max_force = weight, weight * arm
        self._space.add(sliding, turning)

    def _body(self, mass: float, moment: float, pose: Sequence[float]) -> pymunk.Body:
        body = pymunk.Body(mass, moment)
        body.position, body.angle = (pose[0], pose[1]), pose[2]
        self._space.add(body)
        self._bodies.append(body)
        return body

    def _turn_here(self, row: int, turn: Callable[[float, float], None]) -> None:
        """A body does not turn for pymunk from now on; ``turn`` takes cosine and sine of its angle, and turns its parts."""
        turned = self._turned

        def take_over(body: pymunk.Body) -> None:
            turned[row] += body.angle
            body.angle = 0
            turn(cos(turned[row]), sin(turned[row]))

        def move(body: pymunk.Body, duration: float) -> None:
            try:
                pymunk.Body.update_position(body, duration)
                take_over(body)
            except BaseException as error:  # pymunk's C would print it and go on
                self._interrupted = error

        take_over(self._bodies[row])
        self._bodies[row].position_func = move

    def _touching(self, shape: pymunk.Shape) -> None:
        # pymunk multiplies both numbers of the two that touch.
        shape.friction, shape.elasticity = np.sqrt(self.settings.friction), np.sqrt(self.settings.restitution)
        self._space.add(shape)

    def _move_outside(self, row: int) -> None:
        body = self._bodies[row]
        body.position, body.velocity, body.angular_velocity = (OUTSIDE + 10 * row, OUTSIDE), (0, 0), 0

    def _look(self) -> None:
        things = self._rows[self.settings.robots : -1]
        for number, thing in enumerate(things):
            if abs(thing[X]) < OUTSIDE / 2:
                self.things[number] = thing[: ANGLE + 1]
        look(
            self._rows, self.inside, self.walls, self._boxes, self.things, self._half, self._rays, self.settings.radius,
            self.settings.range, self.poses, self.headings, self.ranges,
        )  # fmt: skip


# ---- what tasks in this world share -------------------------------------------------------------------------------


def shrunk(area: Area, by: float) -> Area:
    """An area without its edge: where the centres of discs of that radius may be."""
    left, low, right, high = area
    return left + by, low + by, right - by, high - by


def require_room(where: str, what: str, number: int, radius: float, area: Area) -> None:
    """So many discs can be strewn over an area, which their centres do not leave.

    Raises:
        ConfigError: they do not fit.
    """
    left, low, right, high = area
    if not (right >= left and high >= low):
        raise ConfigError(f"{where}: {what} of radius {radius:g} do not fit in the room")
    space = (right - left + 2 * radius) * (high - low + 2 * radius)
    if number * PI * radius * radius > FILLED * space:
        raise ConfigError(f"{where}: {number} {what} of radius {radius:g} do not fit in the {space:.3g} m2 where they start")


def strew(stream: Stream, number: int, radius: float, area: Area, taken: Sequence[tuple[float, float, float]] = ()) -> list[Pose]:
    """Places for discs in an area, none on another or on what is taken (x, y, radius), and an angle for each.

    Raises:
        RuntimeError: none was found.
    """
    left, low, right, high = area
    xs, ys = stream.uniform(left, right, TRIES).tolist(), stream.uniform(low, high, TRIES).tolist()
    angles = stream.uniform(-PI, PI, number).tolist()
    occupied = list(taken)
    found: list[Pose] = []
    for x, y in zip(xs, ys, strict=True):
        if all((x - a) * (x - a) + (y - b) * (y - b) > (radius + r) * (radius + r) for a, b, r in occupied):
            occupied.append((x, y, radius))
            found.append((x, y, angles[len(found)]))
            if len(found) == number:
                return found
    raise RuntimeError(f"no room at the start for {number} of radius {radius:g} m")


@inline
def inverse(x):  # type: ignore[no-untyped-def]  # compiled
    """1 / x, and something large for what is nearly 0."""
    if abs(x) * STEEP < 1.0:
        return -STEEP if x < 0.0 else STEEP
    return 1.0 / x


@inline
def to_rectangle(left, low, right, high, per_x, per_y, most):  # type: ignore[no-untyped-def]  # compiled
    """How far a ray goes to a rectangle, at most ``most``; the sides are relative to its start, the rest to its direction."""
    x_1, x_2, y_1, y_2 = left * per_x, right * per_x, low * per_y, high * per_y
    enter, leave = max(min(x_1, x_2), min(y_1, y_2)), min(max(x_1, x_2), max(y_1, y_2))
    if enter > leave or leave < 0.0 or enter > most:
        return most
    return max(enter, 0.0)


GRID, TABLE = array(float64), array(float64, 2)


@kernel(void(TABLE, array(int64), GRID, GRID, float64, float64, float64, float64, float64, float64, float64, TABLE))
def push(  # type: ignore[no-untyped-def]  # compiled
    rows, inside, linear, angular, speed, turn, mass, moment, force, torque, duration_s, forces
):
    """What the wheels do in a step of the physics: as much as is needed for the wanted velocity, at most what they can.

    Args:
        linear, angular, speed, turn, force, torque: m/s, rad/s, N, N m; the last four are the most of each.
        duration_s: of the step.
        forces: (robots + things + 1, 3) float64, filled for robots: kg m/step^2 along x and y, and kg m^2/step^2.
    """
    most, most_around = force * duration_s * duration_s, torque * duration_s * duration_s
    for robot in range(inside.shape[0]):
        forces[robot, 0], forces[robot, 1], forces[robot, 2] = 0.0, 0.0, 0.0
        if inside[robot] == 0:
            continue
        ahead, around = max(min(linear[robot], speed), -speed), max(min(angular[robot], turn), -turn)
        ahead, around = ahead * duration_s, around * duration_s
        towards = rows[robot, ANGLE] + 0.5 * around  # the middle of the arc
        along, aside = ahead * cos(towards), ahead * sin(towards)
        x, y = (along - rows[robot, SPEED_X]) * mass, (aside - rows[robot, SPEED_Y]) * mass
        size = np.sqrt(x * x + y * y)
        if size > most:
            x, y = x * (most / size), y * (most / size)
        turning = (around - rows[robot, TURNING]) * moment
        forces[robot, 0], forces[robot, 1], forces[robot, 2] = x, y, max(min(turning, most_around), -most_around)


@kernel(
    void(TABLE, array(int64), TABLE, array(int64), TABLE, GRID, TABLE, float64, float64, TABLE, TABLE, array(float32, 2))
)  # fmt: skip
def look(rows, inside, walls, boxes, things, half, rays, radius, reach, poses, headings, ranges):  # type: ignore[no-untyped-def]  # compiled
    """Where the robots that are inside are, and what their lasers read: walls, boxes and other robots; discs are too low.

    Args:
        boxes: (boxes,) int64, which of the things are.
        half: (things,) float64, half the sides of boxes.
        rays: (rays, 2) float64, in the robot's frame.
        poses, headings, ranges: filled, see ``RobotWorld``.
    """
    robots = inside.shape[0]
    for robot in range(robots):
        if inside[robot]:
            poses[robot, X], poses[robot, Y], poses[robot, ANGLE] = rows[robot, X], rows[robot, Y], rows[robot, ANGLE]
            headings[robot, 0], headings[robot, 1] = cos(rows[robot, ANGLE]), sin(rows[robot, ANGLE])
    squares = np.empty((boxes.shape[0], 3))
    for box in range(boxes.shape[0]):
        angle = things[boxes[box], ANGLE]
        squares[box, 0], squares[box, 1], squares[box, 2] = cos(angle), sin(angle), half[boxes[box]]
    for robot in range(robots):
        if inside[robot] == 0:
            continue
        x, y, ahead, left = poses[robot, X], poses[robot, Y], headings[robot, 0], headings[robot, 1]
        for ray in range(rays.shape[0]):
            dx = ahead * rays[ray, 0] - left * rays[ray, 1]
            dy = left * rays[ray, 0] + ahead * rays[ray, 1]
            far, per_x, per_y = reach, inverse(dx), inverse(dy)
            for wall in range(walls.shape[0]):
                far = to_rectangle(
                    walls[wall, 0] - x, walls[wall, 1] - y, walls[wall, 2] - x, walls[wall, 3] - y, per_x, per_y, far
                )
            for box in range(boxes.shape[0]):
                c, s, size = squares[box, 0], squares[box, 1], squares[box, 2]
                to_x, to_y = things[boxes[box], X] - x, things[boxes[box], Y] - y
                along, aside = c * to_x + s * to_y, c * to_y - s * to_x
                per_along, per_aside = inverse(c * dx + s * dy), inverse(c * dy - s * dx)
                far = to_rectangle(along - size, aside - size, along + size, aside + size, per_along, per_aside, far)
            for other in range(robots):
                if other != robot and inside[other]:
                    to_x, to_y = poses[other, X] - x, poses[other, Y] - y
                    along = to_x * dx + to_y * dy
                    if along > 0.0:
                        aside = to_y * dx - to_x * dy
                        chord = radius * radius - aside * aside
                        if chord > 0.0:
                            far = min(far, max(along - np.sqrt(chord), 0.0))
            ranges[robot, ray] = far


@kernel(void(array(float32, 2), float32, array(float32, 2)))
def sectors(ranges, reach, observations):  # type: ignore[no-untyped-def]  # compiled
    """How near the nearest thing in each eighth of a scan is: 1 - shortest range / reach, written into the first columns.

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


@kernel(void(TABLE, TABLE, TABLE, array(int64), float64, int64, array(float32, 2), GRID, array(int64)))
def bearings(poses, headings, targets, gone, reach, column, observations, distances, nearest):  # type: ignore[no-untyped-def]  # compiled
    """Where the nearest target is in each robot's frame, written into three columns.

    They are its direction, a unit vector, and how near it is: 1 - distance / reach. All are zeros without a target within reach.

    Args:
        targets: (targets, >= 2) float64: x, y.
        gone: (targets,) int64, not 0 for those that do not count.
        column: the first of the three.
        distances: (robots,) float64, filled: m; infinite without a target.
        nearest: (robots,) int64, filled: index of the target, the first of equals; -1 without any.
    """
    for robot in range(poses.shape[0]):
        best, which = np.inf, -1
        for target in range(targets.shape[0]):
            if gone[target] == 0:
                dx, dy = targets[target, 0] - poses[robot, X], targets[target, 1] - poses[robot, Y]
                if dx * dx + dy * dy < best:
                    best, which = dx * dx + dy * dy, target
        distance = np.sqrt(best)
        distances[robot], nearest[robot] = distance, which
        observations[robot, column : column + 3] = ZERO
        if which >= 0 and 0.0 < distance <= reach:
            dx, dy = (targets[which, 0] - poses[robot, X]) / distance, (targets[which, 1] - poses[robot, Y]) / distance
            observations[robot, column] = dx * headings[robot, 0] + dy * headings[robot, 1]
            observations[robot, column + 1] = dy * headings[robot, 0] - dx * headings[robot, 1]
            observations[robot, column + 2] = 1.0 - distance / reach


@kernel(void(array(float32, 2), array(int64), float64, float64, GRID, GRID))
def command(actions, agents, speed, turn, linear, angular):  # type: ignore[no-untyped-def]  # compiled
    """Velocities from what robots decided, see ``robot_interface.velocity``.

    Args:
        actions: (agents, 2) float32: drive, turn.
        agents: (agents,) int64, which robots these are.
        linear, angular: (robots,) float64, filled for them: m/s, rad/s.
    """
    for row in range(agents.shape[0]):
        linear[agents[row]] = velocity(actions[row, 0], speed)
        angular[agents[row]] = velocity(actions[row, 1], turn)
