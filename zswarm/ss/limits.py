"""Limits of a server: which settings of its simulators it takes (``[limits]`` of its file)."""

import contextlib
import os
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import msgspec
from msgspec import inspect

from zswarm import plugins, ranges
from zswarm.errors import ConfigError
from zswarm.nearest import nearest
from zswarm.protocol.codec import clean
from zswarm.protocol.messages import MAX_PARTS, MAX_TEXT
from zswarm.strict import convert

NONE = inspect.NoneType


class Said(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What the file says of a setting: bounds, both of which are allowed, or the values that it may have."""

    min: int | float | None = None
    max: int | float | None = None
    choice: list[Any] = []


class Limit(NamedTuple):
    """Of a setting of a simulator."""

    simulator: str
    setting: str
    said: Said
    default: Any  # of the setting, for a run that does not send it

    def broken_by(self, settings: Mapping[str, Any]) -> str:
        """What of the settings is beyond it, in words; "" when nothing is."""
        value = settings.get(self.setting, self.default)
        for drawn in _values(value):
            if not self._allows(drawn):
                return clean(f"{self.simulator}.{self.setting} is {drawn!r}; it is {self._rule()} here")
        return ""

    def __str__(self) -> str:
        return clean(f"{self.simulator}.{self.setting} {self._rule()}")

    def _allows(self, value: Any) -> bool:
        said = self.said
        if said.choice:
            return any(value == allowed and isinstance(value, bool) == isinstance(allowed, bool) for allowed in said.choice)
        if isinstance(value, bool) or not isinstance(value, int | float):
            return False
        return (said.min is None or value >= said.min) and (said.max is None or value <= said.max)

    def _rule(self) -> str:
        said = self.said
        if said.choice:
            return f"one of {', '.join(map(str, said.choice))}" if len(said.choice) > 1 else str(said.choice[0])
        bounds = [f"{said.min} at least"] * (said.min is not None) + [f"{said.max} at most"] * (said.max is not None)
        return " and ".join(bounds)


def read(tables: Mapping[str, Any], simulators: Sequence[str], where: str) -> list[Limit]:
    """The limits that a file says.

    Args:
        tables: by ``SIMULATOR.SETTING`` what is allowed.
        simulators: those that the server offers.
        where: put before a key in an error.

    Raises:
        ConfigError: a simulator is not offered, a setting does not exist, or what is said of it cannot be.
    """
    limits = []
    if len(tables) > MAX_PARTS:
        raise ConfigError(f"{where}: {len(tables)} limits; expected {MAX_PARTS} at most")
    for key, table in tables.items():
        simulator, dot, setting = key.partition(".")
        at = f"{where}: {clean(repr(key))}"
        if not dot or not isinstance(table, Mapping):
            raise ConfigError(f'{at}: expected SIMULATOR.SETTING and its bounds, such as "arena.robots" = {{ max = 100 }}')
        if simulator not in simulators:
            raise ConfigError(f"{at}: no simulator {simulator!r} is offered{nearest(simulator, simulators)}")
        with _without_compiler():
            struct: type[msgspec.Struct] = plugins.load("simulator", simulator).settings_type
        fields = {field.encode_name: field for field in msgspec.structs.fields(struct)}
        if setting not in fields:
            raise ConfigError(f"{at}: {simulator} has no setting {clean(repr(setting))}{nearest(setting, fields)}")
        field = fields[setting]
        default = field.default if field.default_factory is msgspec.NODEFAULT else field.default_factory()
        limits.append(Limit(simulator, setting, _said(table, field.type, at), default))
    return limits


def broken(limits: Sequence[Limit], simulator: str, settings: Mapping[str, Any]) -> str:
    """Why a server with these limits cannot play a simulator with these settings; "": it can."""
    found = [why for limit in limits if limit.simulator == simulator and (why := limit.broken_by(settings))]
    return "; ".join(found)[:MAX_TEXT]


def _said(table: Mapping[str, Any], kind: Any, at: str) -> Said:
    said = convert(table, Said, at)
    bounded = said.min is not None or said.max is not None
    if bounded == bool(said.choice):
        raise ConfigError(f"{at}: expected bounds, such as {{ min = 1, max = 100 }}, or values, such as {{ choice = [1, 2] }}")
    for value in said.choice:
        try:
            msgspec.convert(value, kind, strict=True)
        except msgspec.ValidationError as error:
            why = str(error).partition(" - at")[0]
            raise ConfigError(f"{at}: choice: {clean(repr(value))} is no value of it: {why}") from None
    if bounded and not _is_number(inspect.type_info(kind)):
        raise ConfigError(f"{at}: no number, which could have bounds; expected {{ choice = [...] }}")
    if "nan" in (str(said.min), str(said.max)):  # nothing is below it or above it
        raise ConfigError(f"{at}: nan is no bound; expected numbers")
    if said.min is not None and said.max is not None and said.min > said.max:
        raise ConfigError(f"{at}: nothing is {said.min} at least and {said.max} at most")
    return said


def _is_number(kind: inspect.Type) -> bool:
    match kind:
        case inspect.Metadata():
            return _is_number(kind.type)
        case inspect.UnionType():
            return all(isinstance(each, NONE) or _is_number(each) for each in kind.types)
        case inspect.ListType():
            return _is_number(kind.item_type)
    return isinstance(kind, inspect.IntType | inspect.FloatType)


def _values(value: Any) -> Iterator[Any]:
    """A setting's values: the ends of a range and all of a choice, where trials draw it; the items of a list."""
    if value is None or value is msgspec.NODEFAULT:
        return
    drawn = ranges.ends(value)
    for end in drawn if isinstance(drawn, list | tuple) else [value]:  # what came by the wire may be no range after all
        if isinstance(end, list):
            yield from end
        else:
            yield end


@contextlib.contextmanager
def _without_compiler() -> Iterator[None]:
    """Only the settings of a simulator are looked at: the server's own process need not have numba."""
    before = os.environ.get("ZSWARM_PLAIN")
    os.environ["ZSWARM_PLAIN"] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ["ZSWARM_PLAIN"]
        else:
            os.environ["ZSWARM_PLAIN"] = before
