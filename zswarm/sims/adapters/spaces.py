"""Spaces of Gymnasium as numbers: observations into inputs, outputs into actions."""

from collections.abc import Callable, Sequence
from itertools import accumulate, pairwise
from typing import Any, NamedTuple

import numpy as np

from zswarm.errors import ConfigError
from zswarm.system.extras import need


class Senses(NamedTuple):
    """How an agent observes."""

    size: int
    numbers: Callable[[Any], np.ndarray]  # of an observation: (size,)


class Acts(NamedTuple):
    """How an agent acts."""

    size: int
    action: Callable[[np.ndarray], Any]  # from float32 outputs, at least (size,)


def sense(space: Any, where: str) -> Senses:
    """Return how observations of a space become numbers.

    Raises:
        ConfigError: their number is not fixed.
    """
    spaces = need("gymnasium.spaces", "gym", where)
    if not space.is_np_flattenable:
        raise ConfigError(
            f"{where}: expected a fixed number of numbers, not {space!s:.80}"
        )
    size = spaces.flatdim(space)
    is_box = isinstance(space, spaces.Box)

    def numbers(observation: Any) -> np.ndarray:
        flat = np.asarray(observation) if is_box else spaces.flatten(space, observation)
        if flat.size != size:
            raise ValueError(f"{where}: expected {size} numbers, not {flat.size}")
        return flat.reshape(-1)

    return Senses(size, numbers)


def act(space: Any, where: str) -> Acts:
    """Return how outputs become actions of a space.

    Raises:
        ConfigError: outputs cannot set such actions.
    """
    spaces = need("gymnasium.spaces", "gym", where)
    match space:
        case spaces.Box():
            return _numbers(space)
        case spaces.Discrete():
            count = int(space.n)
            start = int(space.start)
            return Acts(count, lambda outputs: start + int(np.argmax(outputs[:count])))
        case spaces.MultiDiscrete():
            return _choices(space)
        case spaces.MultiBinary():
            bits = int(np.prod(space.shape))
            half = np.float32(0.5)

            def flags(outputs: np.ndarray) -> np.ndarray:
                return (outputs[:bits] > half).astype(space.dtype).reshape(space.shape)

            return Acts(bits, flags)
        case spaces.Dict():
            named = dict(space.spaces)
            return _composed(
                named, where, lambda made: dict(zip(named, made, strict=True))
            )
        case spaces.Tuple():
            return _composed(dict(enumerate(space.spaces)), where, tuple)
    raise ConfigError(f"{where}: expected numbers or choices, not {space!s:.80}")


def _numbers(space: Any) -> Acts:
    bounded = np.isfinite(space.low) & np.isfinite(space.high)
    low = np.where(bounded, space.low, -1).astype(np.float64).reshape(-1)
    high = np.where(bounded, space.high, 1).astype(np.float64).reshape(-1)
    clipped = bounded.reshape(-1)
    is_integer = np.issubdtype(space.dtype, np.integer)

    def action(outputs: np.ndarray) -> np.ndarray:
        share = outputs[: low.size].astype(np.float64)
        values = low + np.where(clipped, np.clip(share, 0.0, 1.0), share) * (high - low)
        values = np.rint(values) if is_integer else values
        values = np.where(clipped, np.clip(values, low, high), values)
        return values.astype(space.dtype).reshape(space.shape)

    return Acts(low.size, action)


def _choices(space: Any) -> Acts:
    parts = _slices([int(count) for count in space.nvec.reshape(-1)])
    starts = np.asarray(getattr(space, "start", 0)) + np.zeros(space.shape, np.int64)

    def action(outputs: np.ndarray) -> np.ndarray:
        chosen = np.array([int(np.argmax(outputs[part])) for part in parts])
        made: np.ndarray = (chosen.reshape(space.shape) + starts).astype(space.dtype)
        return made

    return Acts(parts[-1].stop, action)


def _composed(
    spaces: dict[Any, Any], where: str, compose: Callable[[list[Any]], Any]
) -> Acts:
    acts = [act(space, f"{where}: {key}") for key, space in spaces.items()]
    parts = _slices([each.size for each in acts])

    def action(outputs: np.ndarray) -> Any:
        made = [
            each.action(outputs[part]) for each, part in zip(acts, parts, strict=True)
        ]
        return compose(made)

    return Acts(int(sum(each.size for each in acts)), action)


def _slices(sizes: Sequence[int]) -> list[slice]:
    return [slice(begin, end) for begin, end in pairwise(accumulate(sizes, initial=0))]
