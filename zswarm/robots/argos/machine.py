"""Machines of AutoMoDe-Chocolate as options of its controller: ``--nstates 2 --s0 0 ...``."""

import math
import re
from collections.abc import Sequence

from zswarm.errors import ConfigError
from zswarm.nets.chocolate import (
    LEAST_PULL,
    MOST_COUNT,
    MOST_PULL,
    MOST_SLOPE,
    STEPS,
    State,
    Transition,
)
from zswarm.nets.chocolate_kernel import (
    ATTRACTION,
    EXPLORATION,
    FIXED,
    MOST_STATES,
    MOST_TRANSITIONS,
    NEIGHBOURS,
    NO_NEIGHBOURS,
    REPULSION,
)
from zswarm.system.text import clean

BEGIN = "--nstates"
PARAMETERS = {EXPLORATION: "rwm", ATTRACTION: "att", REPULSION: "rep"}
OPTION = re.compile(r"--[a-z]{1,8}[0-9x]{0,4}")


class _Options:
    """The options of a text, each read once."""

    def __init__(self, text: str) -> None:
        words = text.split()
        self._numbers: dict[str, str] = {}
        for name, number in zip(words[::2], [*words[1::2], ""], strict=False):
            if not OPTION.fullmatch(name):
                raise ConfigError(f"expected an option of a machine, not {clean(name)!r}")
            if name in self._numbers:
                raise ConfigError(f"{name} is given twice")
            self._numbers[name] = number

    def number(self, name: str, least: float, most: float, *, whole: bool) -> float:
        """Take an option's number."""
        text = self._numbers.pop(name, None)
        kind = "whole number" if whole else "number"
        expected = f"{name}: expected a {kind} from {least:g} to {most:g}"
        if text is None:
            raise ConfigError(f"{expected}; it is missing")
        try:
            number = float(text)
        except ValueError:
            number = math.nan
        if not least <= number <= most or (whole and not number.is_integer()):
            raise ConfigError(f"{expected}, not {clean(text)!r}")
        return number

    def choice(self, name: str, count: int, least: int = 0) -> int:
        """Take an option that is a whole number below ``count``."""
        return int(self.number(name, least, count - 1, whole=True))

    def has(self, name: str) -> bool:
        """Return whether an option is there that was not taken."""
        return name in self._numbers

    def end(self) -> None:
        """Check that all options were taken."""
        if self._numbers:
            name = next(iter(self._numbers))
            raise ConfigError(f"{name}: the machine has no such state or transition")


def read(text: str) -> list[State]:
    """Return the states of a machine.

    Raises:
        ConfigError: it is not a machine of AutoMoDe-Chocolate.
    """
    options = _Options(text)
    count = options.choice(BEGIN, MOST_STATES + 1, 1)
    states = [_state(options, at) for at in range(count)]
    options.end()
    return states


def _state(options: _Options, at: int) -> State:
    behaviour = options.choice(f"--s{at}", 6)
    parameter = 0.0
    if behaviour in PARAMETERS:
        name = f"--{PARAMETERS[behaviour]}{at}"
        if behaviour == EXPLORATION:
            parameter = options.choice(name, STEPS + 1, 1)
        else:
            parameter = options.number(name, LEAST_PULL, MOST_PULL, whole=False)
    transitions = []
    count = 0
    if options.has(f"--n{at}"):
        count = options.choice(f"--n{at}", MOST_TRANSITIONS + 1)
    for which in range(count):
        of = f"{at}x{which}"
        target = options.choice(f"--n{of}", MOST_STATES - 1)
        condition = options.choice(f"--c{of}", FIXED + 1)
        if condition in (NEIGHBOURS, NO_NEIGHBOURS):
            p: float = options.choice(f"--p{of}", MOST_COUNT + 1, 1)
            w = options.number(f"--w{of}", 0, MOST_SLOPE, whole=False)
        else:
            p, w = options.number(f"--p{of}", 0, 1, whole=False), 0.0
        transitions.append(Transition(target, condition, p, w))
    return State(behaviour, parameter, transitions)


def written(states: Sequence[State]) -> str:
    """Return the options of a machine; ``read`` is the inverse."""
    words = [f"{BEGIN} {len(states)}"]
    for at, (behaviour, parameter, transitions) in enumerate(states):
        words.append(f"--s{at} {behaviour}")
        if behaviour in PARAMETERS:
            words.append(f"--{PARAMETERS[behaviour]}{at} {parameter:.6g}")
        if transitions:
            words.append(f"--n{at} {len(transitions)}")
        for which, (target, condition, p, w) in enumerate(transitions):
            of = f"{at}x{which}"
            words.append(f"--n{of} {target} --c{of} {condition} --p{of} {p:.6g}")
            if condition in (NEIGHBOURS, NO_NEIGHBOURS):
                words.append(f"--w{of} {w:.6g}")
    return " ".join(words)
