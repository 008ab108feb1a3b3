"""Counts, sizes, durations and fitness as people read them."""

import math

# For each unit its length in seconds, and the duration from which the next unit is used.
UNITS = {
    "us": (1e-6, 1e-3),
    "ms": (1e-3, 1.0),
    "s": (1.0, 120.0),
    "min": (60.0, 7200.0),
    "h": (3600.0, 172_800.0),
    "days": (86_400.0, float("inf")),
}


def plural(count: int, noun: str) -> str:
    """Return ``1 slot``, ``2 slots``, ``1,234 slots``."""
    return f"{count:,} {noun}{'s' if count != 1 else ''}"


def size(count: float) -> str:
    """Return a number of bytes as ``12 bytes``, ``1.23 kB``, ``3.4 GB``."""
    if count < 1000:
        return f"{count:.0f} bytes"
    power = min(4, int(math.log10(count) / 3))
    return f"{count / 1000**power:.3g} {('kB', 'MB', 'GB', 'TB')[power - 1]}"


def duration(seconds: float) -> str:
    """Return a time as ``0.12 ms``, ``34 s``, ``5 min``, ``2.5 days``."""
    if not seconds:
        return "0 s"
    units = ((unit, factor) for unit, (factor, end) in UNITS.items() if seconds < end)
    unit, factor = next(units, ("days", 86_400.0))
    value = seconds / factor
    return f"{value:.0f} {unit}" if value >= 99.5 else f"{value:.2g} {unit}"


def mean(fitness: float | None, trials: int) -> float | None:
    """Return a fitness, which records have as the sum of so many trials, as their mean."""
    return None if fitness is None else fitness / trials


def per_trial(fitness: float | None, trials: int = 1, digits: int = 6) -> str:
    """Return the same in a few digits."""
    found = mean(fitness, trials)
    return "unknown" if found is None else f"{found:.{digits}g}"


def with_trials(fitness: float | None, trials: int) -> str:
    """Return the same as ``4.36 (mean of 10 trials)``; a single trial needs no words."""
    words = "" if trials == 1 or fitness is None else f" (mean of {trials:,} trials)"
    return f"{per_trial(fitness, trials)}{words}"
