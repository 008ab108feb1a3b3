"""The dashboard as a program: where it listens, what it says of itself, until it is stopped."""

import errno
import secrets
import socket
import sys
import threading
from collections.abc import Sequence
from pathlib import Path

import uvicorn

from zswarm.errors import ConfigError
from zswarm.ot.dashboard.app import application
from zswarm.ot.dashboard.guard import Guard
from zswarm.ot.dashboard.shelf import Shelf

PORT, PORTS = 8467, 100  # the first one, or the next free one of so many
LARGEST_MESSAGE = 4096  # bytes that a page may say on its WebSocket: it says nothing
LOOPBACK = ("127.0.0.1", "localhost", "::1")


def serve(folders: Sequence[Path], *, host: str, port: int | None, allowed: Sequence[str], until_stdin_closes: bool) -> None:
    """Show runs until Ctrl-C.

    Args:
        folders: of runs, or that hold runs.
        host: address to listen at.
        port: None: the first free one.
        allowed: names by which this machine is called.
        until_stdin_closes: end then, too.

    Raises:
        ConfigError: the address or the port cannot be had.
    """
    listening = _listen(host, port)
    token = secrets.token_urlsafe(24)
    closed = host not in LOOPBACK or bool(allowed)  # others may reach it
    names = [*allowed, *([socket.gethostname()] if closed else [])]
    guarded = Guard(application(Shelf(folders)), hosts=names, token=token, closed=closed)
    server = uvicorn.Server(
        uvicorn.Config(
            guarded,
            log_level="warning",
            access_log=False,
            server_header=False,
            lifespan="off",
            ws="websockets-sansio",
            ws_max_size=LARGEST_MESSAGE,
            ws_ping_interval=20.0,
            ws_ping_timeout=20.0,
            timeout_keep_alive=30,
            timeout_graceful_shutdown=2,
            limit_concurrency=500,
            proxy_headers=False,
        )
    )
    shown = host if host not in ("0.0.0.0", "::", "") else socket.gethostname()  # noqa: S104  it is compared
    shown = f"[{shown}]" if ":" in shown else shown
    sys.stderr.write(f"dashboard: http://{shown}:{listening.getsockname()[1]}/#token={token}\n")
    if closed:
        sys.stderr.write("dashboard: whoever reaches this address and has the token sees the runs, and it is not encrypted\n")
    sys.stderr.flush()
    if until_stdin_closes:

        def watch() -> None:
            sys.stdin.read()
            server.should_exit = True

        threading.Thread(target=watch, name="stdin", daemon=True).start()
    server.run(sockets=[listening])


def _listen(host: str, port: int | None) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    for number in range(PORT, PORT + PORTS) if port is None else [port]:
        listening = socket.socket(family, socket.SOCK_STREAM)
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listening.bind((host, number))
            listening.listen(128)
        except OSError as error:
            listening.close()
            if port is None and error.errno == errno.EADDRINUSE:
                continue
            raise ConfigError(f"{host}:{number}: cannot be listened at: {error.strerror or error}") from None
        return listening
    raise ConfigError(f"{host}: no free port from {PORT} to {PORT + PORTS - 1}; choose one with --port")
