"""Print the world file of Stage for the room of turtlebot-exit.

Robots stand where a trial's seed puts them, with the settings' sizes, scanner and speeds::

    python make_world.py --robots 4 --map open --seed 1 > room.world
    STAGEPATH=. rosrun stage_ros stageros -g room.world _base_watchdog_timeout:=0.6
"""

import argparse
import math

import numpy as np

from zswarm.sims.physics import RIM
from zswarm.sims.turtlebot_exit import (
    EXITS,
    ROOM,
    WALLS,
    TurtlebotExit,
    TurtlebotExitSettings,
)

CORNERS = 32  # of the polygon that a robot is
HEIGHT_M = 0.5
WORLD = """\
# The room of turtlebot-exit: {map}, {robots} robots.
resolution 0.02
interval_sim {interval_ms:g}  # ms; step_s is a multiple of it
show_clock 0

define scanner ranger
(
  size [0.05 0.05 0.05]
  sensor( range [0 {range:g}] fov {view:g} samples {rays} size [0.05 0.05 0.05] )
  block( points 4 point[0] [0 0] point[1] [0 1] point[2] [1 1] point[3] [1 0] z [0 1] )
)
define robot position
(
  size [{diameter:g} {diameter:g} {height:g}]
  origin [0 0 0 0]
  drive "diff"
  # Without these a robot turns by at most 90 degrees/s.
  velocity_bounds [{speed:g} {speed_:g} 0 0 0 0 {turn:g} {turn_:g}]
  localization "gps"  # odometry is exact, and in the room's frame
  localization_origin [0 0 0 0]
  obstacle_return 1
  ranger_return 1
  block( points {corners}
{points}
      z [0 {height:g}] )
  scanner( pose [0 0 {down:g} 0] obstacle_return 0 ranger_return 0 )  # else on top, above all
)
define wall model
(
  color "gray30" obstacle_return 1 ranger_return 1 gui_nose 0 gui_grid 0 gui_outline 0
)
define exit model
(
  color "green" obstacle_return 0 ranger_return 0 gui_nose 0 gui_grid 0 gui_outline 0
)
"""


def world(
    settings: TurtlebotExitSettings, seed: int, controller: str, interval_s: float = 0.1
) -> str:
    """Return the text of a world file.

    Args:
        settings: of the experiment, ``[problem.settings]``.
        seed: of the trial whose starts it has.
        controller: of the simulation: ``throttle RATE``, ``lockstep STEP_S``, or empty.
        interval_s: between two scans of a robot.
    """
    angles = [2 * math.pi * corner / CORNERS for corner in range(CORNERS)]
    points = [
        f"      point[{corner}] [{math.cos(angle):.5f} {math.sin(angle):.5f}]"
        for corner, angle in enumerate(angles)
    ]
    turn = math.degrees(settings.turn)
    text = WORLD.format(
        map=settings.map,
        robots=settings.robots,
        interval_ms=1000 * interval_s,
        range=settings.range,
        view=settings.view,
        rays=settings.rays,
        diameter=2 * settings.radius,
        height=HEIGHT_M,
        down=-HEIGHT_M / 2,
        speed=-settings.speed,
        speed_=settings.speed,
        turn=-turn,
        turn_=turn,
        corners=CORNERS,
        points="\n".join(points),
    )
    return text + "\n".join(
        [*_exits(settings), *_walls(settings), *_robots(settings, seed, controller)]
    )


def _walls(settings: TurtlebotExitSettings) -> list[str]:
    left, low, right, high = ROOM
    around = [
        (left - RIM, low - RIM, right + RIM, low),
        (left - RIM, high, right + RIM, high + RIM),
        (left - RIM, low, left, high),
        (right, low, right + RIM, high),
    ]
    return [
        f'wall( name "wall_{number}" size [{x_2 - x_1:g} {y_2 - y_1:g} {HEIGHT_M:g}] '
        f"pose [{(x_1 + x_2) / 2:g} {(y_1 + y_2) / 2:g} 0 0] )"
        for number, (x_1, y_1, x_2, y_2) in enumerate([*around, *WALLS[settings.map]])
    ]


def _exits(settings: TurtlebotExitSettings) -> list[str]:
    size = 2 * settings.epsilon
    return [
        f'exit( name "exit_{number}" size [{size:g} {size:g} 0.01] pose [{x:g} {y:g} 0 0] )'
        for number, (x, y) in enumerate(EXITS)
    ]


def _robots(settings: TurtlebotExitSettings, seed: int, controller: str) -> list[str]:
    simulator = TurtlebotExit(settings)
    simulator.reset(seed)
    x, y, z, w = simulator.poses.T
    headings = np.degrees(2 * np.arctan2(z, w))
    control = f' ctrl "{controller}"' if controller else ""
    return [
        f'robot( name "tb{number}" pose [{x[number]:.6f} {y[number]:.6f} 0 '
        f"{headings[number]:.6f}]{control if number == 0 else ''} )"
        for number in range(settings.robots)
    ] + [""]


def main() -> None:
    """Print the world that the options describe."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", type=int, default=4)
    parser.add_argument("--map", choices=[*WALLS], default="open")
    parser.add_argument("--epsilon", type=float, default=0.6, help="m, size of the exits")
    parser.add_argument(
        "--seed", type=int, default=1, help="of the trial with these starts"
    )
    parser.add_argument("--controller", default="throttle 5", help="or lockstep 0.2")
    parser.add_argument("--interval", type=float, default=0.1, help="s between scans")
    given = parser.parse_args()
    settings = TurtlebotExitSettings(
        robots=given.robots, map=given.map, epsilon=given.epsilon
    )
    print(world(settings, given.seed, given.controller, given.interval), end="")


if __name__ == "__main__":
    main()
