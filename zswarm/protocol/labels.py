"""Labels of servers, and which of them an experiment requires or prefers (docs/mixed.md).

A server has detected labels, and those of ``[labels]`` of its file. After HTCondor's Requirements
and Rank, Slurm's features and weights, and the labels of Kubernetes and Ray, in fewer words: all
requirements hold together, and a preference counts only where those before it do not decide.
"""

import math
import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from zswarm.errors import ConfigError
from zswarm.protocol.messages import LABEL_NAME, LABEL_VALUE, MAX_LABELS
from zswarm.system.text import clean

NAME_RULE = "a name is 1 to 63 of a-z, 0-9, _, . and -, starting with a letter"
VALUE_RULE = (
    "a value is 1 to 63 of letters, digits, _, ., :, + and -, "
    "starting with a letter or digit"
)
EXAMPLES = "gpu=yes, room=b12|b13, name!=lab-3, cores>=8 or memory_mb<=64000"
_VALUES = rf"{LABEL_VALUE}(?:\|{LABEL_VALUE})*"
_TERM = re.compile(rf"\s*({LABEL_NAME})\s*(!=|>=|<=|=)\s*({_VALUES})\s*", re.ASCII)
_ORDER = re.compile(rf"\s*(-?)({LABEL_NAME})\s*", re.ASCII)
_NUMBER = re.compile(r"[0-9]+(\.[0-9]+)?", re.ASCII)


class Term(NamedTuple):
    """A condition on a label, such as ``room=b12|b13``."""

    name: str
    operator: str
    values: tuple[str, ...]  # one with >= and <=

    def __str__(self) -> str:
        return f"{self.name}{self.operator}{'|'.join(self.values)}"

    def holds(self, labels: Mapping[str, str]) -> bool:
        """Return whether labels meet it.

        A label that is missing meets only ``!=``, and one that is not a number neither ``>=`` nor
        ``<=``.
        """
        value = labels.get(self.name)
        if self.operator in ("=", "!="):
            return (value in self.values) == (self.operator == "=")
        number, bound = _number(value), float(self.values[0])
        if number is None:
            return False
        return number >= bound if self.operator == ">=" else number <= bound

    def place(self, labels: Mapping[str, str]) -> float:
        """Return 0 for servers that meet it, 1 for the others."""
        return 0.0 if self.holds(labels) else 1.0


class Order(NamedTuple):
    """Servers by a number, the highest first or, with ``-``, the lowest; then those without."""

    name: str
    lower: bool

    def __str__(self) -> str:
        return f"{'-' * self.lower}{self.name}"

    def place(self, labels: Mapping[str, str]) -> float:
        """Return the number, so that the lowest comes first."""
        number = _number(labels.get(self.name))
        if number is None:
            return math.inf
        return number if self.lower else -number


Preference = Term | Order


def labels(
    values: Mapping[str, object], where: str, facts: Sequence[str] = ()
) -> dict[str, str]:
    """Return the labels that a user gave a server.

    Args:
        values: of each name a text or a whole number.
        where: put before a name in an error.
        facts: names that a server detects by itself.

    Raises:
        ConfigError: an invalid name or value, a detected label, or too many.
    """
    checked = {}
    for name, value in values.items():
        if not re.fullmatch(LABEL_NAME, name, re.ASCII):
            raise ConfigError(f"{where}: {clean(repr(name))}: {NAME_RULE}")
        text = str(value) if isinstance(value, str) or type(value) is int else ""
        if not re.fullmatch(LABEL_VALUE, text, re.ASCII):
            rule = f"{VALUE_RULE}, or a whole number"
            raise ConfigError(f"{where}: {name}: {rule}; not {clean(repr(value))}")
        if name in facts:
            own = f"a server detects that by itself, as {', '.join(facts)}"
            raise ConfigError(f"{where}: {name}: {own}; choose another name")
        checked[name] = text
    if len(checked) > (most := MAX_LABELS - len(facts)):
        raise ConfigError(f"{where}: {len(checked)} labels; expected {most} at most")
    return checked


def assigned(texts: Sequence[str], where: str) -> dict[str, str]:
    """Return ``NAME=VALUE`` texts as a mapping; ConfigError if one is not, or comes twice."""
    values: dict[str, str] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals:
            raise ConfigError(
                f"{where} {clean(text)}: expected NAME=VALUE, such as gpu=yes"
            )
        if name in values:
            raise ConfigError(f"{where} {clean(text)}: {clean(name)} is given twice")
        values[name] = value
    return values


def requirements(texts: Sequence[str], where: str) -> tuple[Term, ...]:
    """Return the requirements of ``cluster.require``.

    Raises:
        ConfigError: one is not valid, or no server can meet them all.
    """
    found: list[Term] = []
    for text in texts:
        if (term := _term(text, where)) is None:
            expected = f"expected requirements such as {EXAMPLES}"
            raise ConfigError(f"{where}: {expected}; not {clean(repr(text))}")
        found.append(term)
    for name in dict.fromkeys(term.name for term in found):
        same = [term for term in found if term.name == name]
        if _contradict(same):
            raise ConfigError(
                f"{where}: no server can meet {' and '.join(map(str, same))}"
            )
    return tuple(found)


def preferences(texts: Sequence[str], where: str) -> tuple[Preference, ...]:
    """Return the preferences of ``cluster.rank``; ConfigError if one is not valid."""
    found: list[Preference] = []
    for text in texts:
        preference: Preference | None = _term(text, where)
        if preference is None and (order := _ORDER.fullmatch(text)):
            preference = Order(order[2], lower=bool(order[1]))
        if preference is None:
            raise ConfigError(
                f"{where}: expected the name of a label (the higher number first; with a - before"
                " it the lower) or what is preferred, such as cores, -load,"
                f" {EXAMPLES}; not {clean(repr(text))}"
            )
        found.append(preference)
    return tuple(found)


def unmet(terms: Sequence[Term], labels: Mapping[str, str]) -> str:
    """Return the requirements that labels do not meet, in words; "" if they meet all."""
    missed = []
    for term in terms:
        if not term.holds(labels):
            name, value = term.name, labels.get(term.name)
            has = f"no {name}" if value is None else f"{name}={value}"
            missed.append(f"{term} (it has {has})")
    return f"the experiment requires {', '.join(missed)}" if missed else ""


def place(rank: Sequence[Preference], labels: Mapping[str, str]) -> tuple[float, ...]:
    """Return a server's rank among others: the lowest comes first."""
    return tuple(preference.place(labels) for preference in rank)


def _term(text: str, where: str) -> Term | None:
    match = _TERM.fullmatch(text)
    if match is None:
        return None
    name, operator, values = match[1], match[2], tuple(match[3].split("|"))
    if operator in (">=", "<=") and (len(values) > 1 or _number(values[0]) is None):
        raise ConfigError(f"{where}: {clean(text)}: expected one number after {operator}")
    return Term(name, operator, values)


def _contradict(terms: Sequence[Term]) -> bool:
    """Return whether no value of their label meets all of them."""
    equal = [set(term.values) for term in terms if term.operator == "="]
    if equal:
        name = terms[0].name
        values = set.intersection(*equal)
        return not any(
            all(term.holds({name: value}) for term in terms) for value in values
        )
    least = [float(term.values[0]) for term in terms if term.operator == ">="]
    most = [float(term.values[0]) for term in terms if term.operator == "<="]
    return max(least, default=0.0) > min(most, default=math.inf)


def _number(value: str | None) -> float | None:
    return float(value) if value is not None and _NUMBER.fullmatch(value) else None
