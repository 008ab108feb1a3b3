"""A run's champion as a file that other programs read: ``champion.zsc``, in docs/record.md."""

from pathlib import Path
from typing import Any, Literal

import msgspec

from zswarm.errors import ConfigError
from zswarm.protocol import codec

CHAMPION = "champion.zsc"


class Controller(msgspec.Struct, frozen=True, kw_only=True, tag="zswarm-controller", tag_field="format"):
    """The file ``champion.zsc``: all that another program needs to run the controller."""

    version: Literal[1] = 1
    simulator: str
    simulator_settings: dict[str, Any]
    representation: str
    representation_settings: dict[str, Any]
    inputs: int
    outputs: int
    sensors: list[str]
    actuators: list[str]
    genome: bytes
    fitness: float
    run: str


def load_controller(path: Path) -> Controller:
    """A champion's file, or that of a run's folder.

    Raises:
        ConfigError: missing or damaged.
    """
    file = path / CHAMPION if path.is_dir() else path
    try:
        return msgspec.msgpack.decode(file.read_bytes(), type=Controller)
    except OSError as error:
        raise ConfigError(f"{file}: cannot be read: {error.strerror}; expected a run's folder or its {CHAMPION}") from None
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ConfigError(f"{file}: damaged, or no controller: {codec.clean(str(error))}") from None
