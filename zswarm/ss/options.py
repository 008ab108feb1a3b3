"""The options of a server: its command line, and a file that a reload reads again."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from zswarm.config.decode import overridden
from zswarm.errors import ConfigError
from zswarm.plugins import registry as plugins
from zswarm.protocol import keys, labels
from zswarm.protocol.messages import MIN_MEMORY_MB, Megabytes
from zswarm.ss import admission, detected_labels

# Options that a reload does not change.
AT_START = ("capacity", "name", "realm", "simulators", "slot_memory_mb", "metrics")


class Options(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The options, by the names of the ``--config`` file."""

    capacity: Annotated[int, Meta(ge=0, le=65_535)] = 0  # slots; 0: one per core
    name: str = ""  # "": the host's name, or that of its keys
    realm: str = "default"
    listen: list[str] = []
    connect: list[str] = []
    multicast: bool = True
    require_keys: bool = False  # do not start in the clear
    simulators: list[str] = []  # offered; empty: all that are installed
    labels: dict[str, Any] = {}  # in addition to those that it detects
    limits: dict[str, Any] = {}  # of settings, see admission.py
    # Of a slot's process; 0: its share of the machine's memory.
    slot_memory_mb: Megabytes = 0
    drain_s: Annotated[float, Meta(ge=0, le=1e6)] = 60.0  # at most, on SIGTERM
    # Local port for Prometheus; 0: none.
    metrics: Annotated[int, Meta(ge=0, le=65_535)] = 0

    def __post_init__(self) -> None:
        memory_mb = self.slot_memory_mb
        if 0 < memory_mb < MIN_MEMORY_MB:
            expected = f"expected 0 or at least {MIN_MEMORY_MB}"
            raise ValueError(f"slot_memory_mb: {expected}, not {memory_mb}")


def load(config: Path | None, given: Mapping[str, Any]) -> Options:
    """Return the options of a file, with those of the command line in place of its own."""
    if named := labels.assigned(given.get("labels", ()), "--label"):
        given = {**given, "labels": named}
    options = overridden(config, given, Options, "zswarm-ss")
    _check_id("name", options.name or "x", keys.MAX_NAME)
    _check_id("realm", options.realm, keys.MAX_ID)
    for name in options.simulators:
        if name not in plugins.names("simulator"):
            plugins.load("simulator", name)  # raises, and lists those that exist
    where = "--label" if named else f"{config}: labels"
    labels.labels(options.labels, where, detected_labels.NAMES)
    admission.read(options.limits, offered(options), f"{config}: limits")
    return options


def offered(options: Options) -> list[str]:
    """Return the simulators that a server with these options offers."""
    return options.simulators or plugins.names("simulator")


def _check_id(kind: str, text: str, longest: int) -> None:
    if not keys.is_id(text) or len(text) > longest:
        expected = f"expected 1 to {longest} of a-z, 0-9 and -, not starting with -"
        raise ConfigError(f"{kind} {text!r}: {expected}")
