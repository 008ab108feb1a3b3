"""Draw docs/pictures/stadium.svg: the first and the last champion of ``stadium``, moving.

To draw it again: zswarm-ot run stadium && python docs/pictures/draw.py runs/stadium
"""

import sqlite3
import sys
from pathlib import Path

from zswarm.ot.problem import Problem
from zswarm.ot.record.folder import load_experiment
from zswarm.ot.replay import svg as film
from zswarm.ot.replay import trace


def main() -> None:
    """Draw the run given on the command line."""
    folder = Path(sys.argv[1])
    problem = Problem(load_experiment(folder))
    database = sqlite3.connect(folder / "run.sqlite")
    pick = (
        "SELECT genome, generation FROM candidates WHERE {} "
        "ORDER BY fitness DESC, generation, candidate LIMIT 1"
    )
    panels = []
    for where in ("generation = 0", "1"):
        genome, generation = database.execute(pick.format(where)).fetchone()
        frames = trace.record(
            problem.simulator, problem.representation, [genome], 0
        ).frames
        out = sum(body.kind == "robot outside" for body in frames[-1].bodies)
        panels.append(
            film.Panel(
                f"generation {generation + 1}: {out} of {len(frames[-1].bodies)} robots leave",
                frames,
            )
        )
    Path(__file__).with_name("stadium.svg").write_text(film.svg(panels))


if __name__ == "__main__":
    main()
