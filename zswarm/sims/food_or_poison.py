"""Food or poison: which kinds are food differs from trial to trial, and is found out by tasting.

After P. M. Todd, G. F. Miller, "Exploring Adaptive Agency II: Simulating the Evolution of
Associative Learning", From Animals to Animats, 1991. There a colour distinguishes food from poison,
a different one in each world, and Hebbian networks learn which. Here there are more kinds, and the
taste of what was eaten distinguishes food from poison.
"""

# mypy: disable-error-code=no-untyped-def
# because numba infers the types of kernels.

from typing import Annotated

import msgspec
import numpy as np

from zswarm.config.meta import PartSettings, within
from zswarm.kernels.jit import inline
from zswarm.kernels.random import draw_integer
from zswarm.sims.simulator import Body, Frame, Label
from zswarm.sims.trial import OneAgent, problem, world

HALF, ZERO, ONE = np.float32(0.5), np.float32(0), np.float32(1)

KINDS, ITEMS = range(2)  # ``rules``: the settings
# ``counts``: ITEM, how many came before this one; its KIND; TASTED, it was eaten and is tasted now.
# FOOD, items that were food; FOOD_EATEN, POISON_EATEN; LATE, right decisions in the second half.
# From FOODS on 1 for each kind that is food, else 0.
ITEM, KIND, TASTED, FOOD, FOOD_EATEN, POISON_EATEN, LATE, FOODS = range(8)


class FoodOrPoisonSettings(PartSettings, frozen=True):
    """Settings of ``[problem.settings]``."""

    kinds: Annotated[int, within(1, 1_000, "kinds of items")] = 6
    items: Annotated[
        int,
        within(1, 100_000, "items that are offered in a trial, one after another"),
    ] = 60


class FoodOrPoison(OneAgent):
    """An animal finds out by tasting which kinds of items are food; for networks that learn.

    Observation: (kinds + 1,) float32: 1 for the kind of the item at hand, 0 for the others; then
        the taste, 0 of an item that was found just now, 1 of food and -1 of poison that was eaten.
    Action: (1,) float32: above 0.5 eats the item. The action while tasting has no effect.
    Turns: the animal, once for an item that it refuses, twice for one that it eats: the second time
    it tastes.
    Start: from ``Stream(seed)`` of zswarm.kernels.random: kind after kind integer(2), 1 is food;
    then each item has kind integer(kinds).
    End: after ``items`` items.
    Fitness: the share of right decisions (food eaten, poison refused) minus that of wrong ones.
        Without learning 0 on average; at most 1, and less for an animal that must taste what is
        poison.
    Metrics: ``food``, ``poison``: the share that was eaten of it, 0 where there was none; ``late``:
        the share of right decisions in the second half, from item ``items`` // 2 on.
    """

    settings_type = FoodOrPoisonSettings
    metrics = ("food", "poison", "late")
    actuators, outputs = ("eat",), 1
    settings: FoodOrPoisonSettings

    def __init__(self, settings: FoodOrPoisonSettings) -> None:
        super().__init__(settings)
        self.inputs = settings.kinds + 1
        self.sensors = (*(f"kind_{kind}" for kind in range(settings.kinds)), "taste")
        self.world = world(
            rules=msgspec.structs.astuple(settings), counts=FOODS + settings.kinds
        )

    def frame(self) -> Frame:
        """Draw the kinds, with the animal below the one that it has found or tastes."""
        s = self.settings
        counts = self.world.counts.tolist()
        foods = counts[FOODS:]
        across = max(6, int(np.sqrt(s.kinds)))
        places = [
            (0.5 + kind % across, 1.4 + 1.2 * (kind // across)) for kind in range(s.kinds)
        ]
        kinds = [
            Body("food", x, y, 0.25)
            if food
            else Body("poison", x, y, 0.25, shape="diamond")
            for food, (x, y) in zip(foods, places, strict=True)
        ]
        x, y = places[counts[KIND]]
        tastes = "tastes food" if foods[counts[KIND]] else "tastes poison"
        does = tastes if counts[TASTED] else "has found it"
        animal = Body(f"animal, {does}", x, y + 0.5, 0.15, shape="triangle")
        text = (
            f"item {min(counts[ITEM] + 1, s.items)} of {s.items}; "
            f"eaten: {counts[FOOD_EATEN]} food, {counts[POISON_EATEN]} poison"
        )
        labels = [Label(text, across / 2, 0.5, 0.25)]
        height = 1.2 * (s.kinds // across + 2)
        return Frame(across, height, [], [animal, *kinds], labels=labels)


@inline(counts=False)
def start(world, seed):
    """Draw which kinds are food, and the first item."""
    counts = world.counts
    kinds = world.rules[KINDS]
    world.stream[0] = seed
    counts[:] = 0
    for kind in range(kinds):
        counts[FOODS + kind] = draw_integer(world.stream, 2)
    counts[KIND] = draw_integer(world.stream, kinds)


@inline(counts=False)
def observe(world, observation):
    """Write the item's kind, and its taste."""
    counts = world.counts
    kinds = world.rules[KINDS]
    for kind in range(kinds):
        observation[kind] = ONE if kind == counts[KIND] else ZERO
    observation[kinds] = ZERO
    if counts[TASTED] == 1:
        observation[kinds] = ONE if counts[FOODS + counts[KIND]] == 1 else -ONE


@inline(counts=False)
def act(world, action):
    """Decide, and find the next item if this one is refused or was tasted."""
    counts = world.counts
    items = world.rules[ITEMS]
    if counts[TASTED] == 0:
        eats = action[0] > HALF
        is_food = counts[FOODS + counts[KIND]] == 1
        counts[FOOD] += int(is_food)
        counts[FOOD_EATEN] += int(eats and is_food)
        counts[POISON_EATEN] += int(eats and not is_food)
        counts[LATE] += int(eats == is_food and counts[ITEM] >= items // 2)
        if eats:
            counts[TASTED] = 1
            return
    counts[TASTED] = 0
    counts[ITEM] += 1
    counts[KIND] = draw_integer(world.stream, world.rules[KINDS])


@inline(counts=False)
def is_over(world):
    """Return whether the trial ends."""
    return world.counts[ITEM] >= world.rules[ITEMS]


@inline(counts=False)
def judge(world, fitness, metrics):
    """Write fitness and metrics of a trial that ended."""
    counts = world.counts
    items = world.rules[ITEMS]
    poison = items - counts[FOOD]
    right = counts[FOOD_EATEN] + poison - counts[POISON_EATEN]
    fitness[0] = np.float64(2 * right - items) / np.float64(items)
    metrics[0] = np.float64(counts[FOOD_EATEN]) / np.float64(max(counts[FOOD], 1))
    metrics[1] = np.float64(counts[POISON_EATEN]) / np.float64(max(poison, 1))
    metrics[2] = np.float64(counts[LATE]) / np.float64(items - items // 2)


FoodOrPoison.problem = problem("play_food_or_poison", start, observe, act, is_over, judge)
