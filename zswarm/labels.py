"""Labels of servers, and what experiments ask of them: which servers must be, and which are preferred (docs/mixed.md).

A server states names with values: facts that it knows of itself, and what ``[labels]`` of its file adds. ``cluster.require`` of
an experiment names values that they must have, ``cluster.rank`` those that are preferred. After HTCondor's Requirements and
Rank, Slurm's features and weights, and the labels of Kubernetes and Ray, in fewer words: all requirements hold together, and a
preference counts only where those before it do not decide.
"""

import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from zswarm.errors import ConfigError
from zswarm.protocol.codec import clean
from zswarm.protocol.messages import LABEL_NAME, LABEL_VALUE, MAX_LABELS

NAME_RULE = "a name is 1 to 63 of a-z, 0-9, _, . and -, starting with a letter"
VALUE_RULE = "a value is 1 to 63 of letters, digits, _, ., :, + and -, starting with a letter or digit"
EXAMPLES = "gpu=yes, room=b12|b13, name!=lab-3, cores>=8 or memory_mb<=64000"
OPERATORS = ("!=", ">=", "<=", "=")
_TERM = re.compile(rf"\s*({LABEL_NAME})\s*(!=|>=|<=|=)\s*({LABEL_VALUE}(?:\|{LABEL_VALUE})*)\s*", re.ASCII)
_ORDER = re.compile(rf"\s*(-?)({LABEL_NAME})\s*", re.ASCII)
_NUMBER = re.compile(r"[0-9]+(\.[0-9]+)?", re.ASCII)


class Term(NamedTuple):
    """Something that holds of a server or not, such as ``room=b12|b13``."""

    name: str
    operator: str
    values: tuple[str, ...]  # one of them with >= and <=

    def __str__(self) -> str:
        return f"{self.name}{self.operator}{'|'.join(self.values)}"

    def holds(self, labels: Mapping[str, str]) -> bool:
        """Whether it does; of a label that is not there only ``!=`` does, and of one that is no number not ``>=`` or ``<=``."""
        value = labels.get(self.name)
        match self.operator:
            case "=":
                return value in self.values
            case "!=":
                return value not in self.values
        number, bound = _number(value), float(self.values[0])
        if number is None:
            return False
        return number >= bound if self.operator == ">=" else number <= bound


class Order(NamedTuple):
    """Servers with the higher number first, or, written with a ``-``, those with the lower; then those without one."""

    name: str
    lower: bool

    def __str__(self) -> str:
        return f"{'-' * self.lower}{self.name}"


Preference = Term | Order


def labels(values: Mapping[str, object], where: str, facts: Sequence[str] = ()) -> dict[str, str]:
    """The labels that somebody gave a server.

    Args:
        values: of each name a text or a whole number.
        where: put before a name in an error.
        facts: the names that a server states by itself.

    Raises:
        ConfigError: something is no name or no value, a fact is among them, or there are too many.
    """
    checked = {}
    for name, value in values.items():
        if not re.fullmatch(LABEL_NAME, name, re.ASCII):
            raise ConfigError(f"{where}: {clean(repr(name))}: {NAME_RULE}")
        text = str(value) if isinstance(value, str) or type(value) is int else ""
        if not re.fullmatch(LABEL_VALUE, text, re.ASCII):
            raise ConfigError(f"{where}: {name}: {VALUE_RULE}, or a whole number; not {clean(repr(value))}")
        if name in facts:
            raise ConfigError(f"{where}: {name}: a server says that by itself, as {', '.join(facts)}; choose another name")
        checked[name] = text
    if len(checked) + len(facts) > MAX_LABELS:
        raise ConfigError(f"{where}: {len(checked)} labels; expected {MAX_LABELS - len(facts)} at most")
    return checked


def assigned(texts: Sequence[str], where: str) -> dict[str, str]:
    """``NAME=VALUE`` texts as a mapping.

    Raises:
        ConfigError: one is none, or a name comes twice.
    """
    values: dict[str, str] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals:
            raise ConfigError(f"{where} {clean(text)}: expected NAME=VALUE, such as gpu=yes")
        if name in values:
            raise ConfigError(f"{where} {clean(text)}: {clean(name)} is there twice")
        values[name] = value
    return values


def requirements(texts: Sequence[str], where: str) -> tuple[Term, ...]:
    """What ``cluster.require`` says.

    Raises:
        ConfigError: one is no requirement, or no server can meet them all.
    """
    terms = []
    for text in texts:
        term = _term(text, where)
        if term is None:
            raise ConfigError(f"{where}: expected requirements such as {EXAMPLES}; not {clean(repr(text))}")
        terms.append(term)
    for name in dict.fromkeys(term.name for term in terms):
        of_name = [term for term in terms if term.name == name]
        if _contradict(of_name):
            raise ConfigError(f"{where}: no server can meet {' and '.join(map(str, of_name))}")
    return tuple(terms)


def preferences(texts: Sequence[str], where: str) -> tuple[Preference, ...]:
    """What ``cluster.rank`` says.

    Raises:
        ConfigError: one is no preference.
    """
    found: list[Preference] = []
    for text in texts:
        preference = _term(text, where) or _order(text)
        if preference is None:
            raise ConfigError(
                f"{where}: expected the name of a label (the higher number first; with a - before it the lower) or what is "
                f"preferred, such as cores, -load, {EXAMPLES}; not {clean(repr(text))}"
            )
        found.append(preference)
    return tuple(found)


def unmet(terms: Sequence[Term], labels: Mapping[str, str]) -> str:
    """The requirements that a server does not meet, in words; "" when it meets all."""
    missed = [
        f"{term} (it has {f'{term.name}={labels[term.name]}' if term.name in labels else f'no {term.name}'})"
        for term in terms
        if not term.holds(labels)
    ]
    return f"the experiment requires {', '.join(missed)}" if missed else ""


def place(rank: Sequence[Preference], labels: Mapping[str, str]) -> tuple[float, ...]:
    """Where a server stands: the lower, the earlier."""
    found = []
    for preference in rank:
        if isinstance(preference, Term):
            found.append(0.0 if preference.holds(labels) else 1.0)
        else:
            number = _number(labels.get(preference.name))
            found.append(float("inf") if number is None else number if preference.lower else -number)
    return tuple(found)


def _term(text: str, where: str) -> Term | None:
    match = _TERM.fullmatch(text)
    if match is None:
        return None
    name, operator, values = match[1], match[2], tuple(match[3].split("|"))
    if operator in (">=", "<=") and (len(values) > 1 or _number(values[0]) is None):
        raise ConfigError(f"{where}: {clean(text)}: expected one number after {operator}")
    return Term(name, operator, values)


def _order(text: str) -> Order | None:
    match = _ORDER.fullmatch(text)
    return Order(match[2], lower=bool(match[1])) if match else None


def _contradict(terms: Sequence[Term]) -> bool:
    """Whether no value of their label meets all of them."""
    wanted = [set(term.values) for term in terms if term.operator == "="]
    if wanted:
        return not any(all(term.holds({term.name: value}) for term in terms) for value in set.intersection(*wanted))
    low = max((float(term.values[0]) for term in terms if term.operator == ">="), default=0.0)
    high = min((float(term.values[0]) for term in terms if term.operator == "<="), default=float("inf"))
    return low > high


def _number(value: str | None) -> float | None:
    return float(value) if value is not None and _NUMBER.fullmatch(value) else None
