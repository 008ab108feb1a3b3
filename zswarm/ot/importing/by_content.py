"""Read a file that another program wrote, by its content."""

from pathlib import Path

from zswarm.errors import ConfigError
from zswarm.ot.importing import argos, frevo
from zswarm.ot.importing.imported import ImportedFile
from zswarm.system.text import clean

MAX_BYTES = 64 << 20


def load(path: Path, overrides: tuple[str, ...] = ()) -> ImportedFile:
    """Read a file: a result of FREVO, or a controller of ARGoS.

    Args:
        overrides: ``a.b=value``, of the experiment around a controller of ARGoS.

    Raises:
        ConfigError: it cannot be read, is damaged, or is of a problem or a kind of controller that
            zswarm does not have.
    """
    where = clean(str(path))
    body = _body(path)
    try:
        if argos.is_controller(body):
            return argos.read(path, body, overrides)
        if overrides:
            raise ConfigError(
                "--set is for controllers of ARGoS, which have no experiment"
            )
        return frevo.read(path, body)
    except ConfigError as error:
        raise ConfigError(f"{where}: {error}") from None


def _body(path: Path) -> bytes:
    where = clean(str(path))
    try:
        with path.open("rb") as opened:
            body = opened.read(MAX_BYTES + 1)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ConfigError(f"{where}: cannot be read: {reason}") from None
    if len(body) > MAX_BYTES:
        raise ConfigError(f"{where}: too large: expected at most {MAX_BYTES >> 20} MiB")
    return body
