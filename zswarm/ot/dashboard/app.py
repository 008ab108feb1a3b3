"""The dashboard's routes: pages and scripts as files, records by HTTP, changes by a WebSocket.

It reads run folders and nothing else (docs/dashboard.md), so it shows running, finished and copied
runs.
"""

import asyncio
import contextlib
from pathlib import Path
from typing import Any

import msgspec
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import FileResponse, PlainTextResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.websockets import WebSocket, WebSocketDisconnect

from zswarm.config.decode import from_json
from zswarm.errors import ConfigError, ZswarmError
from zswarm.ot.dashboard import endpoints, guard
from zswarm.ot.dashboard.broadcast import Broadcaster, Tab, TooMany
from zswarm.ot.dashboard.replay_cache import ReplayCache
from zswarm.ot.dashboard.run_index import RunIndex
from zswarm.ot.record import annotations, control_file
from zswarm.ot.record.reader import Run

SHELL = Path(__file__).parent / "pages" / "index.html"
# All are SHELL, whose script looks at the address.
PAGES = ("/", "/run", "/cluster", "/candidate")
FILES: list[str | tuple[str, str]] = [
    ("zswarm.ot.dashboard", "pages"),
    ("zswarm.ot.replay", "pages"),
]
# Close codes; the latter: behind, or one tab too many.
NO_SUCH_RUN, TRY_LATER = 4404, 1013
STUCK_S = 10.0  # that a tab may take for a message


def application(index: RunIndex) -> Starlette:
    """Return all routes; ``guard.Guard`` protects them."""
    dashboard, run = _Dashboard(index), "/api/runs/{run:path}"
    return Starlette(
        routes=[
            Mount("/static", StaticFiles(packages=FILES)),
            Route("/api/runs", dashboard.runs),
            Route("/api/curves", dashboard.curves),
            Route("/api/importance", dashboard.importance),
            Route(f"{run}/trace", dashboard.replay),
            Route(f"{run}/control/{{request}}", dashboard.control, methods=["POST"]),
            Route(f"{run}/note", dashboard.note, methods=["POST"]),
            Route(f"{run}/{{name}}", dashboard.answer),
            WebSocketRoute("/ws", dashboard.socket),
            *(Route(path, _shell) for path in PAGES),
        ],
        exception_handlers={LookupError: _not_found, ZswarmError: _refused},
    )


class _Dashboard:
    def __init__(self, index: RunIndex) -> None:
        self.index = index
        self.broadcaster = Broadcaster(index)
        self.replays = ReplayCache()

    async def runs(self, _: Request) -> Response:
        return _json(await asyncio.to_thread(self.index.rows))

    async def curves(self, request: Request) -> Response:
        found = await asyncio.to_thread(
            endpoints.curves, self.index, request.query_params
        )
        return _json(found)

    async def importance(self, request: Request) -> Response:
        found = await asyncio.to_thread(
            endpoints.explained, self.index, request.query_params
        )
        return _json(found)

    async def folder(self, request: Request) -> Path:
        """Return the folder of a run; raise LookupError if there is no such run."""
        folder = await asyncio.to_thread(self.index.folder, request.path_params["run"])
        if folder is None:
            raise LookupError(
                "no such run: it was moved or deleted, or is not in the folders that the dashboard "
                "shows"
            )
        return folder

    async def answer(self, request: Request) -> Response:
        answer = endpoints.BY_NAME[request.path_params["name"]]
        folder = await self.folder(request)
        value = await asyncio.to_thread(lambda: answer(Run(folder), request.query_params))
        return (
            Response(value, media_type="text/csv")
            if isinstance(value, str)
            else _json(value)
        )

    async def replay(self, request: Request) -> Response:
        folder, names = await self.folder(request), ("generation", "candidate", "trial")
        numbers = [endpoints.number(request.query_params, name) for name in names]
        content = await self.replays.get(folder, *numbers)
        return Response(content, media_type="application/octet-stream")

    async def control(self, request: Request) -> Response:
        folder = await self.folder(request)
        match request.path_params["request"]:
            case "pause" | "drain" | "stop" as word:
                await asyncio.to_thread(control_file.ask, folder, word)
            case "continue":
                await asyncio.to_thread(control_file.forget, folder)
            case _:
                raise LookupError("expected pause, continue, drain or stop")
        return Response(status_code=204)

    async def note(self, request: Request) -> Response:
        folder, body = await self.folder(request), b""
        async for part in request.stream():
            body += part
            if len(body) > annotations.LARGEST:
                raise ConfigError(f"note: expected {annotations.LARGEST:,} bytes at most")
        given = from_json(body, annotations.Annotations, "note")
        await asyncio.to_thread(annotations.save, folder, given)
        return Response(status_code=204)

    async def socket(self, websocket: WebSocket) -> None:
        id_ = websocket.query_params.get("run", "")
        folder = await asyncio.to_thread(self.index.folder, id_) if id_ else None
        await websocket.accept(guard.PROTOCOL)
        if id_ and folder is None:
            await websocket.close(NO_SUCH_RUN, "no such run")
        else:
            await _serve(websocket, self.broadcaster, id_, folder)


async def _serve(
    websocket: WebSocket, broadcaster: Broadcaster, id_: str, folder: Path | None
) -> None:
    """Send changes to a tab until it closes or falls behind."""
    behind, since = True, websocket.query_params.get("since", "")
    with contextlib.suppress(TooMany):
        async with broadcaster.watching(id_, folder, since) as tab:
            sending = asyncio.create_task(_send(websocket, tab))
            tasks = (sending, asyncio.create_task(_wait_for_close(websocket)))
            try:
                await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
                behind = sending.done() and not sending.exception()
            finally:
                for task in tasks:
                    task.cancel()
                await asyncio.gather(*tasks, return_exceptions=True)
    if behind:
        with contextlib.suppress(TimeoutError, WebSocketDisconnect, RuntimeError):
            async with asyncio.timeout(STUCK_S):
                await websocket.close(TRY_LATER, "behind")


async def _send(websocket: WebSocket, tab: Tab) -> None:
    """Send messages until the tab falls behind."""
    with contextlib.suppress(TimeoutError):
        while not tab.full and (message := await tab.take()):
            async with asyncio.timeout(STUCK_S):
                await websocket.send_text(message.decode())


async def _wait_for_close(websocket: WebSocket) -> None:
    while (await websocket.receive())["type"] != "websocket.disconnect":
        pass


async def _shell(_: Request) -> Response:
    return FileResponse(SHELL)


def _json(value: Any) -> Response:
    return Response(msgspec.json.encode(value), media_type="application/json")


def _not_found(_: Request, error: Exception) -> Response:
    return PlainTextResponse(f"{error.args[0]}\n", 404)


def _refused(_: Request, error: Exception) -> Response:
    return PlainTextResponse(f"{error}\n", 422)
