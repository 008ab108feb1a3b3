"""Find random places for the robots and other bodies of a start."""

from collections.abc import Sequence

from zswarm.errors import ConfigError
from zswarm.kernels.portable import PI
from zswarm.kernels.random import Stream

TRIES = 4096  # places that are tried for all bodies of a start
FILLED = 0.35  # of an area at most may be covered at the start, so that a few tries find a place

Pose = tuple[float, float, float]  # m, m, radians
Area = tuple[float, float, float, float]  # m: least x, least y, greatest x, greatest y


def shrunk(area: Area, by: float) -> Area:
    """Return an area without its edge: where the centres of discs of that radius may be."""
    left, low, right, high = area
    return left + by, low + by, right - by, high - by


def require_room(where: str, what: str, number: int, radius: float, area: Area) -> None:
    """Check that this many discs, with their centres in an area, can be placed at random.

    Raises:
        ConfigError: they do not fit.
    """
    left, low, right, high = area
    if not (right >= left and high >= low):
        raise ConfigError(f"{where}: {what} of radius {radius:g} do not fit in the room")
    space = (right - left + 2 * radius) * (high - low + 2 * radius)
    if number * PI * radius * radius > FILLED * space:
        raise ConfigError(
            f"{where}: {number} {what} of radius {radius:g} do not fit in the {space:.3g} m2 "
            "where they start"
        )


def strew(
    stream: Stream,
    number: int,
    radius: float,
    area: Area,
    taken: Sequence[tuple[float, float, float]] = (),
) -> list[Pose]:
    """Return random poses of discs in an area, none overlapping another or ``taken``.

    Args:
        taken: x, y and radius of each disc that is already there.

    Raises:
        RuntimeError: no such poses were found.
    """
    left, low, right, high = area
    xs = stream.uniform(left, right, TRIES).tolist()
    ys = stream.uniform(low, high, TRIES).tolist()
    angles = stream.uniform(-PI, PI, number).tolist()
    occupied = list(taken)
    found: list[Pose] = []
    for x, y in zip(xs, ys, strict=True):
        if all(
            (x - a) * (x - a) + (y - b) * (y - b) > (radius + r) * (radius + r)
            for a, b, r in occupied
        ):
            occupied.append((x, y, radius))
            found.append((x, y, angles[len(found)]))
            if len(found) == number:
                return found
    raise RuntimeError(f"no room at the start for {number} of radius {radius:g} m")
