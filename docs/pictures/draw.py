"""Draws docs/pictures/stadium.svg: the paths of the first and the last champion of a run of the example ``stadium``.

To make it anew: zswarm-ot run stadium --out pictures && python docs/pictures/draw.py pictures/stadium
"""

import sqlite3
import sys
from pathlib import Path

import numpy as np

from zswarm.evaluate import build
from zswarm.nets.representation import Representation
from zswarm.ot.record import load_experiment
from zswarm.sims.simulator import Simulator

CELL, GAP, TITLE = 14, 40, 26


def paths(simulator: Simulator, network: Representation, genome: bytes) -> tuple[list[list[tuple[int, int]]], dict[str, object]]:
    """Every agent's cells, round by round, and the last frame."""
    parameters = network.parameters([genome])[0]
    states = np.zeros((len(simulator.owners), network.state_size), np.float32)
    turn = simulator.reset(0)
    trails = [[cell] for cell in simulator.frame()["agents"]]
    while turn is not None:
        actions = np.empty((len(turn.agents), simulator.outputs), np.float32)
        for row, agent in enumerate(turn.agents):
            network.step(parameters, states[agent], turn.observations[row], actions[row])
        acted = turn.agents
        turn = simulator.step(actions)
        for agent in acted:
            trails[agent].append(simulator.frame()["agents"][agent])
    return trails, simulator.frame()


def drawing(trails: list[list[tuple[int, int]]], frame: dict[str, object], title: str, left: int) -> str:
    """One field as SVG."""

    def at(cell: tuple[int, int]) -> str:
        return f"{left + cell[0] * CELL + CELL / 2:g},{TITLE + cell[1] * CELL + CELL / 2:g}"

    width, height = frame["size"]
    parts = [
        f'<text x="{left}" y="16" font-family="sans-serif" font-size="13" fill="#333">{title}</text>',
        f'<rect x="{left}" y="{TITLE}" width="{width * CELL}" height="{height * CELL}" fill="#fafafa" stroke="#ccc"/>',
    ]
    for cells, colour in ((frame["blockades"], "#777"), (frame["exits"], "#2a9d5c")):
        parts += [
            f'<rect x="{left + x * CELL}" y="{TITLE + y * CELL}" width="{CELL}" height="{CELL}" fill="{colour}"/>'
            for x, y in cells
        ]
    for trail, inside in zip(trails, frame["inside"], strict=True):
        colour = "#d1495b" if inside else "#3366aa"
        parts.append(
            f'<polyline points="{" ".join(map(at, trail))}" fill="none" '
            f'stroke="{colour}" stroke-opacity="0.35" stroke-width="2"/>'
        )
        x, y = at(trail[-1]).split(",")
        parts.append(f'<circle cx="{x}" cy="{y}" r="4" fill="{colour}"/>')
    return "\n".join(parts)


def main() -> None:
    """Draw the run given on the command line."""
    run = Path(sys.argv[1])
    complete = load_experiment(run)
    simulator, network = build(
        complete.problem.simulator,
        complete.problem.settings,
        complete.representation.kind,
        complete.representation.settings,
    )
    database = sqlite3.connect(run / "run.sqlite")
    pick = "SELECT genome, generation, fitness FROM candidates WHERE {} ORDER BY fitness DESC LIMIT 1"
    rows = [database.execute(pick.format(where)).fetchone() for where in ("generation = 0", "1")]
    parts, left = [], 4
    for genome, generation, fitness in rows:
        trails, frame = paths(simulator, network, genome)
        out = sum(not inside for inside in frame["inside"])
        parts.append(drawing(trails, frame, f"generation {generation}: {out} of {len(trails)} out (fitness {fitness:.4g})", left))
        left += frame["size"][0] * CELL + GAP
    size = f'width="{left - GAP + 4}" height="{TITLE + frame["size"][1] * CELL + 4}"'
    body = "\n".join(parts)
    Path(__file__).with_name("stadium.svg").write_text(f'<svg xmlns="http://www.w3.org/2000/svg" {size}>\n{body}\n</svg>\n')


if __name__ == "__main__":
    main()
