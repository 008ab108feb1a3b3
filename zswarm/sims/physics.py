"""Simulate two-wheeled robots, walls and movable things with pymunk.

The world takes commands (linear and angular velocity) and returns readings (poses, a laser scan),
as a robot's driver does; it knows no task. Axes are those of ROS: x ahead, y to the left, angles in
radians, counter-clockwise from x. Lengths are in m, masses in kg.

pymunk moves discs and boxes and has them push each other; motors and lasers are kernels. What
pymunk computes has the same bits on machines of one architecture, whatever their C library. It asks
that for powers, sines and cosines, which differ in the last bit between C libraries and processors.
So its unit of time is a step of the physics: x to the power of 1 is x everywhere. And boxes, and
robots that hold something, are at angle 0 for it: what turns with them is turned here
(``_turn_here``). How far a disc has turned makes no difference to it.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Annotated, NamedTuple

import numpy as np
import pymunk
from msgspec import Meta
from pymunk import batch
from pymunk.batch import BodyFields

from zswarm.config.meta import PartSettings, about, above, within
from zswarm.kernels.portable import PI, cos, exp, sin
from zswarm.sims.physics_kernels import ANGLE, OUTSIDE, SECTORS, command, look, push
from zswarm.sims.placing import Area
from zswarm.sims.simulator import Steps

LIBRARIES = ("pymunk",)  # its machine code plays the trials
GRAVITY = 9.81  # m/s^2
TRACK = 0.65  # half the distance between the wheels / radius; that of a TurtleBot 2
SLOP = 0.001  # m that bodies may overlap; without any, contacts come and go
# 1/s: overlap beyond ``SLOP``, and the distance to a thing held, decay as exp(-PARTING t).
PARTING = 6.3
RIM = 0.1  # m, thickness of the walls around a room

READ = (
    BodyFields.POSITION
    | BodyFields.ANGLE
    | BodyFields.VELOCITY
    | BodyFields.ANGULAR_VELOCITY
)
WRITTEN = BodyFields.FORCE | BodyFields.TORQUE
# pymunk never gives a buffer's memory back, so there is one of each; what is in it is used at once.
READ_BUFFER, WRITE_BUFFER = batch.Buffer(), batch.Buffer()

Metres = Annotated[float, Meta(ge=1e-3, le=1e3)]
Robots = Annotated[int, within(1, 200, "robots")]
Side = Annotated[Metres, about("m, side of the square room")]


class RobotSettings(PartSettings, frozen=True):
    """Settings that all simulators with this world share; the defaults are a TurtleBot 2's."""

    steps: Steps = 150
    step_s: Annotated[
        float, within(1e-3, 10, "s, duration of a step, in which robots decide once")
    ] = 0.2
    substeps: Annotated[int, within(1, 1_000, "physics steps per step")] = 2
    robots: Robots = 8
    radius: Annotated[Metres, about("m, radius of a robot")] = 0.177
    mass: Annotated[float, within(1e-3, 1e4, "kg, mass of a robot")] = 6.3
    speed: Annotated[float, within(0, 100, "m/s, maximum of a robot")] = 0.65
    turn: Annotated[float, within(0, 100, "rad/s, maximum of a robot")] = 3.14
    force: Annotated[
        float, above(0, 1e6, "N, maximum driving and braking force of a robot")
    ] = 15.0
    friction: Annotated[
        float,
        within(0, 10, "coefficient of friction between robots, objects and walls"),
    ] = 0.3
    restitution: Annotated[
        float,
        within(
            0, 1, "coefficient of restitution of collisions; 0: inelastic, 1: elastic"
        ),
    ] = 0.1
    rays: Annotated[int, within(SECTORS, 2_000, "rays of a robot's laser scanner")] = 36
    view: Annotated[
        float,
        within(1, 360, "degrees from the first ray to the last, half to each side"),
    ] = 270.0
    range: Annotated[
        Metres, about("m, length of a ray, which is also its reading if nothing is hit")
    ] = 4.0


class Movable(NamedTuple):
    """Something that robots push; the ground holds it by friction."""

    kind: str
    size: float  # m, half its side, or its radius
    mass: float  # kg
    grip: float  # coefficient of friction with the ground
    is_box: bool


@functools.lru_cache
def directions(view: float, rays: int) -> np.ndarray:
    """Return the directions of a laser's rays over so many degrees: (rays, 2) float64."""
    angles = [(view * (ray / (rays - 1)) - view / 2) * PI / 180 for ray in range(rays)]
    return np.array([[cos(angle), sin(angle)] for angle in angles])


class RobotWorld:
    """Robots, walls and things, from the start of a trial on.

    Attributes:
        room: an ``Area``.
        walls: (walls, 4) float64, an ``Area`` each, those around the room included.
        movables: what the things are.
        inside: (robots,) int64, 0 for those that were taken out.
        poses: (robots, 3) float64: x, y, angle; of one that was taken out, where that was.
        headings: (robots, 2) float64, unit vectors.
        ranges: (robots, rays) float32, the last scan: the first ray is on the right;
        ``settings.range`` where nothing is.
        things: (things, 3) float64, as ``poses``.
    """

    def __init__(
        self,
        settings: RobotSettings,
        room: Area,
        walls: Sequence[Area],
        things: Sequence[Movable] = (),
    ) -> None:
        left, low, right, high = self.room = room
        around = [
            (left - RIM, low - RIM, right + RIM, low),
            (left - RIM, high, right + RIM, high + RIM),
            (left - RIM, low, left, high),
            (right, low, right + RIM, high),
        ]
        self.settings = settings
        self.movables = tuple(things)
        self.walls = np.array([*around, *walls])
        # kg m^2, of a disc.
        self._moment = 0.5 * settings.mass * settings.radius * settings.radius
        self._substep_s = settings.step_s / settings.substeps
        robots = settings.robots
        self._rows = np.zeros((robots + len(things) + 1, 6))
        self._flat = self._rows.ravel()  # a view
        # angles that pymunk does not know, see ``_turn_here``
        self._turned = np.zeros(robots + len(things) + 1)
        self._forces = np.zeros((robots + len(things) + 1, 3))
        self._linear = np.zeros(robots)
        self._angular = np.zeros(robots)
        self.inside = np.ones(robots, np.int64)
        self.poses = np.zeros((robots, 3))
        self.headings = np.zeros((robots, 2))
        self.ranges = np.zeros((robots, settings.rays), np.float32)
        self.things = np.zeros((len(things), 3))
        self._boxes = np.array(
            [number for number, thing in enumerate(things) if thing.is_box], np.int64
        )
        self._half = np.array([thing.size for thing in things])

    def start(self, poses: np.ndarray, things: np.ndarray) -> None:
        """Begin a trial with everything at rest, at (robots, 3) and (things, 3) float64 poses."""
        settings = self.settings
        # Not before: both need the compiler.
        self._rays = directions(settings.view, settings.rays)
        self._left = float(exp(-PARTING * self._substep_s))
        self._space = space = pymunk.Space()
        space.collision_slop = SLOP
        space.collision_bias = self._left
        for left, low, right, high in self.walls.tolist():
            self._touching(
                pymunk.Poly(
                    space.static_body,
                    [(left, low), (right, low), (right, high), (left, high)],
                )
            )
        self._bodies: list[pymunk.Body] = []
        self._joints: dict[int, pymunk.PivotJoint] = {}  # of robots that hold something
        self._turned[:] = 0
        self._interrupted: BaseException | None = None
        for pose in poses.tolist():
            body = self._body(settings.mass, self._moment, pose)
            self._touching(pymunk.Circle(body, settings.radius))
        for thing, pose in zip(self.movables, things.tolist(), strict=True):
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
            linear: (robots,) float64, m/s ahead, cut to what robots can; not looked at for those
            that were taken out.
            angular: (robots,) float64, rad/s counter-clockwise, likewise.
        """
        settings = self.settings
        space = self._space
        WRITE_BUFFER.set_float_buf(self._forces)
        for _ in range(settings.substeps):
            push(
                self._rows,
                self.inside,
                linear,
                angular,
                settings.speed,
                settings.turn,
                settings.mass,
                self._moment,
                settings.force,
                settings.force * settings.radius * TRACK,
                self._substep_s,
                self._forces,
            )
            batch.set_space_bodies(space, WRITTEN, WRITE_BUFFER)
            space.step(1.0)
            if self._interrupted:
                raise self._interrupted
            READ_BUFFER.clear()
            batch.get_space_bodies(space, READ, READ_BUFFER)
            self._flat[:] = np.frombuffer(READ_BUFFER.float_buf())
            self._rows[:, ANGLE] += self._turned
        self._look()

    def obey(self, actions: np.ndarray, agents: np.ndarray) -> None:
        """Let ``step_s`` pass while robots do what they decided.

        Args:
            actions: (agents, 2) float32: drive, turn; 0 full speed back or to the right, .5 none, 1
            ahead or to the left.
            agents: (agents,) int64, which robots these are; the others do as before.
        """
        command(
            np.ascontiguousarray(actions),
            agents,
            self.settings.speed,
            self.settings.turn,
            self._linear,
            self._angular,
        )
        self.drive(self._linear, self._angular)

    def hold(self, robot: int, thing: int) -> None:
        """Attach a disc to a robot's front."""
        body = self._bodies[robot]
        held = self._bodies[self.settings.robots + thing]
        joint = pymunk.PivotJoint(body, held, (0, 0), (0, 0))
        joint.collide_bodies = False
        joint.error_bias = self._left
        self._space.add(joint)
        self._joints[robot] = joint
        arm = self.settings.radius + self.movables[thing].size

        def turn(c: float, s: float) -> None:
            joint.anchor_a = arm * c, arm * s

        self._turn_here(robot, turn)

    def let_go(self, robot: int) -> None:
        """Release what a robot holds."""
        self._space.remove(self._joints.pop(robot))
        self._bodies[robot].position_func = pymunk.Body.update_position

    def take_out(self, robot: int) -> None:
        """Remove a robot from this world."""
        self.inside[robot] = 0
        self._move_outside(robot)

    def take_out_thing(self, thing: int) -> None:
        """Remove a thing from this world; pictures show it where it was."""
        self._move_outside(self.settings.robots + thing)

    def _put(self, thing: Movable, pose: Sequence[float]) -> None:
        """Add a thing; its friction with the ground is a joint with limited force."""
        weight = thing.mass * GRAVITY * thing.grip * self._substep_s * self._substep_s
        if thing.is_box:
            side = 2 * thing.size
            size = thing.size
            body = self._body(thing.mass, thing.mass * side * side / 6, pose)
            box = pymunk.Poly.create_box(body, (side, side))

            def turn(c: float, s: float) -> None:
                p = size * (c - s)
                q = size * (c + s)
                box.unsafe_set_vertices([(p, q), (-q, p), (-p, -q), (q, -p)])

            self._turn_here(len(self._bodies) - 1, turn)
            self._touching(box)
            arm = 0.3826 * side  # mean distance of a square's points from its middle
        else:
            body = self._body(thing.mass, thing.mass * thing.size * thing.size / 2, pose)
            self._touching(pymunk.Circle(body, thing.size))
            arm = 2 / 3 * thing.size
        ground = self._space.static_body
        sliding = pymunk.PivotJoint(ground, body, (0, 0), (0, 0))
        turning = pymunk.GearJoint(ground, body, 0, 1)
        sliding.max_bias = turning.max_bias = 0  # it is not drawn anywhere
        sliding.max_force = weight
        turning.max_force = weight * arm
        self._space.add(sliding, turning)

    def _body(self, mass: float, moment: float, pose: Sequence[float]) -> pymunk.Body:
        body = pymunk.Body(mass, moment)
        body.position = (pose[0], pose[1])
        body.angle = pose[2]
        self._space.add(body)
        self._bodies.append(body)
        return body

    def _turn_here(self, row: int, turn: Callable[[float, float], None]) -> None:
        """Fix a body's angle at 0 for pymunk; ``turn`` gets cosine and sine to turn its parts."""
        turned = self._turned

        def take_over(body: pymunk.Body) -> None:
            turned[row] = angle = float(turned[row]) + body.angle
            body.angle = 0
            turn(cos(angle), sin(angle))

        def move(body: pymunk.Body, duration: float) -> None:
            try:
                pymunk.Body.update_position(body, duration)
                take_over(body)
            except BaseException as error:  # pymunk's C would print it and continue
                self._interrupted = error

        take_over(self._bodies[row])
        self._bodies[row].position_func = move

    def _touching(self, shape: pymunk.Shape) -> None:
        # pymunk multiplies both numbers of the two that touch.
        shape.friction = np.sqrt(self.settings.friction)
        shape.elasticity = np.sqrt(self.settings.restitution)
        self._space.add(shape)

    def _move_outside(self, row: int) -> None:
        body = self._bodies[row]
        body.position = (OUTSIDE + 10 * row, OUTSIDE)
        body.velocity = (0, 0)
        body.angular_velocity = 0

    def _look(self) -> None:
        look(
            self._rows,
            self.inside,
            self.walls,
            self._boxes,
            self._half,
            self._rays,
            self.settings.radius,
            self.settings.range,
            self.poses,
            self.headings,
            self.things,
            self.ranges,
        )
