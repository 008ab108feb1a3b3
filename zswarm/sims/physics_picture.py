"""The picture of a ``RobotWorld``, as players and films draw it."""

from collections.abc import Sequence
from typing import Literal

from zswarm.kernels.portable import PI
from zswarm.sims.physics import RIM, RobotWorld
from zswarm.sims.physics_kernels import SECTORS
from zswarm.sims.simulator import Body, Frame, Ray, Rectangle


def picture(
    world: RobotWorld,
    places: Sequence[Rectangle],
    robots: Sequence[str],
    things: Sequence[str],
) -> Frame:
    """Return a picture.

    Args:
        places: areas besides the walls; x and y, in the world's axes, are the least corner.
        robots: the kind of each robot.
        things: the kind of each thing.
    """
    left, low, right, high = world.room
    top, settings = high + RIM, world.settings
    walls = [
        Rectangle("wall", x, y, to_x - x, to_y - y)
        for x, y, to_x, to_y in world.walls.tolist()
    ]
    shown = [
        Rectangle(kind, x - left + RIM, top - y - height, width, height)
        for kind, x, y, width, height in (*places, *walls)
    ]
    bodies = [
        Body(kind, x - left + RIM, top - y, settings.radius, -angle)
        for kind, (x, y, angle) in zip(robots, world.poses.tolist(), strict=True)
    ]
    poses = world.things.tolist()
    for kind, thing, (x, y, angle) in zip(things, world.movables, poses, strict=True):
        shape: Literal["square", "diamond"] = "square" if thing.is_box else "diamond"
        bodies.append(Body(kind, x - left + RIM, top - y, thing.size, -angle, shape))
    view = settings.view * PI / 180
    rays = [
        Ray(
            sector,
            view * (0.5 - (sector + 0.5) / SECTORS),
            settings.range,
            0.0,
            view / SECTORS,
        )
        for sector in range(SECTORS)
    ]
    return Frame(right - left + 2 * RIM, high - low + 2 * RIM, shown, bodies, rays=rays)
