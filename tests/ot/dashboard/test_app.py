"""Routes, pages and tabs that are stuck."""

import asyncio
import re
from importlib import resources
from pathlib import Path
from typing import Any, cast

import pytest
from starlette.websockets import WebSocket

from tests.ot.invented_record import written
from zswarm.ot.dashboard import app, broadcast
from zswarm.ot.dashboard.broadcast import Broadcaster
from zswarm.ot.dashboard.guard import Guard
from zswarm.ot.dashboard.run_index import RunIndex

TOKEN = "secret"  # noqa: S105  of a test


def test_pages_make_text_and_never_markup() -> None:
    """No script or style stands in a page, and no text of a record is ever parsed."""
    pages = {
        file.name: file.read_text()
        for file in (resources.files("zswarm.ot.dashboard") / "pages").iterdir()
    }
    for name, text in pages.items():
        for word in (
            "innerHTML",
            "outerHTML",
            "insertAdjacentHTML",
            "document.write",
            "eval(",
            "new Function",
            "DOMParser",
            "http://",
            "https:",
        ):
            allowed = (name, word) in {("live.js", "https:")} or (
                word == "http://" and "http://www.w3.org/2000/svg" in text
            )
            assert word not in text or allowed, f"{name}: {word}"
    page = pages["index.html"]
    assert re.findall(r"<script(?![^>]* src=)|<style|style=| on\w+=", page) == []


class Stuck:
    """A tab whose connection takes nothing."""

    def __init__(self) -> None:
        self.query_params: dict[str, str] = {}
        self.closed: list[int] = []

    async def send_text(self, _text: str) -> None:
        await asyncio.Event().wait()

    async def receive(self) -> dict[str, str]:
        await asyncio.Event().wait()
        raise AssertionError

    async def close(self, code: int, _reason: str) -> None:
        self.closed.append(code)


def test_a_tab_that_is_stuck_is_closed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is closed with the code for reconnecting, and no run is followed for it any more."""
    monkeypatch.setattr(app, "STUCK_S", 0.01)
    folder = written(tmp_path, [1.0])
    watched, tab = Broadcaster(RunIndex([tmp_path])), Stuck()
    asyncio.run(app._serve(cast(WebSocket, tab), watched, "stadium", folder))
    assert tab.closed == [1013]
    assert watched._channels == {}


def test_a_tab_beyond_the_limit_is_closed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(broadcast, "TABS", 0)
    tab = Stuck()
    asyncio.run(
        app._serve(cast(WebSocket, tab), Broadcaster(RunIndex([tmp_path])), "", None)
    )
    assert tab.closed == [1013]


def test_only_the_page_with_the_token_writes_notes(tmp_path: Path) -> None:
    """A page of another site, or one without the token, changes nothing."""
    folder = written(tmp_path, [1.0])
    ours = {"host": "127.0.0.1:8467", "origin": "http://127.0.0.1:8467"}
    token = {"authorization": f"Bearer {TOKEN}"}
    guarded = Guard(
        app.application(RunIndex([tmp_path])), hosts=[], token=TOKEN, closed=False
    )

    def post(body: bytes, **headers: str) -> int:
        told: list[dict[str, Any]] = []

        async def receive() -> Any:
            return {"type": "http.request", "body": body}

        async def send(message: Any) -> None:
            told.append(message)

        scope = {
            "type": "http",
            "method": "POST",
            "path": "/api/runs/stadium/note",
            "query_string": b"",
            "subprotocols": [],
            "headers": [(name.encode(), text.encode()) for name, text in headers.items()],
        }
        asyncio.run(guarded(scope, receive, send))
        return int(told[0]["status"])

    good = b'{"tags": ["paper"], "note": "from the page"}'
    assert post(good, **ours) == 401
    assert post(good, **{**ours, **token, "origin": "http://evil.example"}) == 403
    assert post(good, host=ours["host"], **token) == 403
    assert post(good, **ours, **token, **{"sec-fetch-site": "cross-site"}) == 403
    assert post(b"x" * ((1 << 16) + 1), **ours, **token) == 422
    assert post(b'{"tags": ["a,b"]}', **ours, **token) == 422
    assert post(b"[]", **ours, **token) == 422
    assert not (folder / "notes.toml").exists()
    assert post(good, **ours, **token) == 204
    (row,) = RunIndex([tmp_path]).rows()
    assert (row["tags"], row["note"]) == (["paper"], "from the page")
