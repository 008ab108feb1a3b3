"""What the dashboard refuses, asked by its own protocol between server and application."""

import asyncio
from typing import Any

import pytest
from starlette.responses import PlainTextResponse

from zswarm.ot.dashboard.guard import Guard

TOKEN = "secret"  # noqa: S105  of a test
OURS = "127.0.0.1:8467"


def ask(
    method: str = "GET",
    path: str = "/",
    *,
    host: str = OURS,
    closed: bool = False,
    websocket: bool = False,
    subprotocols: tuple[str, ...] = (),
    **headers: str,
) -> tuple[int, dict[str, str]]:
    """Status and headers of the answer; of a WebSocket 101, or the code that it is closed with."""
    guard = Guard(
        PlainTextResponse("inside"), hosts=["lab-01"], token=TOKEN, closed=closed
    )
    if websocket:

        async def accept(_scope: Any, _receive: Any, send: Any) -> None:
            await send({"type": "websocket.accept"})

        guard = Guard(accept, hosts=["lab-01"], token=TOKEN, closed=closed)
    given = {"host": host, **headers}
    scope = {
        "type": "websocket" if websocket else "http",
        "method": method,
        "path": path,
        "subprotocols": list(subprotocols),
        "headers": [(name.encode(), value.encode()) for name, value in given.items()],
        "extensions": {},
    }
    told: list[dict[str, Any]] = []

    async def send(message: Any) -> None:
        told.append(message)

    async def receive() -> Any:
        return (
            {"type": "websocket.connect"}
            if websocket
            else {"type": "http.request", "body": b""}
        )

    asyncio.run(guard(scope, receive, send))
    first = told[0]
    if websocket:
        return (101 if first["type"] == "websocket.accept" else first["code"]), {}
    return first["status"], {
        name.decode(): value.decode() for name, value in first["headers"]
    }


@pytest.mark.parametrize(
    "host",
    [
        OURS,
        "localhost:9000",
        "[::1]:8467",
        "LOCALHOST",
        "192.168.1.5:8467",
        "lab-01:8467",
    ],
)
def test_names_and_addresses_of_this_machine_are_accepted(host: str) -> None:
    assert ask(host=host)[0] == 200


@pytest.mark.parametrize(
    "host",
    [
        "",
        "evil.example",
        "evil.example:8467",
        "127.0.0.1.evil.example",
        "localhost.evil.example:8467",
    ],
)
def test_a_foreign_name_that_resolves_to_this_machine_is_refused(host: str) -> None:
    """DNS rebinding: the browser would take the page for the attacker's own."""
    assert ask(host=host)[0] == 400


@pytest.mark.parametrize(
    "method", ["POST", "PUT", "DELETE", "PATCH", "OPTIONS", "TRACE", "NONSENSE"]
)
def test_requests_that_change_something_need_the_pages_origin_and_the_token(
    method: str,
) -> None:
    """Methods are an allow-list: unknown ones are refused, too."""
    right = {"authorization": f"Bearer {TOKEN}"}
    assert ask(method)[0] == 403
    assert ask(method, **right)[0] == 403
    assert ask(method, origin="http://evil.example", **right)[0] == 403
    assert ask(method, origin="null", **right)[0] == 403
    assert ask(method, origin="http://127.0.0.1:3000", **right)[0] == 403, (
        "another page of this machine"
    )
    assert ask(method, origin=f"http://{OURS}")[0] == 401
    assert ask(method, origin=f"http://{OURS}", authorization="Bearer wrong")[0] == 401
    assert ask(method, origin=f"http://{OURS}", authorization="Bearer gänge")[0] == 401
    assert ask(method, origin=f"http://{OURS}", **right)[0] == 200


def test_a_websocket_of_another_page_is_refused() -> None:
    """Browsers let every page open one to anywhere, and send no question before."""
    assert ask(websocket=True, path="/ws", origin=f"http://{OURS}")[0] == 101
    assert ask(websocket=True, path="/ws", origin="http://evil.example")[0] == 1008
    assert ask(websocket=True, path="/ws")[0] == 1008


def test_a_page_of_another_site_reads_nothing_and_has_nothing_computed() -> None:
    """Browsers state where a request comes from; other programs do not."""
    for site in ("cross-site", "same-site", "nonsense"):
        for path in ("/api/runs", "/api/runs/x/curve", "/api/runs/x/trace"):
            right = {"authorization": f"Bearer {TOKEN}", "sec-fetch-site": site}
            assert ask(path=path, **right)[0] == 403
        assert ask(**{"sec-fetch-site": site})[0] == 200, "a link to the page itself"
    for site in ("same-origin", "none"):
        assert ask(path="/api/runs", **{"sec-fetch-site": site})[0] == 200
    assert ask(path="/api/runs")[0] == 200


def test_a_replay_is_computed_for_holders_of_the_token_only() -> None:
    assert ask(path="/api/runs/a/b/trace")[0] == 401
    right = {"authorization": f"Bearer {TOKEN}"}
    assert ask(path="/api/runs/a/b/trace", **right)[0] == 200


def test_reading_from_the_network_needs_the_token() -> None:
    """The page itself has nothing to hide; what it reads has."""
    assert ask(closed=True)[0] == 200
    assert ask(path="/api/runs", closed=True)[0] == 401
    assert ask(path="/api/runs", closed=True, authorization=f"Bearer {TOKEN}")[0] == 200
    assert (
        ask(websocket=True, path="/ws", closed=True, origin=f"http://{OURS}")[0] == 1008
    )
    assert (
        ask(
            websocket=True,
            path="/ws",
            closed=True,
            origin=f"http://{OURS}",
            subprotocols=("zswarm", f"token.{TOKEN}"),
        )[0]
        == 101
    )


@pytest.mark.parametrize("host", [OURS, "evil.example"])
def test_every_response_has_strict_security_headers(host: str) -> None:
    """Scripts and styles are the dashboard's files only; no frames, no sniffing of types."""
    _, headers = ask(host=host)
    assert (
        "default-src 'none'; script-src 'self'; style-src 'self';"
        in headers["content-security-policy"]
    )
    assert "unsafe" not in headers["content-security-policy"]
    assert "frame-ancestors 'none'" in headers["content-security-policy"]
    assert headers["x-content-type-options"] == "nosniff"
    assert "access-control-allow-origin" not in headers
