"""Refuse requests that do not come from the dashboard's own page.

A page of another site can have a browser send requests here. Four checks stop it
(docs/dashboard.md): ``Host`` must name this machine, which prevents DNS rebinding; a browser must
not say that another site asks for a record; ``Origin`` must be the dashboard's own, except for GET;
and what controls runs, or computes, takes a token. Browsers let pages of any origin open
WebSockets, so these are checked like POST.
"""

import hmac
import ipaddress
from collections.abc import Iterable

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocketClose

LOCAL = ("localhost",)
READING = ("GET", "HEAD")
PROTOCOL = "zswarm"  # of the WebSocket; the page may name its token as a second one
TOKEN = "token."  # noqa: S105  the prefix of that one
# What browsers state of a request from the dashboard's page, or from the address bar.
OWN_SITE = ("same-origin", "none")
FOREIGN = "refused: this request does not come from the dashboard's own page"
REFUSED = 1008  # close code: policy violation
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; "
    "connect-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
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
    """Checks every request of an application.

    Args:
        hosts: names of this machine, in addition to ``localhost`` and addresses.
        token: needed to control runs, and for replays, which are computed.
        closed: whether reading takes the token, too.
    """

    def __init__(
        self, app: ASGIApp, *, hosts: Iterable[str], token: str, closed: bool
    ) -> None:
        self._app, self._token, self._closed = app, token, closed
        self._hosts = {*LOCAL, *(host.lower() for host in hosts)}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass on what is allowed, with headers that make the browser as strict."""
        app = self._app
        if refusal := self._refusal(scope):
            status, why = refusal
            app = PlainTextResponse(f"{why}\n", status)
            if scope["type"] == "websocket":
                app = WebSocketClose(REFUSED, why)

        async def send_guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message).update(HEADERS)
            await send(message)

        await app(scope, receive, send_guarded)

    def _refusal(self, scope: Scope) -> tuple[int, str] | None:
        """Return status and reason, or None if the request is allowed."""
        headers = Headers(scope=scope)
        host, origin = headers.get("host", "").lower(), headers.get("origin", "").lower()
        if not self._is_ours(host):
            return (
                400,
                "this host name is not allowed: start the dashboard with --allow-host NAME",
            )
        websocket = scope["type"] == "websocket"
        reads = not websocket and scope["method"] in READING
        private = websocket or scope["path"].startswith("/api/")
        from_page = headers.get("sec-fetch-site", "same-origin") in OWN_SITE
        if private and not from_page:
            return 403, FOREIGN
        if not reads and origin not in (f"http://{host}", f"https://{host}"):
            return 403, FOREIGN
        given = headers.get("authorization", "").removeprefix("Bearer ")
        # All that browsers can send.
        for word in scope["subprotocols"] if websocket else ():
            given = word.removeprefix(TOKEN) if word.startswith(TOKEN) else given
        computes = scope["path"].startswith("/api/") and scope["path"].endswith("/trace")
        needed = (self._closed and private) or computes or not (reads or websocket)
        if needed and not hmac.compare_digest(given.encode(), self._token.encode()):
            return (
                401,
                "this takes the token: open the address that the dashboard printed",
            )
        return None

    def _is_ours(self, host: str) -> bool:
        """Return whether another site cannot have this name; addresses are no site's name."""
        name = (
            host[1 : host.find("]")] if host.startswith("[") else host.partition(":")[0]
        )
        try:
            ipaddress.ip_address(name)
        except ValueError:
            return name in self._hosts
        return True
