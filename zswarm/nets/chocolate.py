"""Finite-state machines of AutoMoDe-Chocolate, for e-pucks.

Source: G. Francesca et al., "AutoMoDe-Chocolate: automatic design of control software for robot
swarms", Swarm Intelligence 9, 2015. How a machine decides, and its genome: docs/representations.md.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from zswarm.config.meta import PartSettings
from zswarm.nets import vector
from zswarm.nets.chocolate_kernel import (
    ATTRACTION,
    EXPLORATION,
    MOST_STATES,
    MOST_TRANSITIONS,
    NEIGHBOURS,
    NO_NEIGHBOURS,
    PER_STATE,
    PER_TRANSITION,
    REPULSION,
    STATE_SIZE,
    step,
)
from zswarm.nets.graph import Edge, Graph, Node

BEHAVIOURS = (
    *("exploration", "stop", "phototaxis", "anti-phototaxis"),
    *("attraction", "repulsion"),
)
CONDITIONS = (
    *("black floor", "grey floor", "white floor"),
    *("neighbours", "inverted neighbours", "fixed probability"),
)
STEPS = 100  # most decisions that exploration turns
LEAST_PULL, MOST_PULL = 1.0, 5.0  # of attraction and repulsion
MOST_COUNT, MOST_SLOPE = 10, 20.0  # of the conditions on neighbours


class ChocolateSettings(PartSettings, frozen=True):
    """Settings of ``[representation]`` with ``kind = "chocolate"``: none."""


class Transition(NamedTuple):
    """A transition of a state.

    Attributes:
        target: index among the other ones of four states.
        condition: index into ``CONDITIONS``.
        p: its probability; of conditions on neighbours the count with probability 1/2.
        w: the slope of conditions on neighbours.
    """

    target: int
    condition: int
    p: float
    w: float = 0.0


class State(NamedTuple):
    """A state: index into ``BEHAVIOURS``, its parameter if it has one, and its transitions."""

    behaviour: int
    parameter: float
    transitions: list[Transition]


class Chocolate(vector.VectorRepresentation):
    """Finite-state machines of AutoMoDe-Chocolate: up to four states and their transitions.

    They are made for `epuck` with `reference_model = "1.2-machine"`, which has 15 inputs: what is
    not observed counts as 0. Genomes are vectors of numbers in -1..1.
    """

    settings_type = ChocolateSettings
    step = staticmethod(step)
    state_size = STATE_SIZE

    def __init__(self, settings: ChocolateSettings, inputs: int, outputs: int) -> None:
        genes = 1 + MOST_STATES * PER_STATE
        blocks = [0, *range(1 + PER_STATE, genes + 1, PER_STATE)]
        super().__init__(
            settings,
            inputs,
            outputs,
            ranges=np.ones(genes),
            blocks=blocks,
            least=np.full(genes, vector.FINE),
        )

    def parameters(self, genomes: Sequence[bytes]) -> np.ndarray:
        """Return rows as described at ``PER_STATE``."""
        rows = np.zeros((len(genomes), MOST_STATES * PER_STATE), np.float32)
        for row, numbers in zip(rows, self.vectors(genomes), strict=True):
            for at, state in enumerate(machine(numbers)):
                row[at * PER_STATE :][:PER_STATE] = _numbers(state)
        return rows

    def graph(self, genome: bytes) -> Graph:
        """Return states and transitions; a transition weighs its probability or 1."""
        states = machine(self.vectors([genome])[0])
        nodes = [Node("state", at, _named(state)) for at, state in enumerate(states)]
        edges = []
        for at, state in enumerate(states):
            for target, condition, p, w in state.transitions:
                text = f"{CONDITIONS[condition]}, {p:.3g}"
                sure = condition in (NEIGHBOURS, NO_NEIGHBOURS)
                text += f", slope {w:.3g}" if sure else ""
                edges.append(Edge(at, target, 1.0 if sure else p, text))
        return Graph(nodes, edges)


def machine(numbers: np.ndarray) -> list[State]:
    """Return the states that a genome's numbers mean, transitions with the states they lead to.

    Transitions to states that the machine does not have are left out.
    """
    states = decoded(numbers)
    found = []
    for at, state in enumerate(states):
        led = [
            each._replace(target=each.target + (each.target >= at))
            for each in state.transitions
        ]
        led = [each for each in led if each.target < len(states)]
        found.append(state._replace(transitions=led))
    return found


def decoded(numbers: np.ndarray) -> list[State]:
    """Return the states that a genome's numbers mean, as they are written.

    Args:
        numbers: (genes,) float32.
    """
    parts = ((np.clip(numbers.astype(np.float64), -1.0, 1.0) + 1.0) / 2.0).tolist()
    states = []
    for at in range(1, 1 + PER_STATE * (1 + _choice(parts[0], MOST_STATES)), PER_STATE):
        behaviour = _choice(parts[at], len(BEHAVIOURS))
        transitions = []
        for which in range(_choice(parts[at + 2], MOST_TRANSITIONS + 1)):
            target, condition, p, w = parts[at + 3 + PER_TRANSITION * which :][:4]
            condition = _choice(condition, len(CONDITIONS))
            crowd = condition in (NEIGHBOURS, NO_NEIGHBOURS)
            transitions.append(
                Transition(
                    _choice(target, MOST_STATES - 1),
                    condition,
                    1.0 + _choice(p, MOST_COUNT) if crowd else p,
                    MOST_SLOPE * w if crowd else 0.0,
                )
            )
        parameter = 0.0
        if behaviour == EXPLORATION:
            parameter = 1.0 + _choice(parts[at + 1], STEPS)
        elif behaviour in (ATTRACTION, REPULSION):
            parameter = LEAST_PULL + (MOST_PULL - LEAST_PULL) * parts[at + 1]
        states.append(State(behaviour, parameter, transitions))
    return states


def encoded(states: Sequence[State]) -> bytes:
    """Return a genome of states as they are written; ``decoded`` is the inverse."""
    parts = np.full(1 + MOST_STATES * PER_STATE, 0.5)
    parts[0] = _part(len(states) - 1, MOST_STATES)
    for at, state in enumerate(states):
        row = parts[1 + at * PER_STATE :][:PER_STATE]
        row[0] = _part(state.behaviour, len(BEHAVIOURS))
        if state.behaviour == EXPLORATION:
            row[1] = _part(int(state.parameter) - 1, STEPS)
        elif state.behaviour in (ATTRACTION, REPULSION):
            row[1] = (state.parameter - LEAST_PULL) / (MOST_PULL - LEAST_PULL)
        row[2] = _part(len(state.transitions), MOST_TRANSITIONS + 1)
        for which, (target, condition, p, w) in enumerate(state.transitions):
            crowd = condition in (NEIGHBOURS, NO_NEIGHBOURS)
            row[3 + PER_TRANSITION * which :][:4] = (
                _part(target, MOST_STATES - 1),
                _part(condition, len(CONDITIONS)),
                _part(int(p) - 1, MOST_COUNT) if crowd else p,
                w / MOST_SLOPE if crowd else 0.5,
            )
    return (2.0 * parts - 1.0).astype("<f4").tobytes()


def _choice(part: float, count: int) -> int:
    """Return one of so many choices by a number in 0..1."""
    return min(int(part * count), count - 1)


def _part(choice: int, count: int) -> float:
    """Return the middle of the numbers in 0..1 that mean a choice."""
    return (choice + 0.5) / count


def _named(state: State) -> str:
    name = BEHAVIOURS[state.behaviour]
    return f"{name} {state.parameter:.4g}" if state.parameter else name


def _numbers(state: State) -> np.ndarray:
    """Return a state's part of a row; strengths are cut to integers, as in the published code."""
    row = np.zeros(PER_STATE)
    row[:3] = state.behaviour, int(state.parameter), len(state.transitions)
    for which, transition in enumerate(state.transitions):
        row[3 + PER_TRANSITION * which :][:PER_TRANSITION] = transition
    return row
