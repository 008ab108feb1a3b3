"""Endpoints in options and files: ``tcp/192.168.1.5:7467``, ``unixsock-stream//run/z.sock``."""

import re
from collections.abc import Sequence
from typing import NamedTuple

from zswarm.errors import ConfigError

SOCKET_FILE = "unixsock-stream"
PROTOCOLS = ("tcp", "tls", "quic", "ws", "udp", SOCKET_FILE)  # those in zenoh's wheel
HOST_PORT = re.compile(r"(\[[^/]*\]|[^:/]+):([^:]*)")


class Endpoint(NamedTuple):
    """A protocol and an address: host and port, or a path with port 0."""

    protocol: str
    host: str
    port: int


def parse(text: str) -> Endpoint:
    """Split an endpoint in its parts, without zenoh's options after ``?`` and ``#``."""
    protocol, _, rest = text.partition("/")
    address = re.split("[?#]", rest)[0]
    if protocol not in PROTOCOLS:
        raise _refused(
            text, f"the part before the first / must be one of {', '.join(PROTOCOLS)}"
        )
    if not text.isprintable() or any(map(str.isspace, text)):
        raise _refused(text, "it holds a space or a control character")
    if protocol == SOCKET_FILE:
        if not address.startswith("/"):
            raise _refused(text, "a socket's path must begin with /")
        return Endpoint(protocol, address, 0)
    found = HOST_PORT.fullmatch(address)
    if not found:
        raise _refused(
            text, "HOST:PORT must follow the protocol, an IPv6 address in brackets"
        )
    host, port = found.groups()
    if not re.fullmatch("[0-9]+", port) or int(port) > 65_535:
        raise _refused(text, "the port must be a number up to 65535")
    return Endpoint(protocol, host.strip("[]"), int(port))


def check(endpoints: Sequence[str], where: str) -> None:
    """Refuse the first endpoint that is not valid."""
    for text in endpoints:
        try:
            parse(text)
        except ConfigError as error:
            raise ConfigError(f"{where}: {error}") from None


def _refused(text: str, why: str) -> ConfigError:
    return ConfigError(
        f"expected endpoints such as tcp/192.168.1.5:7467, not {text[:100]!r}: {why}"
    )
