"""Draw docs/pictures/epuck-missions.png: the missions of epuck, with robots at the start.

To make it anew: python docs/pictures/epuck.py
"""

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

mpl.use("agg")

from matplotlib import pyplot as plt
from matplotlib.patches import Circle, Rectangle

from zswarm.kernels.jit import interpreted
from zswarm.sims.epuck import trial
from zswarm.sims.epuck.simulator import Epuck, EpuckSettings
from zswarm.sims.simulator import Frame

MISSIONS: list[dict[str, Any]] = [
    *({"mission": name} for name in ("aggregation", "foraging", "grid-exploration")),
    *({"mission": name} for name in ("sca", "spc", "lcn", "cfa", "homing")),
    *({"mission": "generated", "mission_seed": seed} for seed in (0, 3, 5, 9)),
]
COLUMNS = 4
FLOOR = {"black floor": "black", "grey floor": "#bbbbbb", "white floor": "white"}


def main() -> None:
    """Draw all missions."""
    rows = -(-len(MISSIONS) // COLUMNS)
    figure, axes = plt.subplots(rows, COLUMNS, figsize=(11, 2.9 * rows))
    for axis, settings in zip(axes.flat, MISSIONS, strict=True):
        simulator = Epuck(EpuckSettings(**settings))
        with interpreted():
            trial.start(simulator.world, np.uint64(1))
        draw(axis, simulator.frame())
        seed = settings.get("mission_seed")
        axis.set_title(
            settings["mission"] + ("" if seed is None else f", mission_seed {seed}"),
            fontsize=9,
        )
    figure.tight_layout()
    figure.savefig(Path(__file__).with_name("epuck-missions.png"), dpi=80)


def draw(axis: Any, frame: Frame) -> None:
    """Draw a frame."""
    for place in frame.places:
        corner = place.x, place.y
        shape = Rectangle(corner, place.width, place.height, color=FLOOR[place.kind])
        axis.add_patch(shape)
    for body in reversed(frame.bodies):
        colour = FLOOR.get(body.kind, "#e69f00" if body.kind == "lamp" else "#0072b2")
        axis.add_patch(Circle((body.x, body.y), body.radius, color=colour))
        if body.heading is not None:
            ahead = body.radius * np.array([np.cos(body.heading), np.sin(body.heading)])
            ends = [body.x, body.x + ahead[0]], [body.y, body.y + ahead[1]]
            axis.plot(*ends, color="white", linewidth=1)
    for line in frame.lines:
        ends = [line.x, line.to_x], [line.y, line.to_y]
        axis.plot(*ends, color="#555555", linewidth=2)
    axis.set(xlim=(-0.45, frame.width + 0.45), ylim=(frame.height + 0.45, -0.45))
    axis.set(xticks=[], yticks=[], aspect="equal", facecolor="#bbbbbb")


if __name__ == "__main__":
    main()
