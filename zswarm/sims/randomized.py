"""A simulator whose settings are drawn from ranges by the trial's seed (domain randomization)."""

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import msgspec
import numpy as np

from zswarm.config import ranges
from zswarm.config.ranges import Path
from zswarm.errors import ConfigError
from zswarm.kernels.random import derive_seed
from zswarm.sims.simulator import Frame, Outcome, Simulator, Turn

KEPT = 16  # cached simulators
MOST_TOGETHER = 256  # trials
MAX_CORNERS = 16  # combinations of ends that are all tried; otherwise only some
TOGETHER_S = 0.02  # of trials played in one call; a fault is blamed on the first of them
UNIT = 2.0**-53
# The same in all trials.
SAME = ("participants", "inputs", "outputs", "sensors", "actuators", "metrics")


def drawn(settings: Mapping[str, Any], seed: int) -> dict[str, Any]:
    """Return the settings of the trial with a seed, drawn from their ranges.

    Args:
        settings: complete ones of a simulator, from a champion or a run's experiment.

    Example::

        run = zswarm.read("runs/crowds")
        settings = zswarm.drawn(run.experiment.problem.settings, seed=1)
    """
    return ranges.replaced(settings, lambda path, one: _draw(one, path, seed))


def values(settings: Mapping[str, Any], seed: int) -> dict[Path, Any]:
    """Return only the drawn settings, by path."""
    return {path: _draw(one, path, seed) for path, one in ranges.found(settings).items()}


def _draw(one: Mapping[str, Any], path: Path, seed: int) -> Any:
    """Draw uniformly, an int between ints. Each setting has its own seed, independent of others."""
    word = derive_seed(seed, f"settings {ranges.name(path)}")
    if "choice" in one:
        return one["choice"][word * len(one["choice"]) >> 64]
    low = one["from"]
    high = one["to"]
    if isinstance(low, int) and isinstance(high, int):
        return low + (word * (high - low + 1) >> 64)
    return min(low + (high - low) * ((word >> 11) * UNIT), high)


class Varied(Simulator):
    """A simulator that is set up for each trial; its properties are those of the first ends.

    Attributes:
        first: the simulator with the first end of each range; no trial is played with it.
        agents: the smallest and largest number, at the ends of the ranges.
        together: trials with the same settings to play in one call.
    """

    def __init__(
        self, settings: Mapping[str, Any], build: Callable[[dict[str, Any]], Simulator]
    ) -> None:
        """Try the ends of the ranges.

        Args:
            settings: complete, with ranges.
            build: sets the simulator up for settings without ranges.

        Raises:
            ConfigError: the simulator refuses a combination of ends, or is another problem there.
        """
        self._settings = settings
        self._build = build
        self.together = 1
        self._kept: dict[bytes, Simulator] = {}
        first, *others = _corners(ranges.found(settings))
        self._now = self.first = self._set_up(first)
        super().__init__(self.first.settings)
        for what in SAME:
            setattr(self, what, getattr(self.first, what))
        self.robot = self.first.robot
        self.repeatable = self.first.repeatable
        numbers = [
            len(self.first.owners),
            *(len(self._checked(chosen).owners) for chosen in others),
        ]
        self.agents = min(numbers), max(numbers)

    @property
    def owners(self) -> Sequence[int]:  # type: ignore[override]  # each trial has its own
        """Return those of the last trial that was started."""
        return self._now.owners

    def alike(self, seeds: Sequence[int]) -> list[list[int]]:
        """Group the indices of a batch's trials by settings, in order of first occurrence."""
        of_seed: dict[int, list[int]] = {}
        for trial, seed in enumerate(seeds):
            of_seed.setdefault(seed, []).append(trial)
        together: dict[bytes, list[int]] = {}
        for seed, trials in of_seed.items():
            together.setdefault(_key(values(self._settings, seed)), []).extend(trials)
        return [sorted(trials) for trials in together.values()]

    def took(self, seconds: float) -> None:
        """Adapt the number of trials in one call to the time that the last call took."""
        self.together = (
            min(2 * self.together, MOST_TOGETHER)
            if seconds < TOGETHER_S
            else max(1, self.together // 2)
        )

    def of(self, seed: int) -> Simulator:
        """Return the simulator of a trial, or raise ``ConfigError`` if it refuses the settings."""
        found = values(self._settings, seed)
        key = _key(found)
        simulator = self._kept.pop(key, None) or self._checked(found)
        if len(self._kept) == KEPT:
            del self._kept[next(iter(self._kept))]  # the least recently used
        self._kept[key] = simulator
        return simulator

    def fixed_seeds(self, trials: int) -> Sequence[int] | None:
        """Return those of the first end of each range."""
        return self.first.fixed_seeds(trials)

    def reset(self, seed: int) -> Turn:
        """Set up and start a trial."""
        self._now = self.of(seed)
        return self._now.reset(seed)

    def step(self, actions: np.ndarray) -> Turn | None:
        """Let the agents of the last turn act."""
        return self._now.step(actions)

    def outcome(self) -> Outcome:
        """Return the outcome of the trial that ended."""
        return self._now.outcome()

    def frame(self) -> Frame | None:
        """Return the present state for a picture."""
        return self._now.frame()

    def _set_up(self, chosen: Mapping[Path, Any]) -> Simulator:
        try:
            return self._build(
                ranges.replaced(self._settings, lambda path, _: chosen[path])
            )
        except ConfigError as error:
            raise ConfigError(f"{error} (with {_words(chosen)})") from None

    def _checked(self, chosen: Mapping[Path, Any]) -> Simulator:
        """Set the simulator up, and check that it is the same problem as the first."""
        simulator = self._set_up(chosen)
        for what in SAME:
            expected = getattr(self.first, what)
            found = getattr(simulator, what)
            if found != expected:
                raise ConfigError(
                    f"problem.settings: with {_words(chosen)} the {what} are {found}, not "
                    f"{expected} as with the first end of each range: what a network reads and "
                    "sets must not differ by trial"
                )
        return simulator


def _corners(found: Mapping[Path, Mapping[str, Any]]) -> Iterator[dict[Path, Any]]:
    """Yield the first ends, each other end alone, and combinations of the outer ends."""
    first = {path: ranges.ends(one)[0] for path, one in found.items()}
    yield first
    for path, one in found.items():
        yield from ({**first, path: end} for end in ranges.ends(one)[1:])
    outer = [(ranges.ends(one)[0], ranges.ends(one)[-1]) for one in found.values()]
    combinations = (
        itertools.product((0, 1), repeat=len(outer))
        if 2 ** len(outer) <= MAX_CORNERS
        else [(1,) * len(outer)]
    )
    for sides in combinations:
        if int(sum(sides)) > 1:
            yield dict(
                zip(
                    found,
                    (pair[side] for pair, side in zip(outer, sides, strict=True)),
                    strict=True,
                )
            )


def _key(chosen: Mapping[Path, Any]) -> bytes:
    return msgspec.msgpack.encode(list(chosen.values()))


def _words(chosen: Mapping[Path, Any]) -> str:
    return ", ".join(
        f"{ranges.name(path)} = {ranges.shown(value)}" for path, value in chosen.items()
    )
