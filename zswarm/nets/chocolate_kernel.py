"""The kernel of AutoMoDe-Chocolate's finite-state machines.

A decision acts as the current state's behaviour does, then tests its transitions in random order;
the first that fires sets the state of the next decision. All is float64. A state's transitions are
not tested in its first decision.
"""

# mypy: disable-error-code=no-untyped-def
# because numba infers the types of kernels.

import numpy as np

from zswarm.kernels.jit import STEP_SIGNATURE, inline, kernel, sqrt
from zswarm.kernels.portable import exp

# A row of parameters, state by state: behaviour, its parameter, transitions; then per transition
# its target, its condition, and the condition's two parameters.
MOST_STATES, MOST_TRANSITIONS = 4, 4
PER_TRANSITION = 4
PER_STATE = 3 + MOST_TRANSITIONS * PER_TRANSITION
EXPLORATION, STOP, PHOTOTAXIS, ANTI_PHOTOTAXIS, ATTRACTION, REPULSION = range(6)
BLACK, GREY, WHITE, NEIGHBOURS, NO_NEIGHBOURS, FIXED = range(6)

# What a machine observes: four vectors' lengths in four directions each, and numbers.
PROXIMITY, LIGHT, GROUND, HEARD, ATTRACTED, CHANCE, INPUTS = 0, 4, 8, 9, 10, 14, 15
DIAGONAL = 0.7071067811865476
NEAR = 0.1  # least length of a vector that counts: an obstacle, or a way to go

# ``state``: the machine's state, whether it was in it before, and of exploration the decisions
# that it still turns and whether it turns left.
CURRENT, ENTERED, TURNS, LEFTWARDS, STATE_SIZE = range(5)

# L'Ecuyer's choice for a multiplicative congruential generator.
FACTOR, MODULUS = 48271, 2147483647


@inline
def read(observation, index):
    """Return a number that is observed, float64; 0 if there is none."""
    return np.float64(observation[index]) if index < observation.shape[0] else 0.0


@inline
def advance(seed):
    """Return the next number of a random sequence, in 1..MODULUS - 1."""
    return seed * FACTOR % MODULUS


@inline
def first_of(chance):
    """Return the first number of the random sequence that an observed number in 0..1 selects."""
    usual = chance if 0.0 <= chance <= 1.0 else 0.5
    return advance(1 + int(usual * (MODULUS - 3)))


@inline
def along(observation, first):
    """Return the component ahead of a vector that is observed in four directions."""
    one = read(observation, first) - read(observation, first + 2)
    other = read(observation, first + 1) - read(observation, first + 3)
    return DIAGONAL * (one - other)


@inline
def across(observation, first):
    """Return the component to the left of such a vector."""
    one = read(observation, first) - read(observation, first + 2)
    other = read(observation, first + 1) - read(observation, first + 3)
    return DIAGONAL * (one + other)


@inline
def explore(parameter, state, x, y, seed):
    """Go straight, and turn on the spot away from obstacles: return the turn, -1, 0 or 1.

    Args:
        x, y: the proximity vector.
    """
    turn = 0.0
    if state[TURNS] > 0:
        turn = 1.0 if state[LEFTWARDS] > 0 else -1.0
        state[TURNS] -= np.float32(1)
    elif x >= 0.0 and sqrt(x * x + y * y) >= NEAR:
        steps = int(seed / np.float64(MODULUS) * parameter)
        state[TURNS] = np.float32(max(steps, 1))
        state[LEFTWARDS] = np.float32(1.0 if y < 0.0 else 0.0)
    return turn


@inline
def fires(condition, p, w, observation):
    """Return the probability that a condition fires."""
    ground = read(observation, GROUND)
    black = ground <= 0.1
    white = ground >= 0.95
    if condition == BLACK:
        return p if black else 0.0
    if condition == GREY:
        return 0.0 if black or white else p
    if condition == WHITE:
        return p if white else 0.0
    if condition == FIXED:
        return p
    crowded = 1.0 / (1.0 + exp(w * (p - read(observation, HEARD))))
    return crowded if condition == NEIGHBOURS else 1.0 - crowded


@inline
def follow(parameters, at, observation, seed):
    """Return the state that a transition leads to, or -1 if none fires.

    Args:
        parameters: at ``at``, the number of transitions, then these.
        seed: a number of a random sequence; its followers give the order of the tests.
    """
    count = int(parameters[at])
    tested = np.int64(0)
    drawn = seed
    for _ in range(count):
        drawn = advance(drawn)
    for _ in range(count):
        least = np.int64(MODULUS)
        chosen = 0
        key = seed
        for transition in range(count):
            key = advance(key)
            if tested < key < least:
                least = key
                chosen = transition
        tested = least
        drawn = advance(drawn)
        of = at + 1 + PER_TRANSITION * chosen
        condition = int(parameters[of + 1])
        p = np.float64(parameters[of + 2])
        w = np.float64(parameters[of + 3])
        if drawn / np.float64(MODULUS) < fires(condition, p, w, observation):
            return int(parameters[of])
    return -1


@kernel(STEP_SIGNATURE)
def step(parameters, state, observation, output):
    """Make one decision."""
    at = PER_STATE * int(state[CURRENT])
    behaviour = int(parameters[at])
    parameter = np.float64(parameters[at + 1])
    seed = first_of(read(observation, CHANCE))
    x = along(observation, PROXIMITY)
    y = across(observation, PROXIMITY)
    if behaviour == EXPLORATION:
        turn = explore(parameter, state, x, y, seed)
        left = 1.0 if turn == 0.0 else -turn
        right = 1.0 if turn == 0.0 else turn
    elif behaviour == STOP:
        left = 0.0
        right = 0.0
    else:
        source = ATTRACTED
        if behaviour <= ANTI_PHOTOTAXIS:
            source = LIGHT
        if behaviour == ANTI_PHOTOTAXIS:
            factor = -1.0
        elif behaviour == ATTRACTION:
            factor = parameter
        elif behaviour == REPULSION:
            factor = -parameter * parameter
        else:
            factor = 1.0
        away = 6.0 if behaviour == ATTRACTION else 5.0
        x = factor * along(observation, source) - away * x
        y = factor * across(observation, source) - away * y
        length = sqrt(x * x + y * y)
        cosine = x / length if length >= NEAR else 1.0
        leftwards = length >= NEAR and y > 0.0
        left = cosine if leftwards else 1.0
        right = 1.0 if leftwards else cosine
    for index in range(output.shape[0]):
        speed = left if index == 0 else (right if index == 1 else 0.0)
        output[index] = np.float32(0.5 * (speed + 1.0))
    target = -1
    if state[ENTERED] > 0:
        target = follow(parameters, at + 2, observation, advance(seed))
    state[ENTERED] = np.float32(1)
    if target >= 0:
        state[CURRENT] = np.float32(target)
        state[ENTERED] = np.float32(0)
        state[TURNS] = np.float32(0)
