"""Food or poison: which kinds are which differs from trial to trial, and is found out by tasting.

After P. M. Todd, G. F. Miller, "Exploring Adaptive Agency II: Simulating the Evolution of Associative Learning", From Animals to
Animats, 1991: there a colour tells food from poison, in each world another, and Hebbian networks learn which. Here there are more
kinds, and what tells food from poison is the taste of what was eaten.
"""

from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from zswarm.draws import draw_integer
from zswarm.jit import STEP, Step, array, float32, float64, inline, int64, kernel, uint64, void
from zswarm.sims.simulator import Batch, Body, CompiledSimulator, Frame, Label, Outcome, Turn

HALF, ZERO, ONE = np.float32(0.5), np.float32(0), np.float32(1)

# ``game``: int64. ITEM, how many came before this one; its KIND; TASTED, it was eaten and is tasted now. Then counts: items that
# were FOOD; FOOD_EATEN, POISON_EATEN; LATE, right decisions in the second half.
ITEM, KIND, TASTED, FOOD, FOOD_EATEN, POISON_EATEN, LATE = range(7)
NUMBERS = 7


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of ``[problem.settings]``."""

    kinds: Annotated[int, Meta(ge=1, le=1_000, description="kinds of items")] = 6
    items: Annotated[int, Meta(ge=1, le=100_000, description="items that are found in a trial, one after the other")] = 60


class FoodOrPoison(CompiledSimulator):
    """An animal finds out by tasting which kinds of items are food; what networks that learn during life are known for.

    Observation: (kinds + 1,) float32: 1 for the kind of the item at hand, 0 for the others; then the taste, 0 of an item that was
        found just now, 1 of food and -1 of poison that was eaten.
    Action: (1,) float32: above .5 eats the item. What is said while tasting has no effect.
    Turns: the animal, once for an item that is left, twice for one that is eaten: the second time it tastes.
    Start: from ``Stream(seed)`` of zswarm.draws: kind after kind integer(2), 1 is food; then each item has kind integer(kinds).
    End: after ``items`` items.
    Fitness: the share of right decisions (food eaten, poison left) minus that of wrong ones. Without learning 0 on average;
        at most 1, less for whoever must taste what is poison.
    Metrics: ``food``, ``poison``: the share that was eaten of it, 0 where there was none; ``late``: the share of right decisions
        in the second half, from item ``items`` // 2 on.
    """

    settings_type = Settings
    metrics = ("food", "poison", "late")
    outputs = 1
    actuators = ("eat",)
    owners = (0,)
    settings: Settings

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings)
        self.inputs = settings.kinds + 1
        self.sensors = (*(f"kind_{kind}" for kind in range(settings.kinds)), "taste")

    def reset(self, seed: int) -> Turn:
        """Draw what is food, and the first item."""
        self._foods, self._stream = np.empty(self.settings.kinds, np.int64), np.empty(1, np.uint64)
        self._game = np.empty(NUMBERS, np.int64)
        start(np.uint64(seed), self._foods, self._stream, self._game)
        return self._turn()

    def step(self, actions: np.ndarray) -> Turn | None:
        """Eat the item at hand or leave it, or swallow."""
        act(actions[0], self.settings.items, self._foods, self._stream, self._game)
        return self._turn() if self._game[ITEM] < self.settings.items else None

    def outcome(self) -> Outcome:
        """Fitness and metrics of the trial that ended."""
        fitness, metrics = np.zeros(1), np.zeros(len(self.metrics))
        judge(self.settings.items, self._game, fitness, metrics)
        return Outcome(list(fitness), list(metrics))

    def frame(self) -> Frame:
        """The kinds, and the animal below the one that it has found, or tastes."""
        across, foods, game = max(6, int(np.sqrt(self.settings.kinds))), self._foods.tolist(), self._game.tolist()
        places = [(0.5 + kind % across, 1.4 + 1.2 * (kind // across)) for kind in range(self.settings.kinds)]
        kinds = [
            Body("food", x, y, 0.25) if food else Body("poison", x, y, 0.25, shape="diamond")
            for food, (x, y) in zip(foods, places, strict=True)
        ]
        x, y = places[game[KIND]]
        does = "has found it" if not game[TASTED] else "tastes food" if foods[game[KIND]] else "tastes poison"
        animal = Body(f"animal, {does}", x, y + 0.5, 0.15, shape="triangle")
        eaten = f"item {min(game[ITEM] + 1, self.settings.items)} of {self.settings.items}; eaten: {game[FOOD_EATEN]} food, "
        words = Label(f"{eaten}{game[POISON_EATEN]} poison", across / 2, 0.5, 0.25)
        return Frame(across, 1.2 * (self.settings.kinds // across + 2), [], [animal, *kinds], labels=[words])

    def play(self, step: Step, batch: Batch) -> None:
        """See ``CompiledSimulator.play``."""
        state = np.empty(batch.state_size, np.float32)
        play_trials(
            step, batch.parameters, batch.participants, batch.seeds, state, self.settings.kinds, self.settings.items,
            batch.progress, batch.fitness, batch.metrics,
        )  # fmt: skip

    def _turn(self) -> Turn:
        observation = np.empty((1, self.inputs), np.float32)
        observe(self._foods, self._game, observation[0])
        return Turn((0,), observation)


@inline
def start(seed, foods, stream, game):  # type: ignore[no-untyped-def]  # compiled
    """Draw what is food, and the first item."""
    stream[0] = seed
    for kind in range(foods.shape[0]):
        foods[kind] = draw_integer(stream, 2)
    game[:] = 0
    game[KIND] = draw_integer(stream, foods.shape[0])


@inline
def observe(foods, game, observation):  # type: ignore[no-untyped-def]  # compiled
    """The item's kind, and its taste."""
    kinds = foods.shape[0]
    for kind in range(kinds):
        observation[kind] = ONE if kind == game[KIND] else ZERO
    observation[kinds] = ZERO
    if game[TASTED] == 1:
        observation[kinds] = ONE if foods[game[KIND]] == 1 else -ONE


@inline
def act(action, items, foods, stream, game):  # type: ignore[no-untyped-def]  # compiled
    """Decide, count it, and find the next item if this one is left or was tasted."""
    if game[TASTED] == 0:
        eats, is_food = action[0] > HALF, foods[game[KIND]] == 1
        game[FOOD] += int(is_food)
        game[FOOD_EATEN] += int(eats and is_food)
        game[POISON_EATEN] += int(eats and not is_food)
        game[LATE] += int(eats == is_food and game[ITEM] >= items // 2)
        if eats:
            game[TASTED] = 1
            return
    game[TASTED] = 0
    game[ITEM] += 1
    game[KIND] = draw_integer(stream, foods.shape[0])


@inline
def judge(items, game, fitness, metrics):  # type: ignore[no-untyped-def]  # compiled
    """Fitness and metrics of a trial that ended."""
    poison = items - game[FOOD]
    right = game[FOOD_EATEN] + poison - game[POISON_EATEN]
    fitness[0] = np.float64(2 * right - items) / np.float64(items)
    metrics[0] = np.float64(game[FOOD_EATEN]) / np.float64(max(game[FOOD], 1))
    metrics[1] = np.float64(game[POISON_EATEN]) / np.float64(max(poison, 1))
    metrics[2] = np.float64(game[LATE]) / np.float64(items - items // 2)


@kernel(
    void(STEP, array(float32, 2), array(int64, 2), array(uint64), array(float32), int64, int64, array(int64), array(float64, 2),
         array(float64, 2))
)  # fmt: skip
def play_trials(  # type: ignore[no-untyped-def]  # compiled
    step, parameters, participants, seeds, state, kinds, items, progress, fitness, metrics
):
    """All trials of a batch, see ``CompiledSimulator.play``."""
    observation, action = np.empty(kinds + 1, np.float32), np.empty(1, np.float32)
    foods, stream, game = np.empty(kinds, np.int64), np.empty(1, np.uint64), np.empty(NUMBERS, np.int64)
    for trial in range(participants.shape[0]):
        progress[0] = trial
        if progress[1] != 0:
            return
        controller = parameters[participants[trial, 0]]
        state[:] = 0
        start(seeds[trial], foods, stream, game)
        while game[ITEM] < items:
            observe(foods, game, observation)
            step(controller, state, observation, action)
            act(action, items, foods, stream, game)
        judge(items, game, fitness[trial], metrics[trial])
