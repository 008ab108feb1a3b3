"""Endpoints as they stand in options and files: ``tcp/192.168.1.5:7467``, ``unixsock-stream//run/zswarm.sock``."""

from collections.abc import Sequence
from typing import NamedTuple

from zswarm.errors import ConfigError

SOCKET_FILE = "unixsock-stream"
PROTOCOLS = ("tcp", "tls", "quic", "ws", "udp", SOCKET_FILE)  # those that zenoh's wheel has


class Endpoint(NamedTuple):
    """A protocol, and where: host and port, or a path with port 0."""

    protocol: str
    host: str
    port: int


def parse(text: str) -> Endpoint:
    """The parts of an endpoint, without what zenoh allows after ``?`` and ``#``.

    Raises:
        ConfigError: it is none, or of a protocol that is not there.
    """
    protocol, slash, rest = text.partition("/")
    address = rest.partition("#")[0].partition("?")[0]
    if not slash or protocol not in PROTOCOLS:
        raise _refused(text, f"the part before the first / must be one of {', '.join(PROTOCOLS)}")
    if any(character.isspace() or not character.isprintable() for character in text):
        raise _refused(text, "it holds a space or a control character")
    if protocol == SOCKET_FILE:
        if not address.startswith("/"):
            raise _refused(text, "a socket's path must begin with /")
        return Endpoint(protocol, address, 0)
    host, colon, port = address.rpartition(":")
    if not colon or not host or "/" in host or (":" in host and not (host.startswith("[") and host.endswith("]"))):
        raise _refused(text, "HOST:PORT must follow the protocol, an IPv6 address in brackets")
    if not (port.isascii() and port.isdigit() and int(port) <= 65_535):
        raise _refused(text, "the port must be a number up to 65535")
    return Endpoint(protocol, host.strip("[]"), int(port))


def check(endpoints: Sequence[str], where: str) -> None:
    """Refuse the first of these that cannot be used.

    Raises:
        ConfigError: with ``where`` in front, such as a file's key.
    """
    for text in endpoints:
        try:
            parse(text)
        except ConfigError as error:
            raise ConfigError(f"{where}: {error}") from None


def _refused(text: str, why: str) -> ConfigError:
    return ConfigError(f"expected endpoints such as tcp/192.168.1.5:7467, not {text[:100]!r}: {why}")
