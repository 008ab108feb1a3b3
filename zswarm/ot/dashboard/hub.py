"""Who watches which run: one follower for all tabs of a run, changes with sequence numbers, and room for so many per tab."""

import asyncio
import contextlib
import secrets
from collections import deque
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import msgspec

from zswarm.ot.dashboard.follower import Follower
from zswarm.ot.dashboard.shelf import Shelf

LIVE_S, IDLE_S = 0.25, 1.0  # between looks: when the last one found something, and when not
TICK_S = 2.0  # a page hears of the dashboard at least as often
KEPT = 200  # changes that a page may have missed and is told later
WAITING = 32  # messages for a tab that does not take them
CLIENTS = 200  # of all runs


class TooMany(Exception):
    """There are as many tabs as there may be."""


class Client:
    """A tab: messages that wait for it, and no more than so many.

    Attributes:
        full: it missed something, so it has to begin anew.
    """

    def __init__(self) -> None:
        self.full = False
        self._queue: asyncio.Queue[bytes] = asyncio.Queue(WAITING)

    def put(self, message: bytes) -> None:
        """Have it sent; what finds no room is the end of it."""
        try:
            self._queue.put_nowait(message)
        except asyncio.QueueFull:
            self.full = True

    def end(self) -> None:
        """Nothing comes any more: it has to begin anew, once it took what waits."""
        self.full = True
        self.put(b"")

    async def take(self) -> bytes:
        """The next message; empty: there is none."""
        return await self._queue.get()


class Room:
    """All tabs that watch one thing, told the same.

    Args:
        look: what is new, {} for nothing; called in a thread, while somebody watches.
        hello: all that a tab has to know that comes new.
    """

    def __init__(self, look: Callable[[], dict[str, Any]], hello: Callable[[], dict[str, Any]]) -> None:
        self.clients: set[Client] = set()
        self._look, self._hello = look, hello
        self._boot = secrets.token_hex(4)
        self._seq = 0
        self._kept: deque[tuple[int, bytes]] = deque(maxlen=KEPT)
        self._task: asyncio.Task[None] | None = None
        self._first = asyncio.Event()  # there is something to say hello with

    async def enter(self, client: Client, since: str) -> None:
        """A tab comes: it is told what it missed since a message that it names, or everything."""
        self.clients.add(client)
        if self._task is None or self._task.done():
            self._task = asyncio.create_task(self._follow())
        await self._first.wait()
        boot, _, number = since.partition(".")
        missed = [message for seq, message in self._kept if number.isdecimal() and seq > int(number)]
        if boot == self._boot and number.isdecimal() and len(missed) == self._seq - int(number):
            for message in missed:
                client.put(message)
        else:
            client.put(self._encoded({"hello": True, **self._hello()}))

    def leave(self, client: Client) -> None:
        """A tab goes; the last one ends the following."""
        self.clients.discard(client)
        if not self.clients and self._task is not None:
            self._task.cancel()
            self._task = None

    async def _follow(self) -> None:
        try:
            await self._tell_what_is_new()
        finally:  # by an error of ours, or because nobody watches
            self._first.set()
            for client in self.clients:
                client.end()

    async def _tell_what_is_new(self) -> None:
        quiet = 0.0
        while True:
            if new := await asyncio.to_thread(self._look):
                self._seq += 1
                message = self._encoded(new)
                self._kept.append((self._seq, message))
                self._tell(message)
                quiet = 0.0
            elif quiet >= TICK_S:
                self._tell(self._encoded({}))
                quiet = 0.0
            self._first.set()
            pause = LIVE_S if new else IDLE_S
            quiet += pause
            await asyncio.sleep(pause)

    def _tell(self, message: bytes) -> None:
        if self._first.is_set():  # else all of them wait for hello
            for client in self.clients:
                client.put(message)

    def _encoded(self, values: dict[str, Any]) -> bytes:
        return msgspec.json.encode({"seq": f"{self._boot}.{self._seq}", **values})


class Hub:
    """The rooms: one per run that is watched, and one for the list of runs."""

    def __init__(self, shelf: Shelf) -> None:
        self._shelf = shelf
        self._rooms: dict[str, Room] = {}

    @contextlib.asynccontextmanager
    async def watching(self, id_: str, folder: Path | None, since: str) -> AsyncIterator[Client]:
        """A tab while it watches a run, or the list where no folder is given.

        Raises:
            TooMany: there are too many tabs.
        """
        if sum(len(room.clients) for room in self._rooms.values()) >= CLIENTS:
            raise TooMany
        room = self._rooms.get(id_)
        if room is None:
            room = self._rooms[id_] = self._room(folder)
        client = Client()
        try:
            await room.enter(client, since)
            yield client
        finally:
            room.leave(client)
            if not room.clients and self._rooms.get(id_) is room:
                del self._rooms[id_]

    def _room(self, folder: Path | None) -> Room:
        if folder is not None:
            follower = Follower(folder)
            return Room(
                follower.look,
                lambda: {"state": follower.state, "events": follower.events, "servers": follower.servers()},
            )
        shown: dict[str, dict[str, Any]] = {}

        def look() -> dict[str, Any]:
            rows = {row["id"]: row for row in self._shelf.rows()}
            changed = [row for id_, row in rows.items() if shown.get(id_) != row]
            gone = [id_ for id_ in shown if id_ not in rows]
            shown.clear()
            shown.update(rows)
            return {"runs": changed, "gone": gone} if changed or gone else {}

        return Room(look, lambda: {"runs": list(shown.values())})
