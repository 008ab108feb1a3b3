"""The dashboard's answers: pages and scripts as files, history by HTTP, what changes by one WebSocket per page.

It reads run folders and nothing else (docs/dashboard.md), so it shows runs that go on, that are finished and that were copied.
"""

import asyncio
import contextlib
from collections.abc import Awaitable, Callable
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

import msgspec
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from zswarm.errors import ConfigError, ZswarmError
from zswarm.ot import control
from zswarm.ot.dashboard import answers, guard
from zswarm.ot.dashboard.hub import Client, Hub, TooMany
from zswarm.ot.dashboard.shelf import Shelf
from zswarm.ot.dashboard.traces import Traces
from zswarm.ot.reading import Run

KINDS = {".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml"}
PAGES = resources.files("zswarm.ot.dashboard") / "pages"
PLAYER = resources.files("zswarm.ot") / "pages"  # of the replay
SHELL = ("/", "/run", "/cluster", "/candidate")  # one page, whose script looks at the address
NO_SUCH_RUN, TRY_LATER = 4404, 1013  # close codes; the latter: a tab that takes nothing, or one too many
STUCK_S = 10.0  # that a tab may take for a message
LARGEST = 256  # bytes of a request's body


def application(shelf: Shelf) -> Starlette:
    """All routes; ``guard.Guard`` stands before them."""
    hub, traces = Hub(shelf), Traces()

    def found(id_: str) -> Path:
        folder = shelf.folder(id_)
        if folder is None:
            raise LookupError("no such run: it was moved or deleted, or is not in the folders that the dashboard shows")
        return folder

    async def rows(_: Request) -> Response:
        return _json(await asyncio.to_thread(shelf.rows))

    def answering(answer: answers.Answer) -> Callable[[Request], Awaitable[Response]]:
        def answered(request: Request) -> Response:
            value = answer(Run(found(request.path_params["run"])), request.query_params)
            return Response(value, media_type="text/csv") if isinstance(value, str) else _json(value)

        async def endpoint(request: Request) -> Response:
            return await _in_words(asyncio.to_thread(answered, request))

        return endpoint

    async def trace(request: Request) -> Response:
        async def traced() -> Response:
            folder = await asyncio.to_thread(found, request.path_params["run"])
            names = ("generation", "candidate", "trial")
            numbers = [answers.number(request.query_params, name) for name in names]
            return Response(await traces.of(folder, *numbers), media_type="application/octet-stream")

        return await _in_words(traced())

    async def ask(request: Request) -> Response:
        body = b""
        async for chunk in request.stream():
            body += chunk
            if len(body) > LARGEST:
                return PlainTextResponse("too long\n", 413)
        word = _word(body)

        def asked() -> Response:
            folder = found(request.path_params["run"])
            match word:
                case "pause" | "drain" | "stop":
                    control.ask(folder, word)
                case "go on":
                    control.forget(folder)
                case _:
                    raise ConfigError("expected pause, go on, drain or stop")
            return Response(status_code=204)

        return await _in_words(asyncio.to_thread(asked))

    async def socket(websocket: WebSocket) -> None:
        id_ = websocket.query_params.get("run", "")
        folder = await asyncio.to_thread(shelf.folder, id_) if id_ else None
        await websocket.accept(guard.PROTOCOL if guard.PROTOCOL in websocket.scope["subprotocols"] else None)
        if id_ and folder is None:
            await websocket.close(NO_SUCH_RUN, "no such run")
        else:
            await _serve(websocket, hub, id_, folder)

    async def shell(_: Request) -> Response:
        return _file(PAGES / "index.html")

    return Starlette(
        routes=[
            Route("/static/{name}", _static),
            Route("/api/runs", rows),
            *(Route(f"/api/runs/{{run:path}}/{name}", answering(answer)) for name, answer in answers.BY_NAME.items()),
            Route("/api/runs/{run:path}/trace", trace),
            Route("/api/runs/{run:path}/control", ask, methods=["POST"]),
            WebSocketRoute("/ws", socket),
            *(Route(path, shell) for path in SHELL),
        ]
    )


async def _serve(websocket: WebSocket, hub: Hub, id_: str, folder: Path | None) -> None:
    """Tell a tab, until it goes or takes nothing any more."""
    behind = True
    with contextlib.suppress(TooMany):
        async with hub.watching(id_, folder, websocket.query_params.get("since", "")) as client:
            tasks = sending, _ = asyncio.create_task(_send(websocket, client)), asyncio.create_task(_listen(websocket))
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


async def _send(websocket: WebSocket, client: Client) -> None:
    """What comes for a tab, until it is behind."""
    with contextlib.suppress(TimeoutError):
        while not client.full and (message := await client.take()):
            async with asyncio.timeout(STUCK_S):
                await websocket.send_text(message.decode())


async def _listen(websocket: WebSocket) -> None:
    """To the end of a tab, which has nothing to say."""
    while (await websocket.receive())["type"] != "websocket.disconnect":
        pass


async def _in_words(answer: Awaitable[Response]) -> Response:
    """An answer, or why there is none, in a line."""
    try:
        return await answer
    except LookupError as error:
        return PlainTextResponse(f"{error.args[0]}\n", 404)
    except ZswarmError as error:
        return PlainTextResponse(f"{error}\n", 422)


async def _static(request: Request) -> Response:
    name = request.path_params["name"]
    for folder in (PAGES, PLAYER):
        if folder.is_dir() and name in {file.name for file in folder.iterdir()} and Path(name).suffix in KINDS:
            return _file(folder / name)
    return PlainTextResponse("no such file\n", 404)


def _file(file: Traversable) -> Response:
    return Response(file.read_bytes(), media_type=KINDS[Path(file.name).suffix])


def _json(value: Any) -> Response:
    return Response(msgspec.json.encode(value), media_type="application/json")


def _word(body: bytes) -> str:
    try:
        return msgspec.json.decode(body, type=dict[str, str]).get("ask", "")
    except (msgspec.DecodeError, RecursionError):
        return ""
