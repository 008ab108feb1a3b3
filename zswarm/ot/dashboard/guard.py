"""Who may ask what of the dashboard: refused is whatever does not come from its own page.

A web page of somebody else can have a browser send requests here. Three things keep it out (docs/dashboard.md). ``Host`` must
name this machine, so that no other name can be made to lead here (DNS rebinding). ``Origin`` must be the page's own on all that
is not a GET, and on WebSockets, which browsers let pages of any origin open. What controls runs takes a token.
"""

import hmac
import ipaddress
from collections.abc import Iterable

from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocketClose

LOCAL = ("localhost",)
READING = ("GET", "HEAD")
PROTOCOL = "zswarm"  # of the WebSocket; beside it the page may name its token
TOKEN = "token."  # noqa: S105  how that begins
REFUSED = 1008  # close code: policy violation
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; connect-src 'self'; "
    "frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)
HEADERS = {
    "content-security-policy": POLICY,
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "cache-control": "no-cache",
}


class Guard:
    """Stands before the application.

    Args:
        app: it.
        hosts: names by which this machine is called, beside ``localhost`` and addresses.
        token: what controls runs must bring.
        closed: whether reading takes the token, too.
    """

    def __init__(self, app: ASGIApp, *, hosts: Iterable[str], token: str, closed: bool) -> None:
        self._app, self._token, self._closed = app, token, closed
        self._hosts = {*LOCAL, *(host.lower() for host in hosts)}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let through what is allowed, with headers that tell the browser to be as strict."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        refusal = self._refusal(scope)
        if scope["type"] == "websocket":
            await (WebSocketClose(REFUSED, refusal[1]) if refusal else self._app)(scope, receive, send)
            return

        async def send_guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                given = {name for name, _ in message["headers"]}
                new = [(name.encode(), value.encode()) for name, value in HEADERS.items() if name.encode() not in given]
                message = {**message, "headers": [*message["headers"], *new]}
            await send(message)

        await (PlainTextResponse(f"{refusal[1]}\n", refusal[0]) if refusal else self._app)(scope, receive, send_guarded)

    def _refusal(self, scope: Scope) -> tuple[int, str] | None:
        """Why, with the status; None: it may pass."""
        headers = Headers(scope=scope)
        host, origin = headers.get("host", ""), headers.get("origin")
        if not self._is_ours(host):
            return 400, "this host name is not allowed: start the dashboard with --allow-host NAME"
        websocket = scope["type"] == "websocket"
        reads = not websocket and scope["method"] in READING
        if not reads and (origin is None or origin.lower() not in (f"http://{host.lower()}", f"https://{host.lower()}")):
            return 403, "refused: this request does not come from the dashboard's own page"
        private = websocket or scope["path"].startswith("/api/")
        if (self._closed and private) or not (reads or websocket):
            given = _subprotocol(scope) if websocket else headers.get("authorization", "").removeprefix("Bearer ")
            if not hmac.compare_digest(given.encode(), self._token.encode()):
                return 401, "this takes the token: open the address that the dashboard printed when it started"
        return None

    def _is_ours(self, host: str) -> bool:
        """A name that a page of somebody else cannot have; an address is nobody's name."""
        name = host.lower()
        name = name[1 : name.find("]")] if name.startswith("[") else name.partition(":")[0]
        try:
            ipaddress.ip_address(name)
        except ValueError:
            return name in self._hosts
        return True


def _subprotocol(scope: Scope) -> str:
    """The token that a WebSocket brings, for which browsers have no other place."""
    return next((word.removeprefix(TOKEN) for word in scope["subprotocols"] if word.startswith(TOKEN)), "")
