"""What a server is told: the command line, and a file that can be read again while it serves."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from zswarm import labels, plugins
from zswarm.errors import ConfigError
from zswarm.protocol import keys
from zswarm.protocol.messages import MIN_MEMORY_MB, Megabytes
from zswarm.ss import limits
from zswarm.strict import overridden


class Options(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a server is told at its start: command line or ``--config`` file."""

    capacity: Annotated[int, Meta(ge=0, le=65_535)] = 0  # slots; 0: one per core
    name: str = ""  # "": the host's name, or that of its keys
    realm: str = "default"
    listen: list[str] = []
    connect: list[str] = []
    multicast: bool = True
    require_keys: bool = False  # do not start in the clear
    simulators: list[str] = []  # offered; empty: all that are installed
    labels: dict[str, Any] = {}  # beside the facts that it states by itself
    limits: dict[str, Any] = {}  # of settings, as "SIMULATOR.SETTING" = { min = 1, max = 100 } or { choice = [1, 2] }
    slot_memory_mb: Megabytes = 0  # of a slot's process; 0: its share of the machine's memory
    drain_s: Annotated[float, Meta(ge=0, le=1e6)] = 60.0  # at most, on SIGTERM
    metrics: Annotated[int, Meta(ge=0, le=65_535)] = 0  # port for Prometheus on this machine; 0: none

    def __post_init__(self) -> None:
        if 0 < self.slot_memory_mb < MIN_MEMORY_MB:
            raise ValueError(f"slot_memory_mb: expected 0 or at least {MIN_MEMORY_MB}, not {self.slot_memory_mb}")


FACTS = ("name", "os", "machine", "cpu", "cores", "memory_mb", "slots", "slot_memory_mb")  # labels that nobody gives
AT_START = ("capacity", "name", "realm", "simulators", "slot_memory_mb", "metrics")  # a reload does not change these


def load(config: Path | None, given: Mapping[str, Any]) -> Options:
    """The options of a file, where the command line does not say otherwise.

    Raises:
        ConfigError: the file cannot be read, or something is wrong in it or on the command line.
    """
    options = overridden(config, given, Options, "zswarm-ss")
    for kind, text, longest in (
        ("name", options.name or "x", keys.MAX_NAME),
        ("realm", options.realm, keys.MAX_ID),
    ):
        if not keys.is_id(text) or len(text) > longest:
            raise ConfigError(f"{kind} {text!r}: expected 1 to {longest} of a-z, 0-9 and -, not starting with -")
    for name in options.simulators:
        if name not in plugins.names("simulator"):
            plugins.load("simulator", name)  # raises, and says which there are
    labels.labels(options.labels, "--label" if "labels" in given else f"{config}: labels", FACTS)
    limits.read(options.limits, offered(options), f"{config}: limits")
    return options


def offered(options: Options) -> list[str]:
    """The simulators that a server with these options offers."""
    return options.simulators or plugins.names("simulator")
