"""Which problems a server evaluates: its simulators, code versions, memory, and limits of settings.

Limits are the table ``[limits]`` of the server's file: which settings of its simulators it takes.
"""

import platform
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import msgspec
from msgspec import inspect

from zswarm.config import ranges
from zswarm.config.decode import convert
from zswarm.config.suggest import nearest
from zswarm.errors import ConfigError
from zswarm.plugins import registry as plugins
from zswarm.plugins.version_hash import differing, lacking, version_hash, versions
from zswarm.protocol.messages import (
    FEATURES,
    MAX_PARTS,
    MAX_TEXT,
    Offer,
    Requirements,
    Reserve,
)
from zswarm.ss.detected_labels import detected_labels
from zswarm.system.extras import installing
from zswarm.system.text import clean
from zswarm.system.version import VERSION

EXAMPLE = '"arena.robots" = { max = 100 }'


class Rule(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The allowed values of a setting: inclusive bounds, or a list."""

    min: int | float | None = None
    max: int | float | None = None
    choice: list[Any] = []

    def allows(self, value: Any) -> bool:
        """Return whether a value is allowed."""
        if self.choice:
            same_kind = [
                each
                for each in self.choice
                if isinstance(each, bool) == isinstance(value, bool)
            ]
            return value in same_kind
        if isinstance(value, bool) or not isinstance(value, int | float):
            return False
        return (self.min is None or value >= self.min) and (
            self.max is None or value <= self.max
        )

    def __str__(self) -> str:
        if len(self.choice) == 1:
            return str(self.choice[0])
        if self.choice:
            return f"one of {', '.join(map(str, self.choice))}"
        least = [f"at least {self.min}"] if self.min is not None else []
        most = [f"at most {self.max}"] if self.max is not None else []
        return " and ".join(least + most)


class Limit(NamedTuple):
    """The rule for a setting of a simulator."""

    simulator: str
    setting: str
    rule: Rule
    default: Any  # of the setting, for a run that does not send it

    def broken_by(self, settings: Mapping[str, Any]) -> str:
        """Return which value of the settings is not allowed, or ""."""
        for value in _values(settings.get(self.setting, self.default)):
            if not self.rule.allows(value):
                name = f"{self.simulator}.{self.setting}"
                return clean(f"{name} is {value!r}; this server takes {self.rule}")
        return ""

    def __str__(self) -> str:
        return clean(f"{self.simulator}.{self.setting} {self.rule}")


class Admission:
    """Which problems a server evaluates; a reload may change the limits."""

    def __init__(
        self, offered: list[str], limits: list[Limit], slot_memory_mb: int
    ) -> None:
        self.simulators = offered
        self.representations = plugins.names("representation")
        self.limits = limits
        self._slot_memory_mb = slot_memory_mb
        pairs = [
            (sim, network) for sim in self.simulators for network in self.representations
        ]
        # The slots run the code as it is now, not what an upgrade will install later.
        self._hashes = {pair: version_hash(*pair) for pair in pairs}
        self._versions = {pair: versions(*pair) for pair in pairs}

    def offer(self, server: str, capacity: int, labels: Mapping[str, Any]) -> Offer:
        """Return the answer to runs that look for servers."""
        detected = detected_labels(
            server.rpartition("-")[0], capacity, self._slot_memory_mb
        )
        return Offer(
            server=server,
            program=VERSION,
            machine=f"{platform.system()} {platform.machine()}",
            capacity=capacity,
            free=capacity,
            leases=0,
            simulators=self.simulators,
            representations=self.representations,
            labels=detected | {name: str(value) for name, value in labels.items()},
            limits=[str(limit) for limit in self.limits],
            features=FEATURES,
        )

    def mismatch(self, asked: Requirements | Reserve) -> str:
        """Return why a problem cannot be evaluated here, or ""."""
        if isinstance(asked, Reserve):
            simulator, representation = asked.simulator.kind, asked.representation.kind
            settings, there = asked.simulator.settings, {}
        else:
            simulator, representation = asked.simulator, asked.representation
            settings, there = asked.settings, asked.versions
        pair = simulator, representation
        if pair == ("", ""):
            return ""
        if simulator not in self.simulators:
            names = ", ".join(self.simulators)
            return f"the server has no simulator {simulator!r}; it has {names}"[:MAX_TEXT]
        if pair not in self._hashes:
            return f"the server has no representation {representation!r}"[:MAX_TEXT]
        if self._hashes[pair] != asked.version_hash:
            return self._difference(pair, there)
        if asked.trial_memory_mb > self._slot_memory_mb:
            asked_mb = asked.trial_memory_mb
            return f"a slot has {self._slot_memory_mb} MB, the run asks for {asked_mb}"
        return broken(self.limits, simulator, settings)

    def _difference(self, pair: tuple[str, str], there: dict[str, str]) -> str:
        simulator, representation = pair
        here = self._versions[pair]
        if missing := lacking(here, there):
            what = f"the server lacks packages that {simulator!r} needs"
            return f"{what}: {installing(*missing)}"[:MAX_TEXT]
        if parts := differing(here, there, "on the server", "in the run"):
            what = f"versions differ: {'; '.join(parts)[: MAX_TEXT // 2]}"
            return f"{what}; install the same, and start the server again"
        versions = f"{simulator}, {representation}, zswarm or numba"
        return f"the server has another version of {versions}"


def read(tables: Mapping[str, Any], simulators: Sequence[str], where: str) -> list[Limit]:
    """Return the limits of a file.

    Args:
        tables: rules by ``SIMULATOR.SETTING``.
        simulators: those that the server offers.
        where: put before a key in an error.
    """
    if len(tables) > MAX_PARTS:
        raise ConfigError(f"{where}: {len(tables)} limits; expected at most {MAX_PARTS}")
    limits = []
    for key, table in tables.items():
        simulator, dot, setting = key.partition(".")
        at = f"{where}: {clean(repr(key))}"
        if not dot or not isinstance(table, Mapping):
            raise ConfigError(
                f"{at}: expected SIMULATOR.SETTING and its rule, such as {EXAMPLE}"
            )
        if simulator not in simulators:
            similar = nearest(simulator, simulators)
            raise ConfigError(f"{at}: no simulator {simulator!r} is offered{similar}")
        struct: type[msgspec.Struct] = plugins.load("simulator", simulator).settings_type
        fields = {field.encode_name: field for field in msgspec.structs.fields(struct)}
        if setting not in fields:
            similar = nearest(setting, fields)
            raise ConfigError(
                f"{at}: {simulator} has no setting {clean(repr(setting))}{similar}"
            )
        field = fields[setting]
        made = field.default_factory
        default = field.default if made is msgspec.NODEFAULT else made()
        limits.append(Limit(simulator, setting, _rule(table, field.type, at), default))
    return limits


def broken(limits: Sequence[Limit], simulator: str, settings: Mapping[str, Any]) -> str:
    """Return which limits the settings of a simulator break, or ""."""
    found = [
        limit.broken_by(settings) for limit in limits if limit.simulator == simulator
    ]
    return "; ".join(filter(None, found))[:MAX_TEXT]


def _rule(table: Mapping[str, Any], kind: Any, at: str) -> Rule:
    rule = convert(table, Rule, at)
    bounded = rule.min is not None or rule.max is not None
    if bounded == bool(rule.choice):
        bounds, values = "{ min = 1, max = 100 }", "{ choice = [1, 2] }"
        raise ConfigError(
            f"{at}: expected bounds, such as {bounds}, or values, such as {values}"
        )
    for value in rule.choice:
        try:
            msgspec.convert(value, kind, strict=True)
        except msgspec.ValidationError as error:
            why = str(error).partition(" - at")[0]
            text = f"{at}: choice: {clean(repr(value))} is not a valid value: {why}"
            raise ConfigError(text) from None
    if bounded and not _is_number(inspect.type_info(kind)):
        raise ConfigError(
            f"{at}: not a number, so it has no bounds; expected {{ choice = [...] }}"
        )
    if "nan" in (str(rule.min), str(rule.max)):
        raise ConfigError(f"{at}: nan is not a bound; expected numbers")
    if rule.min is not None and rule.max is not None and rule.min > rule.max:
        raise ConfigError(f"{at}: no value is at least {rule.min} and at most {rule.max}")
    return rule


def _is_number(kind: inspect.Type) -> bool:
    match kind:
        case inspect.Metadata():
            return _is_number(kind.type)
        case inspect.UnionType():
            kinds = [
                each for each in kind.types if not isinstance(each, inspect.NoneType)
            ]
            return all(_is_number(each) for each in kinds)
        case inspect.ListType():
            return _is_number(kind.item_type)
    return isinstance(kind, inspect.IntType | inspect.FloatType)


def _values(value: Any) -> Iterator[Any]:
    """Yield the values of a setting: the ends of a range, all of a choice, the items of a list."""
    if value is None or value is msgspec.NODEFAULT:
        return
    ends = ranges.ends(value)
    if not isinstance(ends, list | tuple):  # a peer may send what is not a range
        ends = [value]
    for end in ends:
        yield from end if isinstance(end, list) else [end]
