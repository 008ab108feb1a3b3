"""A champion's fitness on held-out seeds; read without NumPy."""

import msgspec

from zswarm.system.format import mean


class HeldOut(msgspec.Struct, frozen=True, kw_only=True):
    """A champion's fitness on held-out seeds, which evolution never uses, and in search.

    All numbers are those of a candidate's fitness, the sum over an experiment's trials.

    Attributes:
        mean: the expected fitness, estimated from ``seeds`` trials.
        low, high: the 95 % interval of ``mean``; NaN if one trial or none was played.
        seeds: trials on held-out seeds that did not fail.
        in_search: the best fitness that the search told its optimizer for the champion.
    """

    mean: float | None
    low: float | None
    high: float | None
    seeds: int
    in_search: float

    def per_trial(self, trials: int) -> "HeldOut":
        """Return the same as means of so many trials."""
        names = ("mean", "low", "high", "in_search")
        means = {name: mean(getattr(self, name), trials) for name in names}
        return msgspec.structs.replace(self, **means)


class Tracked(msgspec.Struct, frozen=True, kw_only=True):
    """The best of a generation, counted from 0, on held-out seeds and in search."""

    generation: int
    held_out: HeldOut
