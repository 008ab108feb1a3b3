"""A simulator whose settings differ by trial: each range in them is drawn from the trial's seed (domain randomization)."""

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import msgspec
import numpy as np

from zswarm import ranges
from zswarm.draws import derive_seed
from zswarm.errors import ConfigError
from zswarm.ranges import Path
from zswarm.sims.simulator import Frame, Outcome, Simulator, Turn

KEPT = 16  # simulators for the trials to come
MOST_TOGETHER = 256  # trials
MAX_CORNERS = 16  # combinations of ends that are tried; of more only some
TOGETHER_S = 0.02  # that trials played at once take, about: the first of them is named if something happens
UNIT = 2.0**-53
SAME = ("participants", "inputs", "outputs", "sensors", "actuators", "metrics")  # in all trials


def drawn(settings: Mapping[str, Any], seed: int) -> dict[str, Any]:
    """The settings of the trial with a seed, ranges replaced by what is drawn from them.

    Args:
        settings: a simulator's, complete: those of a champion, or of a run's experiment.

    Example::

        run = zswarm.read("runs/crowds")
        settings = zswarm.drawn(run.experiment.problem.settings, seed=1)
    """
    return ranges.replaced(settings, lambda path, one: _draw(one, path, seed))


def values(settings: Mapping[str, Any], seed: int) -> dict[Path, Any]:
    """What is drawn alone."""
    return {path: _draw(one, path, seed) for path, one in ranges.found(settings).items()}


def _draw(one: Mapping[str, Any], path: Path, seed: int) -> Any:
    """Uniformly; a whole number where both ends are such. Each setting has a seed of its own, so no other changes it."""
    word = derive_seed(seed, f"settings {ranges.name(path)}")
    if "choice" in one:
        return one["choice"][word * len(one["choice"]) >> 64]
    low, high = one["from"], one["to"]
    if isinstance(low, int) and isinstance(high, int):
        return low + (word * (high - low + 1) >> 64)
    return min(low + (high - low) * ((word >> 11) * UNIT), high)


class Varied(Simulator):
    """A simulator that is set up for each trial; what it tells of itself is that of the first end of each range.

    Attributes:
        first: the simulator with the first end of each range; no trial is played with it.
        agents: the least and the greatest number of them, at the ends of the ranges.
        together: trials with the same settings to play at once.
    """

    def __init__(self, settings: Mapping[str, Any], build: Callable[[dict[str, Any]], Simulator]) -> None:
        """Try the ends of the ranges.

        Args:
            settings: complete, with ranges.
            build: sets the simulator up for settings without.

        Raises:
            ConfigError: at a combination of ends the simulator refuses its settings, or is another problem.
        """
        self._settings, self._build = settings, build
        self.together = 1
        self._kept: dict[bytes, Simulator] = {}
        first, *others = _corners(ranges.found(settings))
        self._now = self.first = self._set_up(first)
        super().__init__(self.first.settings)
        for what in SAME:
            setattr(self, what, getattr(self.first, what))
        self.robot, self.repeatable = self.first.robot, self.first.repeatable
        numbers = [len(self.first.owners), *(len(self._checked(chosen).owners) for chosen in others)]
        self.agents = min(numbers), max(numbers)

    @property
    def owners(self) -> Sequence[int]:  # type: ignore[override]  # each trial has its own
        """Of the trial that was started last."""
        return self._now.owners

    def alike(self, seeds: Sequence[int]) -> list[list[int]]:
        """The trials of a batch, by their index, that have the same settings; in the order of the first of each."""
        of_seed: dict[int, list[int]] = {}
        for trial, seed in enumerate(seeds):
            of_seed.setdefault(seed, []).append(trial)
        together: dict[bytes, list[int]] = {}
        for seed, trials in of_seed.items():
            together.setdefault(_key(values(self._settings, seed)), []).extend(trials)
        return [sorted(trials) for trials in together.values()]

    def took(self, seconds: float) -> None:
        """What was played at once took so long: the next time it is more, or less."""
        self.together = min(2 * self.together, MOST_TOGETHER) if seconds < TOGETHER_S else max(1, self.together // 2)

    def of(self, seed: int) -> Simulator:
        """The simulator of a trial.

        Raises:
            ConfigError: it refuses the settings that were drawn, or is another problem with them.
        """
        found = values(self._settings, seed)
        key = _key(found)
        simulator = self._kept.pop(key, None) or self._checked(found)
        if len(self._kept) == KEPT:
            del self._kept[next(iter(self._kept))]  # the one that was not used for the longest time
        self._kept[key] = simulator
        return simulator

    def fixed_seeds(self, trials: int) -> Sequence[int] | None:
        """Those of the first end of each range."""
        return self.first.fixed_seeds(trials)

    def reset(self, seed: int) -> Turn:
        """Set up and start a trial."""
        self._now = self.of(seed)
        return self._now.reset(seed)

    def step(self, actions: np.ndarray) -> Turn | None:
        """Let the agents of the last turn act."""
        return self._now.step(actions)

    def outcome(self) -> Outcome:
        """The outcome of the trial that ended."""
        return self._now.outcome()

    def frame(self) -> Frame | None:
        """What a picture of the present state needs."""
        return self._now.frame()

    def _set_up(self, chosen: Mapping[Path, Any]) -> Simulator:
        try:
            return self._build(ranges.replaced(self._settings, lambda path, _: chosen[path]))
        except ConfigError as error:
            raise ConfigError(f"{error} (with {_words(chosen)})") from None

    def _checked(self, chosen: Mapping[Path, Any]) -> Simulator:
        """The simulator, which is the same problem as the first."""
        simulator = self._set_up(chosen)
        for what in SAME:
            expected, told = getattr(self.first, what), getattr(simulator, what)
            if told != expected:
                raise ConfigError(
                    f"problem.settings: with {_words(chosen)} the {what} are {told}, not {expected} as with the first end of "
                    "each range: what a network reads and sets must not differ by trial"
                )
        return simulator


def _corners(found: Mapping[Path, Mapping[str, Any]]) -> Iterator[dict[Path, Any]]:
    """The first of each range, then each of the other ends by itself, then combinations of the least and the greatest."""
    first = {path: ranges.ends(one)[0] for path, one in found.items()}
    yield first
    for path, one in found.items():
        yield from ({**first, path: end} for end in ranges.ends(one)[1:])
    outer = [(ranges.ends(one)[0], ranges.ends(one)[-1]) for one in found.values()]
    combinations = itertools.product((0, 1), repeat=len(outer)) if 2 ** len(outer) <= MAX_CORNERS else [(1,) * len(outer)]
    for sides in combinations:
        if sum(sides) > 1:
            yield dict(zip(found, (pair[side] for pair, side in zip(outer, sides, strict=True)), strict=True))


def _key(chosen: Mapping[Path, Any]) -> bytes:
    return msgspec.msgpack.encode(list(chosen.values()))


def _words(chosen: Mapping[Path, Any]) -> str:
    return ", ".join(f"{ranges.name(path)} = {ranges.shown(value)}" for path, value in chosen.items())
