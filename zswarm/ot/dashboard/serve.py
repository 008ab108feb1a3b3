"""Serve the dashboard until Ctrl-C."""

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
from zswarm.ot.dashboard.run_index import RunIndex

PORT, PORTS = 8467, 100  # the first port, and how many are tried
LARGEST_MESSAGE = 4096  # bytes from a page on its WebSocket, which sends none
LOOPBACK = ("127.0.0.1", "localhost", "::1")


def serve(
    folders: Sequence[Path],
    *,
    host: str,
    port: int | None,
    allowed: Sequence[str],
    until_stdin_closes: bool,
) -> None:
    """Show runs until Ctrl-C.

    Args:
        folders: of runs, or that contain runs.
        port: None: the first free one.
        allowed: names of this machine.
        until_stdin_closes: stop then, too.

    Raises:
        ConfigError: the address or the port cannot be used.
    """
    listening = _listen(host, port)
    name = socket.gethostname()
    token = secrets.token_urlsafe(24)
    closed = host not in LOOPBACK or bool(allowed)  # other machines may reach it
    names = [*allowed, name] if closed else allowed
    app = Guard(application(_index(folders)), hosts=names, token=token, closed=closed)
    config = uvicorn.Config(
        app,
        log_level="warning",
        access_log=False,
        server_header=False,
        lifespan="off",
        ws="websockets-sansio",
        ws_max_size=LARGEST_MESSAGE,
        timeout_keep_alive=30,
        timeout_graceful_shutdown=2,
        limit_concurrency=500,
        proxy_headers=False,
    )
    server = uvicorn.Server(config)
    shown = name if host in ("0.0.0.0", "::", "") else host  # noqa: S104  compared
    shown = f"[{shown}]" if ":" in shown else shown
    sys.stderr.write(
        f"dashboard: http://{shown}:{listening.getsockname()[1]}/#token={token}\n"
    )
    if closed:
        sys.stderr.write(
            "dashboard: anyone who reaches this address and has the token sees the runs; nothing "
            "is encrypted\n"
        )
    sys.stderr.flush()
    if until_stdin_closes:

        def watch() -> None:
            sys.stdin.read()
            server.should_exit = True

        threading.Thread(target=watch, name="stdin", daemon=True).start()
    server.run(sockets=[listening])


def _index(folders: Sequence[Path]) -> RunIndex:
    """Return the index of runs, which is read while the browser starts."""
    index = RunIndex(folders)
    threading.Thread(target=index.rows, name="index", daemon=True).start()
    return index


def _listen(host: str, port: int | None) -> socket.socket:
    six = ":" in host
    family = socket.AF_INET6 if six else socket.AF_INET
    for number in range(PORT, PORT + PORTS) if port is None else [port]:
        try:
            return socket.create_server(
                (host, number), family=family, backlog=128, dualstack_ipv6=six
            )
        except OSError as error:
            if port is None and error.errno == errno.EADDRINUSE:
                continue
            # The rest was added by create_server.
            why, _, _ = str(error.strerror or error).partition(" (while")
            raise ConfigError(f"{host}:{number}: cannot be listened at: {why}") from None
    last = PORT + PORTS - 1
    raise ConfigError(
        f"{host}: no free port from {PORT} to {last}; choose one with --port"
    )
