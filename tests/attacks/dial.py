"""Dial a server from another network namespace: python -m tests.attacks.dial HOW ADDRESS PORT ...

``garbage`` opens connections that speak no TLS, RATE a second, until it is killed; ``half`` opens
HOW_MANY that say nothing, and closes them; ``member`` prints when it sees a server's token, in s.
"""

import contextlib
import errno
import selectors
import socket
import sys
import time

from zswarm import session
from zswarm.protocol import keys
from zswarm.security import keyring

GARBAGE = b"GET / HTTP/1.1\r\n\r\n"
ABANDON_S = 0.5  # connections that are not accepted
OPEN_S = 3.0
LONGEST_S = 60.0


def garbage(address: str, port: int, rate: float) -> None:
    """Connect, send a line and close; a connection that hangs delays no other."""
    opening: list[tuple[float, socket.socket]] = []
    selector, begun, count = selectors.DefaultSelector(), time.monotonic(), 0
    while True:
        now = time.monotonic()
        while count < (now - begun) * rate:
            count += 1
            dialling = connecting(address, port)
            selector.register(dialling, selectors.EVENT_WRITE)
            opening.append((now, dialling))
        for key, _ in selector.select(1 / rate):
            with contextlib.suppress(OSError):
                key.fileobj.send(GARBAGE)  # type: ignore[union-attr]
            selector.unregister(key.fileobj)
            key.fileobj.close()  # type: ignore[union-attr]
        while opening and opening[0][0] < now - ABANDON_S:
            _, late = opening.pop(0)
            if late.fileno() >= 0:
                selector.unregister(late)
                late.close()


def connecting(address: str, port: int) -> socket.socket:
    """Return a socket that is connecting."""
    made = socket.socket()
    made.setblocking(False)
    assert made.connect_ex((address, port)) in (0, errno.EINPROGRESS)
    return made


def half(address: str, port: int, how_many: int) -> None:
    """Open connections, say nothing, and close them all at once; zenoh is long at each."""
    opened = [connecting(address, port) for _ in range(how_many)]
    time.sleep(OPEN_S)
    for one in opened:
        one.close()
    time.sleep(3600)


def member(address: str, port: int) -> None:
    """Print the seconds until a server's token is seen."""
    begun = time.monotonic()
    reach = session.Reach(
        [f"tls/{address}:{port}"], multicast=False, keyring=keyring.installed("ot")
    )
    opened = session.open_optimizer(reach)
    while time.monotonic() < begun + LONGEST_S:
        if any(
            reply.ok for reply in opened.liveliness().get(keys.ANY_ALIVE, timeout=1.0)
        ):
            print(f"{time.monotonic() - begun:.2f}", flush=True)
            break
        time.sleep(0.05)
    session.close(opened)


if __name__ == "__main__":
    how, address, port, *more = sys.argv[1:]
    match how:
        case "garbage":
            garbage(address, int(port), float(more[0]))
        case "half":
            half(address, int(port), int(more[0]))
        case "member":
            member(address, int(port))
